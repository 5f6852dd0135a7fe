"""Tables of the coarse space (sim/solver/coarse_space.py) from the grid alone: modes, and products at the samples."""

import numpy as np
from numpy.typing import NDArray

from sim.solver.modes import Modes
from sim.state import COARSE_ACROSS, COARSE_DOWN, COARSE_SAMPLES

# Products of strains that couple components: of rows and columns (0 u, 1 v, 2 w), which tables across and down.
# u' kappa_1 w, u-shear w, v' kappa_2 w, v-shear w; (kappa w)^2 thrice; u-shear v-shear
PRODUCTS = (
    (0, 2, 0, 0), (0, 2, 1, 1), (1, 2, 2, 1), (1, 2, 0, 2), (2, 2, 3, 0), (2, 2, 4, 2), (2, 2, 3, 2), (0, 1, 5, 1),
)  # fmt: skip


def tables(
    across: Modes, down: NDArray[np.float64], eigen_down: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return what C.shared and C.place hold; down (n, n): modes along v, softest first, and their eigenvalues."""
    n = len(down)
    nodes = np.rint((np.arange(COARSE_SAMPLES) + 0.5) * (n - 1) / COARSE_SAMPLES).astype(int)
    columns, rows = np.argsort(across.stretching, kind="stable")[:COARSE_ACROSS], slice(0, COARSE_DOWN)
    # an edge has the mean of its ends, of a cosine less than a node; and a steeper slope than two edges
    mean = _edge_means(across.tangential, across.stretching)
    u, u_mean, u_slope = _at_edges(across.tangential[:, columns], across.stretching[columns])
    w, w_mean = across.normal[:, columns], mean @ across.normal[:, columns]
    v, v_mean, v_slope = _at_edges(down[:, rows], eigen_down[rows])
    pairs = (
        (u_slope, w_mean), (u_mean, w_mean), (u, w), (w_mean, w_mean), (w, w), (u_mean, u_slope),
        (v, v), (v_slope, v_mean), (v_mean, v_mean),
    )  # fmt: skip
    shared = [np.einsum("sk,sl->kls", left[nodes], right[nodes]) for left, right in pairs]
    second = np.diff(v, n=2, axis=0)
    shared += [eigen_down[rows], second.T @ second, np.outer(v[1], v[1]), np.pad(v, ((0, -n % 4), (0, 0)))]
    numbers = np.concatenate([np.ravel(a) for a in shared]).astype(np.float32)
    return numbers, np.concatenate([columns, nodes, np.ravel(PRODUCTS)]).astype(np.int32)


def _at_edges(modes: NDArray[np.float64], eigen: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return tangential modes, and what means and slopes of edges are of them, at the nodes."""
    shrink = _shrink(eigen)
    return modes, modes * shrink, np.gradient(modes, axis=0) / shrink


def _shrink(eigen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how much less the mean of two neighbours is than a mode between them."""
    return np.sqrt(np.clip(1 - eigen / 4, 0, None))


def _edge_means(modes: NDArray[np.float64], eigen: NDArray[np.float64]) -> NDArray[np.float64]:
    weight = np.ones(len(modes))
    weight[[0, -1]] = 0.5
    return (modes * _shrink(eigen)) @ (modes.T * weight)

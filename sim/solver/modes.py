"""Modes across, in which the flat cloth's own problem falls apart: eigenvectors in one direction of the grid.

Tangential components: of the second difference with free ends; the normal component: of bending with free ends, a free
beam's modes (with those of the second difference, a free edge would be clamped against turning). W weighs an end node
by a half. A side edge may be held.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from sim.grid import Support
from sim.state import COARSE_ACROSS, COARSE_DOWN, COARSE_SAMPLES


@dataclass(frozen=True)
class Modes:
    """Columns of (n, n), orthonormal with respect to W; `odd` of them odd, behind the even ones, or none."""

    tangential: Array
    normal: Array
    odd: int
    stretching: Array  # (n,) eigenvalues of the second difference, tangential
    bending: Array  # (n,) eigenvalues of bending, normal
    slopes: Array  # (n,) what the second difference is of each normal mode


def modes_across(n: int, support: Support) -> Modes:
    keep = slice(1 if support == Support.LEFT else 0, n - 1 if support == Support.RIGHT else n)
    first, second = np.diff(np.eye(n), axis=0), np.diff(np.eye(n), n=2, axis=0)
    stretching, tangential = _eigenvectors(first.T @ first, keep)
    bending, normal = _eigenvectors(second.T @ second, keep)
    odd = n // 2 if keep == slice(0, n) else 0
    return Modes(tangential, normal, odd, stretching, bending, np.square(first @ normal).sum(axis=0))


def modes_down(n: int, support: Support) -> tuple[Array, Array]:
    """Return tangential modes along v (n, n), softest first, and their eigenvalues."""
    turned = {Support.TOP: Support.LEFT, Support.BOTTOM: Support.RIGHT}.get(support, Support.NONE)
    across = modes_across(n, turned)
    order = np.argsort(across.stretching, kind="stable")
    return across.tangential[:, order], across.stretching[order]


def by_four(modes: Modes) -> Array:
    """Return (entries, 8): both bases as the transforms read them, half of the rows of the even vectors, of the odd
    ones, and the transposes: rows by four, tangential, then normal."""
    even = len(modes.normal) - modes.odd
    both = []
    for basis in (modes.tangential, modes.normal):
        parts = [basis[:even, :even]]
        if modes.odd:
            parts.append(basis[: modes.odd, even:][::-1])  # their differences lie mirrored
        both.append(np.concatenate([_rows_by_four(part) for part in (*parts, *(part.T for part in parts))]))
    return np.concatenate(both, axis=1)


def _eigenvectors(stiffness: Array, keep: slice) -> tuple[Array, Array]:
    """Return the solutions of K phi = lambda W phi with the nodes outside `keep` held: eigenvalues (n,), columns (n,
    n); zero columns for held nodes come last. Even vectors, then odd ones, where no node is held."""
    n = len(stiffness)
    root = np.ones(n)
    root[[0, -1]] = np.sqrt(0.5)
    free = np.eye(n)[:, keep]
    spaces = [free]
    if free.shape[1] == n:
        half = np.sqrt(0.5) * (free + free[::-1])[:, : n // 2]
        middle = free[:, n // 2 : n - n // 2]
        spaces = [np.hstack([half, middle]), np.sqrt(0.5) * (free - free[::-1])[:, : n // 2]]
    values, columns = [], []
    for space in spaces:
        lam, vectors = np.linalg.eigh(space.T @ (stiffness / np.outer(root, root)) @ space)
        values.append(np.clip(lam, 0, None))
        columns.append(space @ vectors / root[:, None])
    held = n - free.shape[1]
    return np.concatenate([*values, np.full(held, 4.0)]), np.hstack([*columns, np.zeros((n, held))])


def _rows_by_four(matrix: Array) -> Array:
    """Return (n/4 rounded up x n, 4): entry [q n + k, r] is row 4 q + r, column k; rows beyond the last are zero."""
    n = len(matrix)
    padded = np.pad(matrix, ((0, -n % 4), (0, 0)))
    return padded.reshape(-1, 4, n).transpose(0, 2, 1).reshape(-1, 4)


# Products of strains that couple components: of rows and columns (0 u, 1 v, 2 w), which tables across and down.
# u' kappa_1 w, u-shear w, v' kappa_2 w, v-shear w; (kappa w)^2 thrice; u-shear v-shear
PRODUCTS = (
    (0, 2, 0, 0), (0, 2, 1, 1), (1, 2, 2, 1), (1, 2, 0, 2), (2, 2, 3, 0), (2, 2, 4, 2), (2, 2, 3, 2), (0, 1, 5, 1),
)  # fmt: skip


def tables(across: Modes, down: Array, eigen_down: Array) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
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
    shared = [np.einsum("sk,sl->kls", one[nodes], other[nodes]) for one, other in pairs]
    second = np.diff(v, n=2, axis=0)
    shared += [eigen_down[rows], second.T @ second, np.outer(v[1], v[1]), np.pad(v, ((0, -n % 4), (0, 0)))]
    numbers = np.concatenate([np.ravel(a) for a in shared]).astype(np.float32)
    return numbers, np.concatenate([columns, nodes, np.ravel(PRODUCTS)]).astype(np.int32)


def _at_edges(modes: Array, eigen: Array) -> tuple[Array, ...]:
    """Return tangential modes, and what means and slopes of edges are of them, at the nodes."""
    shrink = _shrink(eigen)
    return modes, modes * shrink, np.gradient(modes, axis=0) / shrink


def _shrink(eigen: Array) -> Array:
    """Return how much less the mean of two neighbours is than a mode between them."""
    return np.sqrt(np.clip(1 - eigen / 4, 0, None))


def _edge_means(modes: Array, eigen: Array) -> Array:
    weight = np.ones(len(modes))
    weight[[0, -1]] = 0.5
    return (modes * _shrink(eigen)) @ (modes.T * weight)

"""How a hung cloth answers curvature that it would like to have: the linear plate, hanging flat under its weight.

A network that says what the muscles and the cloth do *at a place* needs no layout of its own to say what follows from
it elsewhere: that is mechanics. w minimises the energy

    1/2 |w_uu - k_uu|^2 + 1/2 |w_vv - k_vv|^2 + |w_uv - k_uv|^2 + 1/2 (T / B) |w_v|^2

over the cloth, w = 0 where it is hung, T(v) the weight below per width, B the bending stiffness. The cloth that is
corrected has its own shape: the slopes of w are taken for turns of its tangents, which is exact for turns in a row and
leaves out what its shape does to stiffness and weight.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from corrector.shape import held_nodes
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case

Array = NDArray[np.float64]

_EASE = 1e-6  # of the identity, in 1/m^4: a cloth that nothing holds keeps its place


def weight_over_stiffness(case: Case) -> float:
    """Return 1/m^3: areal weight over bending stiffness down the cloth, factors applied; 0 where the weight does not
    pull from a hung top edge."""
    fabric = case.design.fabric
    if fabric.hung != "top":
        return 0.0
    weight = fabric.areal_density * case.factors.get("areal_density", 1.0) * max(-fabric.gravity[1], 0.0)
    return weight / (fabric.bending_stiffness[1] * case.factors.get("bending", 1.0))


def slopes_of(fabric: Fabric, ratio: float, n: int) -> Array:
    """Return `slopes` for a cloth."""
    return slopes(fabric.width, fabric.height, fabric.hung, fabric.support == "clamped", ratio, n)


@lru_cache(maxsize=16)
def slopes(width: float, height: float, hung: Any, clamped: bool, ratio: float, n: int) -> Array:
    """Return (2 n^2, 3 n^2) m: slopes w_u and w_v at n x n nodes from curvatures k_uu, k_vv, k_uv [1/m] at the same
    nodes.

    hung, clamped: which nodes are held, and whether their normals are too. ratio: `weight_over_stiffness`.
    """
    du, dv = width / (n - 1), height / (n - 1)
    one = np.eye(n)
    first: Array = np.asarray(np.gradient(one, axis=0))
    second = np.zeros((n, n))
    for i in range(1, n - 1):
        second[i, i - 1 : i + 2] = 1, -2, 1
    uu, vv = np.kron(one, second / du**2), np.kron(second / dv**2, one)
    uv = np.kron(first / dv, first / du)
    steps = np.kron(np.diff(one, axis=0) / dv, one)
    below = np.repeat(height - (np.arange(n - 1) + 0.5) * dv, n)
    energy = uu.T @ uu + vv.T @ vv + 2 * uv.T @ uv + steps.T @ (ratio * below[:, None] * steps) + _EASE * np.eye(n * n)
    held = held_nodes(width, height, hung, n)
    if clamped:  # the nodes next to those held stay too
        held |= binary_dilation(held)
    free = np.flatnonzero(~held.ravel())
    load = np.concatenate([uu.T, vv.T, 2 * uv.T], axis=1)
    w = np.zeros((n * n, 3 * n * n))
    w[free] = np.linalg.solve(energy[np.ix_(free, free)], load[free])
    result = np.concatenate([np.kron(one, first / du) @ w, np.kron(first / dv, one) @ w])
    result.setflags(write=False)
    return result

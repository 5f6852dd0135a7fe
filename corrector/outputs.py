"""The displacement of the simulated cloth by all basis functions, and to first order by each, to learn from.

How a hung cloth answers curvature that it would like to have: the linear plate, hanging flat under its weight.

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

from corrector.basis import STRAIN, Basis, Combination
from corrector.layout import NODES
from corrector.shape import (
    FINE,
    LocalFrames,
    held_nodes,
    integration,
    put_together,
    refine,
    refinement,
    tangent_changes,
)
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case

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


def displacement_of(combination: Combination, frames: LocalFrames, fabric: Fabric, ratio: float) -> NDArray[np.float32]:
    """Return (T, FINE, FINE, 3) m of the mid-surface.

    frames: of the simulated cloth, at FINE x FINE nodes. ratio: `response.weight_over_stiffness`.
    """
    curvature = _fine(combination.curvature)
    answer = slopes_of(fabric, ratio, FINE)
    tilts = (curvature.reshape(len(curvature), -1) @ answer.T).reshape(-1, 2, FINE, FINE)
    straight, twisting = combination.swings.T[:, :, None, None]
    tilts[:, 1] += straight + twisting * np.linspace(-1, 1, FINE)
    strain = np.moveaxis(_fine(combination.strain), 1, -1)
    changes = tangent_changes(np.moveaxis(tilts, 1, -1), strain, frames)
    along = _fine(combination.displacements[:, None])[:, 0, ..., None] * frames.normal
    return (put_together(*changes, fabric) + along).astype(np.float32)


def heights_of(basis: Basis, frames: LocalFrames, fabric: Fabric, ratio: float) -> NDArray[np.float32]:
    """Return (T, K, FINE, FINE) m along the normal by a unit coefficient, to first order."""
    size_u, size_v = (np.linalg.norm(x, axis=-1, keepdims=True) for x in (frames.across, frames.down))
    count = len(basis.swings)
    flat = basis.curvature.astype(np.float32).reshape(-1, 3 * NODES**2)
    coarse = _coarse(fabric.width, fabric.height, fabric.hung, fabric.support == "clamped", ratio)
    by_curvature = (flat @ coarse).reshape(count, -1, 2, FINE, FINE)
    straight = np.zeros((*basis.swings.shape, 2, FINE, FINE), dtype=np.float32)
    straight[:, :, 1] = basis.swings[..., None, None]
    twisting = straight * np.linspace(-1, 1, FINE, dtype=np.float32)
    strain = _fine(STRAIN * basis.strain).astype(np.float32)
    tilts = np.concatenate(
        [by_curvature, np.zeros((*strain.shape[:2], 2, FINE, FINE), np.float32), straight, twisting], 1
    )
    change_u = tilts[:, :, 0, ..., None] * (size_u * frames.normal)[:, None]
    change_v = tilts[:, :, 1, ..., None] * (size_v * frames.normal)[:, None]
    span = slice(by_curvature.shape[1], by_curvature.shape[1] + strain.shape[1])
    unit_u, unit_v = frames.across / size_u, frames.down / size_v
    shear = strain[:, :, 2, ..., None] / 2
    change_u[:, span] = (strain[:, :, 0, ..., None] * unit_u[:, None] + shear * unit_v[:, None]) * size_u[:, None]
    change_v[:, span] = (strain[:, :, 1, ..., None] * unit_v[:, None] + shear * unit_u[:, None]) * size_v[:, None]
    heights = np.einsum("tkabi,tabi->tkab", _put_together(change_u, change_v, fabric), frames.normal)
    return np.concatenate([heights, _fine(basis.displacements).astype(np.float32)], axis=1)


def _fine(field: Floats) -> Floats:
    """Return (..., FINE, FINE) of (..., n, n)."""
    return refine(field[..., None], FINE)[..., 0]


def _put_together(change_u: Floats, change_v: Floats, fabric: Fabric) -> Floats:
    """Return `shape.put_together` of (T, K, FINE, FINE, 3) as one product of matrices: ten times faster."""
    steps_u = (change_u[..., :, 1:, :] + change_u[..., :, :-1, :]) / 2
    steps_v = (change_v[..., 1:, :, :] + change_v[..., :-1, :, :]) / 2
    batch = change_u.shape[:2]
    steps = np.concatenate([steps_u.reshape(*batch, -1, 3), steps_v.reshape(*batch, -1, 3)], axis=2)
    matrix = integration(fabric.width, fabric.height, fabric.hung, FINE).astype(np.float32)
    moved = matrix @ np.moveaxis(steps, 2, 0).reshape(matrix.shape[1], -1)
    return np.moveaxis(moved.reshape(FINE, FINE, *batch, 3), (0, 1), (2, 3))


@lru_cache(maxsize=8)
def _coarse(width: float, height: float, hung: object, clamped: bool, ratio: float) -> NDArray[np.float32]:
    """Return (3 NODES^2, 2 FINE^2): `response.slopes` of curvatures on the coarse nodes."""
    line = refinement(NODES, FINE)
    matrix = slopes(width, height, hung, clamped, ratio, FINE).reshape(-1, 3, FINE**2) @ np.kron(line, line)
    return np.ascontiguousarray(matrix.reshape(2 * FINE**2, -1).T.astype(np.float32))

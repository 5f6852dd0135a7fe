"""The displacement of the simulated cloth by all basis functions, and to first order by each, to learn from."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from corrector.basis import STRAIN, Basis, Combination
from corrector.layout import NODES
from corrector.response import slopes, slopes_of
from corrector.shape import FINE, Floats, LocalFrames, integration, put_together, refine, refinement, tangent_changes
from fabdesign.nouns.fabric import Fabric


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
    by_curvature = (flat @ _coarse_slopes(fabric, ratio)).reshape(count, -1, 2, FINE, FINE)
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


def _coarse_slopes(fabric: Fabric, ratio: float) -> NDArray[np.float32]:
    return _coarse(fabric.width, fabric.height, fabric.hung, fabric.support == "clamped", ratio)


@lru_cache(maxsize=8)
def _coarse(width: float, height: float, hung: object, clamped: bool, ratio: float) -> NDArray[np.float32]:
    """Return (3 NODES^2, 2 FINE^2): `response.slopes` of curvatures on the coarse nodes."""
    line = refinement(NODES, FINE)
    matrix = slopes(width, height, hung, clamped, ratio, FINE).reshape(-1, 3, FINE**2) @ np.kron(line, line)
    return np.ascontiguousarray(matrix.reshape(2 * FINE**2, -1).T.astype(np.float32))

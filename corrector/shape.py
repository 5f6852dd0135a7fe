"""The shape of a simulated cloth as its own frames see it, and a cloth put together from corrected tangents."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.layout import NODES
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Floats
from fabdesign.nouns.fabric import Fabric

FINE = 2 * NODES - 1  # nodes a side of the grid on which a corrected cloth is put together


@dataclass(frozen=True, eq=False)
class LocalFrames:
    """Tangents and normal at nodes x nodes of a cloth, one batch of frames. float32."""

    across: Floats  # (..., nodes, nodes, 3) dX/du
    down: Floats  # (..., nodes, nodes, 3) dX/dv; the flat cloth's has length 1 too
    normal: Floats  # (..., nodes, nodes, 3) of unit length, off the front

    @staticmethod
    def of(middle: Floats, width: float, height: float, nodes: int) -> "LocalFrames":
        """Return the frames of a mid-surface (..., side, side, 3) m; side - 1 is a multiple of nodes - 1."""
        side = middle.shape[-2]
        every = (side - 1) // (nodes - 1)
        across = _slope(middle, -2)[..., ::every, ::every, :] * (side - 1) / width
        down = _slope(middle, -3)[..., ::every, ::every, :] * (side - 1) / height
        normal = np.cross(down, across)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return LocalFrames(across, down, normal)

    def units(self) -> Floats:
        """Return (..., nodes, nodes, 3, 3): unit vectors along u, along v and along the normal, in rows."""
        across = self.across / np.linalg.norm(self.across, axis=-1, keepdims=True)
        down = self.down / np.linalg.norm(self.down, axis=-1, keepdims=True)
        return np.stack([across, down, self.normal], axis=-2)


def _slope(x: Floats, axis: int) -> Floats:
    """Return differences a step along `axis`: central, one-sided of second order at the ends."""
    x = np.moveaxis(x, axis, 0)
    slope = np.empty_like(x)
    slope[1:-1] = (x[2:] - x[:-2]) / 2
    slope[0] = -1.5 * x[0] + 2 * x[1] - 0.5 * x[2]
    slope[-1] = 1.5 * x[-1] - 2 * x[-2] + 0.5 * x[-3]
    return np.moveaxis(slope, 0, axis)


def tangent_changes(tilts: Floats, strains: Floats, frames: LocalFrames) -> tuple[Floats, Floats]:
    """Return changes of dX/du and dX/dv, each (..., n, n, 3).

    tilts (..., n, n, 2) rad: turns of the u and of the v tangent towards the normal, at constant length. strains
    (..., n, n, 3): along u, along v, and shear.
    """
    tilt_u, tilt_v = tilts[..., :1], tilts[..., 1:]
    strain_u, strain_v, shear = (strains[..., k, None] for k in range(3))
    size_u = np.linalg.norm(frames.across, axis=-1, keepdims=True)
    size_v = np.linalg.norm(frames.down, axis=-1, keepdims=True)
    unit_u, unit_v = frames.across / size_u, frames.down / size_v
    change_u = np.sin(tilt_u) * frames.normal + (np.cos(tilt_u) - 1 + strain_u) * unit_u + shear / 2 * unit_v
    change_v = np.sin(tilt_v) * frames.normal + (np.cos(tilt_v) - 1 + strain_v) * unit_v + shear / 2 * unit_u
    return size_u * change_u, size_v * change_v


def put_together(change_u: Floats, change_v: Floats, fabric: Fabric) -> Floats:
    """Return the (..., n, n, 3) m displacement whose slopes come closest to the given changes of the tangents; none
    where the cloth is hung."""
    n = change_u.shape[-2]
    steps_u = (change_u[..., :, 1:, :] + change_u[..., :, :-1, :]) / 2
    steps_v = (change_v[..., 1:, :, :] + change_v[..., :-1, :, :]) / 2
    flat = (*change_u.shape[:-3], n * (n - 1), 3)
    steps = np.concatenate([steps_u.reshape(flat), steps_v.reshape(flat)], axis=-2)
    matrix = integration(fabric.width, fabric.height, fabric.hung, n).astype(steps.dtype)
    return (matrix @ steps).reshape(*change_u.shape[:-3], n, n, 3)


@lru_cache(maxsize=8)
def integration(width: float, height: float, hung: Any, n: int) -> NDArray[np.float64]:
    """Return (n^2, 2 n (n - 1)): displacements [m] of the nodes from slopes on the edges along u, then along v.

    Least squares over all edges (Poisson's equation), with the hung nodes held; a cloth that is not hung keeps its
    mean place.
    """
    node = np.arange(n * n).reshape(n, n)
    ends = np.concatenate(
        [
            np.stack([node[:, :-1].ravel(), node[:, 1:].ravel()], axis=1),
            np.stack([node[:-1].ravel(), node[1:].ravel()], axis=1),
        ]
    )
    length = np.repeat([width / (n - 1), height / (n - 1)], n * (n - 1))
    gradient = np.zeros((len(ends), n * n))
    gradient[np.arange(len(ends)), ends[:, 1]] = 1
    gradient[np.arange(len(ends)), ends[:, 0]] = -1
    held = held_nodes(width, height, hung, n).ravel()
    free = ~held
    result = np.zeros((n * n, len(ends)))
    result[free] = np.linalg.pinv(gradient[:, free]) * length
    result.setflags(write=False)
    return result


def held_nodes(width: float, height: float, hung: Any, n: int) -> NDArray[np.bool_]:
    """Return (n, n) whether a node is hung: those of an edge, or the nearest to each point."""
    held = np.zeros((n, n), dtype=bool)
    if isinstance(hung, str):
        for edge, part in (("top", held[0]), ("bottom", held[-1]), ("left", held[:, 0]), ("right", held[:, -1])):
            part[:] |= edge == hung
        return held
    for u, v in hung:
        held[round(v / height * (n - 1)), round(u / width * (n - 1))] = True
    return held


@lru_cache(maxsize=8)
def refinement(coarse: int, fine: int) -> NDArray[np.float64]:
    """Return (fine, coarse) weights of linear interpolation on a line."""
    at = np.linspace(0, coarse - 1, fine)
    first = np.minimum(at.astype(int), coarse - 2)
    weights = np.zeros((fine, coarse))
    weights[np.arange(fine), first] = 1 - (at - first)
    weights[np.arange(fine), first + 1] = at - first
    weights.setflags(write=False)
    return weights


def refine(field: Floats, fine: int) -> Floats:
    """Return (..., fine, fine, k) of (..., n, n, k), linear in between."""
    line = refinement(field.shape[-2], fine).astype(field.dtype)
    return np.einsum("ai,...ijk,bj->...abk", line, field, line, optimize=True)


def displaced(points: Floats, displacement: Floats, thickness: float) -> NDArray[np.float32]:
    """Return (..., 2 side^2, 3) m: both faces of `points` moved by a displacement of the mid-surface (..., n, n, 3),
    and turned with it."""
    shape = Shape(points)
    middle = shape.middle
    moved = middle + refine(displacement, shape.side)
    turn = (_normals(moved) - _normals(middle)) * (thickness / 2)
    shift = moved - middle
    front, back = (x.reshape(*points.shape[:-2], -1, 3) for x in (shift + turn, shift - turn))
    return (points + np.concatenate([front, back], axis=-2)).astype(np.float32)


def _normals(middle: Floats) -> Floats:
    normal = np.cross(_slope(middle, -3), _slope(middle, -2))
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)

"""The shape of a simulated cloth as its own frames see it, how it answers curvature that it would like to have, and a
cloth put together from corrected tangents.

How a hung cloth answers curvature: the linear plate, hanging flat under its weight. A network that says what the
muscles and the cloth do *at a place* needs no layout of its own to say what follows from it elsewhere: that is
mechanics. w minimises the energy

    1/2 |w_uu - k_uu|^2 + 1/2 |w_vv - k_vv|^2 + |w_uv - k_uv|^2 + 1/2 (T / B) |w_v|^2

over the cloth, w = 0 where it is hung, T(v) the weight below per width, B the bending stiffness. The cloth that is
corrected has its own shape: the slopes of w are taken for turns of its tangents, which is exact for turns in a row and
leaves out what its shape does to stiffness and weight.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case

NODES = 11  # a side of the grid on which a corrector sees the cloth
FINE = 2 * NODES - 1  # nodes a side of the grid on which a corrected cloth is put together
_EASE = 1e-6  # of the identity, in 1/m^4: a cloth that nothing holds keeps its place


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

    @cached_property
    def sizes(self) -> tuple[Floats, Floats]:
        """Return the lengths (..., nodes, nodes, 1) of both tangents."""
        return np.linalg.norm(self.across, axis=-1, keepdims=True), np.linalg.norm(self.down, axis=-1, keepdims=True)

    @cached_property
    def units(self) -> tuple[Floats, Floats]:
        """Return unit vectors (..., nodes, nodes, 3) along u and along v."""
        return self.across / self.sizes[0], self.down / self.sizes[1]


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
    change_u, change_v = (
        np.sin(tilts[..., k, None]) * frames.normal
        + (np.cos(tilts[..., k, None]) - 1 + strains[..., k, None]) * frames.units[k]
        + strains[..., 2, None] / 2 * frames.units[1 - k]
        for k in (0, 1)
    )
    return frames.sizes[0] * change_u, frames.sizes[1] * change_v


def put_together(change_u: Floats, change_v: Floats, fabric: Fabric) -> Floats:
    """Return the (..., n, n, 3) m displacement whose slopes come closest to the given changes of the tangents; none
    where the cloth is hung. All as one product of matrices: ten times faster than one by one."""
    n, batch = change_u.shape[-2], change_u.shape[:-3]
    steps_u = (change_u[..., :, 1:, :] + change_u[..., :, :-1, :]) / 2
    steps_v = (change_v[..., 1:, :, :] + change_v[..., :-1, :, :]) / 2
    steps = np.concatenate([steps_u.reshape(*batch, -1, 3), steps_v.reshape(*batch, -1, 3)], axis=-2)
    matrix = integration(fabric, n).astype(steps.dtype)
    moved = matrix @ np.moveaxis(steps, -2, 0).reshape(matrix.shape[1], -1)
    return np.moveaxis(moved.reshape(n, n, *batch, 3), (0, 1), (-3, -2))


@lru_cache(maxsize=8)
def integration(fabric: Fabric, n: int) -> Array:
    """Return (n^2, 2 n (n - 1)): displacements [m] of the nodes from slopes on the edges along u, then along v.

    Least squares over all edges (Poisson's equation), with the hung nodes held; a cloth that is not hung keeps its
    mean place.
    """
    one, here, ahead = np.eye(n), np.eye(n - 1, n), np.eye(n - 1, n, 1)
    gradient = np.concatenate([np.kron(one, ahead) - np.kron(one, here), np.kron(ahead, one) - np.kron(here, one)])
    length = np.repeat([fabric.width / (n - 1), fabric.height / (n - 1)], n * (n - 1))
    free = ~held_nodes(fabric, n).ravel()
    result = np.zeros(gradient.T.shape)
    result[free] = np.linalg.pinv(gradient[:, free]) * length
    result.setflags(write=False)
    return result


def held_nodes(fabric: Fabric, n: int) -> NDArray[np.bool_]:
    """Return (n, n) whether a node is hung: those of an edge, or the nearest to each point."""
    held = np.zeros((n, n), dtype=bool)
    if isinstance(fabric.hung, str):
        for edge, part in (("top", held[0]), ("bottom", held[-1]), ("left", held[:, 0]), ("right", held[:, -1])):
            part[:] |= edge == fabric.hung
        return held
    for u, v in fabric.hung:
        held[round(v / fabric.height * (n - 1)), round(u / fabric.width * (n - 1))] = True
    return held


def weight_over_stiffness(case: Case) -> float:
    """Return 1/m^3: areal weight over bending stiffness down the cloth, factors applied; 0 where the weight does not
    pull from a hung top edge."""
    fabric = case.design.fabric
    if fabric.hung != "top":
        return 0.0
    weight = fabric.areal_density * case.factors.get("areal_density", 1.0) * max(-fabric.gravity[1], 0.0)
    return weight / (fabric.bending_stiffness[1] * case.factors.get("bending", 1.0))


@lru_cache(maxsize=16)
def slopes(fabric: Fabric, ratio: float) -> Array:
    """Return (3 NODES^2, 2 FINE^2) m: slopes w_u and w_v at FINE x FINE nodes from curvatures k_uu, k_vv, k_uv [1/m] at
    NODES x NODES, linear in between. Not only nodes are held but, of a clamped cloth, their normals too. ratio:
    `weight_over_stiffness`."""
    n = FINE
    du, dv = fabric.width / (n - 1), fabric.height / (n - 1)
    one = np.eye(n)
    first: Array = np.asarray(np.gradient(one, axis=0))
    second = np.zeros((n, n))
    for i in range(1, n - 1):
        second[i, i - 1 : i + 2] = 1, -2, 1
    uu, vv = np.kron(one, second / du**2), np.kron(second / dv**2, one)
    uv = np.kron(first / dv, first / du)
    steps = np.kron(np.diff(one, axis=0) / dv, one)
    below = np.repeat(fabric.height - (np.arange(n - 1) + 0.5) * dv, n)
    energy = uu.T @ uu + vv.T @ vv + 2 * uv.T @ uv + steps.T @ (ratio * below[:, None] * steps) + _EASE * np.eye(n * n)
    held = held_nodes(fabric, n)
    if fabric.support == "clamped":  # the nodes next to those held stay too
        held |= binary_dilation(held)
    free = np.flatnonzero(~held.ravel())
    load = np.concatenate([uu.T, vv.T, 2 * uv.T], axis=1)
    w = np.zeros((n * n, 3 * n * n))
    w[free] = np.linalg.solve(energy[np.ix_(free, free)], load[free])
    line = interpolation(np.linspace(0, NODES - 1, n), NODES)
    fine = np.concatenate([np.kron(one, first / du) @ w, np.kron(first / dv, one) @ w])
    matrix = fine.reshape(-1, 3, n * n) @ np.kron(line, line)
    result = np.ascontiguousarray(matrix.reshape(2 * n * n, -1).T)
    result.setflags(write=False)
    return result


def interpolation(at: Array, count: int) -> Array:
    """Return (n, count) weights of linear interpolation between `count` values on a line, at places (n,) from 0 to
    count - 1."""
    return np.array([np.interp(at, np.arange(count), row) for row in np.eye(count)]).T


def refine(field: Floats, fine: int) -> Floats:
    """Return (..., fine, fine, k) of (..., n, n, k), linear in between."""
    n = field.shape[-2]
    line = interpolation(np.linspace(0, n - 1, fine), n).astype(field.dtype)
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

"""The shape of a cloth: both faces on one grid, the mid-surface between them, places on it, the muscles laced there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import isqrt
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case, ForwardModel

Face = Literal["both", "front", "back"]
_FREE = {"top": -1, "bottom": 0, "left": -1, "right": 0}  # row or column of the free edge opposite the hung one


class Sheet(Protocol):
    """One motion, as fits ask for it: the mid-surface on the simulator's own grid, and faces only where clouds ask."""

    @property
    def middle(self) -> Floats:
        """Return (T, n, n, 3) m, nodes of the mid-surface by rising v, then rising u."""
        ...

    @property
    def points(self) -> Floats:
        """Return (T, 2 m, 3) m: front face, then back face, as `ForwardModel.motions` gives them."""
        ...


Sheets = Callable[[Sequence[Case], Sequence[Array]], Sequence[Sheet]]


@dataclass(frozen=True, eq=False)
class Shape:
    """Both faces of a cloth (..., 2 n n, 3) m: the front, then the back, each by rising v, then rising u. Of a motion
    frames come first: it is a `Sheet`."""

    points: Floats

    @staticmethod
    def of(points: Floats) -> "Shape":
        """Return the shape in double precision."""
        return Shape(np.asarray(points, np.float64))

    @property
    def side(self) -> int:
        """Return n, the points a side of each face."""
        return isqrt(self.points.shape[-2] // 2)

    @property
    def faces(self) -> NDArray[Any]:
        """Return (..., face, row, column, 3) m, the front face first."""
        return self.points.reshape(*self.points.shape[:-2], 2, self.side, self.side, 3)

    @cached_property
    def middle(self) -> NDArray[Any]:
        """Return (..., row, column, 3) m between the faces."""
        faces = self.faces
        return 0.5 * (faces[..., 0, :, :, :] + faces[..., 1, :, :, :])


def sheets_of(forward: ForwardModel) -> Sheets:
    """Return what gives motions of cases at their `times` [s]: the forward model's own `sheets`. One that has none is
    asked for faces, whose mean is the mid-surface."""
    native: Sheets | None = getattr(forward, "sheets", None)
    return native or (lambda cases, times: [Shape(points) for points in forward.motions(cases, times)])


def area_normals(middle: Floats) -> Floats:
    """Return the normals (..., rows, columns, 3) of a mid-surface, towards the front face, as long as a cell is large.
    In its own precision."""
    across, down = np.gradient(middle, axis=-2), np.gradient(middle, axis=-3)
    return np.asarray(np.cross(down, across))  # v runs down: outwards is to the front


def normals(middle: Floats) -> Array:
    """Return the unit normals (..., rows, columns, 3) of a mid-surface, towards the front face."""
    normal = area_normals(middle)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def bilinear(at: Array, rows: int, columns: int) -> tuple[NDArray[np.intp], Array]:
    """Return the four points (k, 4) of a grid around each place `at` (k, 2), in cells across and down, numbered row by
    row, and their weights (k, 4): those of `at_places`."""
    (s, t), (i, j) = _in_cells(at, rows, columns)
    first = j * columns + i
    points = np.stack([first, first + 1, first + columns, first + columns + 1], axis=1)
    return points, np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)


def at_places(grid: Floats, places: ArrayLike) -> Array:
    """Return (..., k, d): values of a grid (..., rows, columns, d) at `places` (k, 2), shares of width and height from
    the upper left corner; bilinear between its points."""
    rows, columns = grid.shape[-3:-1]
    (s, t), (i, j) = _in_cells(np.asarray(places, dtype=float) * [columns - 1, rows - 1], rows, columns)
    s, t = s[:, None], t[:, None]
    upper = grid[..., j, i, :] * (1 - s) + grid[..., j, i + 1, :] * s
    lower = grid[..., j + 1, i, :] * (1 - s) + grid[..., j + 1, i + 1, :] * s
    return np.asarray(upper * (1 - t) + lower * t)


def _in_cells(at: Array, rows: int, columns: int) -> tuple[Array, NDArray[np.intp]]:
    """Return where places (k, 2), in cells, lie on a grid: (2, k) shares of a cell across and down, and (2, k) the
    column and row of its upper left corner."""
    low = np.clip(at.astype(int), 0, [columns - 2, rows - 2])
    return (at - low).T, low.T


def strains(middle: Floats, size: tuple[float, float]) -> Array:
    """Return engineering strain across, down, and shear [rad], (3, ..., rows, columns), of a mid-surface (..., rows,
    columns, 3) m against the flat cloth of `size` (width, height) m; by central differences, one-sided at the hems."""
    rows, columns = middle.shape[-3:-1]
    across = np.gradient(np.asarray(middle, np.float64), size[0] / (columns - 1), axis=-2)
    down = np.gradient(np.asarray(middle, np.float64), size[1] / (rows - 1), axis=-3)
    lengths = [np.linalg.norm(way, axis=-1) for way in (across, down)]
    sine = (across * down).sum(axis=-1) / (lengths[0] * lengths[1])
    return np.stack([lengths[0] - 1, lengths[1] - 1, np.arcsin(np.clip(sine, -1, 1))])


@dataclass(frozen=True, eq=False)
class LacedMuscles:
    """The muscles of one motion, one after another. contraction, tension: of the intervals between fixed points, where
    a simulator gave them; of a corrected motion they are those before the correction."""

    points: NDArray[np.float32]  # (T, p, 3) m, the axis at the fixed points
    begins: NDArray[np.int64]  # (muscles + 1,) muscle k has points begins[k]:begins[k + 1]
    sides: NDArray[np.int64]  # (muscles,) 1 on the front, -1 on the back
    diameters: Array  # (muscles,) m, outer
    contraction: NDArray[np.float32] | None = None  # (T, p - muscles), 1 - l / l0
    tension: NDArray[np.float32] | None = None  # (T, p - muscles) N

    @property
    def spans(self) -> list[slice]:
        """Return the span of each muscle's points."""
        return [slice(int(first), int(last)) for first, last in pairwise(self.begins)]

    @property
    def intervals(self) -> NDArray[np.int64]:
        """Return (p - muscles, 2) the two points of every interval."""
        starts = np.delete(np.arange(self.begins[-1]), self.begins[1:] - 1)
        return np.stack([starts, starts + 1], axis=1)

    @property
    def owners(self) -> NDArray[np.int64]:
        """Return (p - muscles,) which muscle each interval belongs to."""
        return np.repeat(np.arange(len(self.sides)), np.diff(self.begins) - 1)


def laced_muscles(
    design: Design,
    points: Floats,
    *,
    contraction: NDArray[np.float32] | None = None,
    tension: NDArray[np.float32] | None = None,
) -> LacedMuscles:
    """Return the muscles of a design on a motion's points (T, 2 n n, 3) m, its axes `axis_offset` off the
    mid-surface."""
    fabric, shape = design.fabric, Shape.of(points)
    normals = shape.faces[:, 0] - shape.middle
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    axes, sides = [np.zeros((len(points), 0, 3))], []
    for muscle in design.muscles:
        places = muscle.fixed_points() / [fabric.width, fabric.height]
        sides.append(1 if muscle.side == "front" else -1)
        off = sides[-1] * design.muscle_types[muscle.type].axis_offset
        axes.append(at_places(shape.middle + off * normals, places))
    counts = [axis.shape[1] for axis in axes]  # the first, of none, is 0
    diameters = [design.muscle_types[muscle.type].outer_diameter for muscle in design.muscles]
    return LacedMuscles(
        points=np.concatenate(axes, axis=1).astype(np.float32),
        begins=np.cumsum(counts),
        sides=np.array(sides, dtype=np.int64),
        diameters=np.array(diameters, dtype=np.float64),
        contraction=contraction,
        tension=tension,
    )


def tip(points: NDArray[np.floating], fabric: Fabric) -> Array:
    """Return (3,) m: mean position of the edge opposite the hung one; of the lower edge where no edge is hung."""
    middle = Shape.of(points).middle
    edge = fabric.hung if isinstance(fabric.hung, str) else "top"
    along = middle[:, _FREE[edge]] if edge in ("left", "right") else middle[_FREE.get(edge, -1)]
    return np.asarray(along.mean(axis=0))


def mean_curvature(points: NDArray[np.floating]) -> float:
    """Return the mean curvature [1/m] of the mid-surface, mean over its area; positive where it is hollow to the
    front."""
    middle = Shape.of(points).middle
    inner = slice(1, -1)
    u = (middle[inner, 2:] - middle[inner, :-2]) / 2
    v = (middle[2:, inner] - middle[:-2, inner]) / 2
    uu = middle[inner, 2:] - 2 * middle[inner, inner] + middle[inner, :-2]
    vv = middle[2:, inner] - 2 * middle[inner, inner] + middle[:-2, inner]
    uv = (middle[2:, 2:] - middle[2:, :-2] - middle[:-2, 2:] + middle[:-2, :-2]) / 4
    normal = np.cross(v, u)  # v runs down, u to the right: to the front
    area = np.linalg.norm(normal, axis=-1)
    normal /= area[..., None]
    e, f, g = _dot(u, u), _dot(u, v), _dot(v, v)
    h = (_dot(uu, normal) * g - 2 * _dot(uv, normal) * f + _dot(vv, normal) * e) / (2 * (e * g - f**2))
    return float((h * area).sum() / area.sum())


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))

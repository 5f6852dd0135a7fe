"""The mid-surface between the two faces of a cloth: places on it, how far it is strained, its tip and its curvature."""

from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.nouns.fabric import Fabric

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]


def two_faces(points: Floats) -> Array:
    """Return (..., face, row, column, 3) m of points (..., 2 n n, 3) m, the front face's first."""
    side = isqrt(points.shape[-2] // 2)
    return np.asarray(points, np.float64).reshape(*points.shape[:-2], 2, side, side, 3)


def mid_surface(points: Floats) -> Array:
    """Return (..., row, column, 3) m between the faces of points (..., 2 n n, 3) m, rows of rising v."""
    return np.asarray(two_faces(points).mean(axis=-4))


def cells_of(places: ArrayLike, rows: int, columns: int) -> tuple[Array, NDArray[np.intp]]:
    """Return where `places` (k, 2), shares of width and height, lie on a grid: (2, k) shares of a cell across and down,
    and (2, k) the column and row of its upper left corner."""
    return _apart(np.asarray(places, dtype=float) * [columns - 1, rows - 1], rows, columns)


def _apart(at: Array, rows: int, columns: int) -> tuple[Array, NDArray[np.intp]]:
    """Return places (k, 2) in cells as `cells_of` does."""
    low = np.clip(at.astype(int), 0, [columns - 2, rows - 2])
    return (at - low).T, low.T


def bilinear(at: Array, rows: int, columns: int) -> tuple[NDArray[np.intp], Array]:
    """Return the four points (k, 4) of a grid around each place `at` (k, 2), in cells across and down, numbered row by
    row, and their weights (k, 4): those of `at_places`."""
    (s, t), (i, j) = _apart(at, rows, columns)
    first = j * columns + i
    points = np.stack([first, first + 1, first + columns, first + columns + 1], axis=1)
    return points, np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)


def normals(middle: Floats) -> Array:
    """Return the unit normals (..., rows, columns, 3) of a mid-surface, towards the front face."""
    across, down = np.gradient(middle, axis=-2), np.gradient(middle, axis=-3)
    normal = np.cross(down, across)  # v runs down: outwards is to the front
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def at_places(grid: Floats, places: ArrayLike) -> Array:
    """Return (..., k, d): values of a grid (..., rows, columns, d) at `places` (k, 2), shares of width and height from
    the upper left corner; bilinear between its points."""
    (s, t), (i, j) = cells_of(places, *grid.shape[-3:-1])
    s, t = s[:, None], t[:, None]
    upper = grid[..., j, i, :] * (1 - s) + grid[..., j, i + 1, :] * s
    lower = grid[..., j + 1, i, :] * (1 - s) + grid[..., j + 1, i + 1, :] * s
    return np.asarray(upper * (1 - t) + lower * t)


def strains(middle: Floats, size: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Return engineering strain across, down, and shear [rad], each (..., rows, columns), of a mid-surface (..., rows,
    columns, 3) m against the flat cloth of `size` (width, height) m; by central differences, one-sided at the hems."""
    rows, columns = middle.shape[-3:-1]
    across = np.gradient(np.asarray(middle, np.float64), size[0] / (columns - 1), axis=-2)
    down = np.gradient(np.asarray(middle, np.float64), size[1] / (rows - 1), axis=-3)
    lengths = [np.linalg.norm(way, axis=-1) for way in (across, down)]
    sine = (across * down).sum(axis=-1) / (lengths[0] * lengths[1])
    return lengths[0] - 1, lengths[1] - 1, np.arcsin(np.clip(sine, -1, 1))


_FREE = {"top": -1, "bottom": 0, "left": -1, "right": 0}  # row or column of the free edge opposite the hung one


def tip(points: NDArray[np.floating], fabric: Fabric) -> Array:
    """Return (3,) m: mean position of the edge opposite the hung one; of the lower edge where no edge is hung."""
    middle = mid_surface(points)
    edge = fabric.hung if isinstance(fabric.hung, str) else "top"
    along = middle[:, _FREE[edge]] if edge in ("left", "right") else middle[_FREE.get(edge, -1)]
    return np.asarray(along.mean(axis=0))


def mean_curvature(points: NDArray[np.floating]) -> float:
    """Return the mean curvature [1/m] of the mid-surface, mean over its area; positive where it is hollow to the
    front."""
    middle = mid_surface(points)
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

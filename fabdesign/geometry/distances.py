"""Distances between two clouds, or of a cloud to a surface, by cell lists (Hockney and Eastwood 1981): points or
triangles sorted into cubes; a search looks into those near by.

Chamfer here is always: mean nearest distance from each cloud to the other, both ways, *summed*. Two samples of one
surface are not at distance zero (its floor, in `metrics`), and the measure is nearly blind in the plane.

Compiled; the kernels do not hold the interpreter's lock, so that threads search on all cores. Their first use on a
machine compiles for some seconds. SciPy's k-d trees in their place made an evaluation of clouds 1.2 times as dear for
points alone, and 2.6 times with triangles by their centres."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry import cells as kernels
from fabdesign.nouns.array import Array, Floats, Indices

_PER_CELL = 12.0  # items in an occupied cell, were they all on one flat sheet
_CELLS = 8  # at most, for each item
_TOGETHER = 1.4  # cells' edges: in cells so long lie points that are asked together about triangles
_COARSER = 3.0  # times as long are the cells that points are looked for in that are far from everything


class NearestItem(NamedTuple):
    """The nearest item of each of n points."""

    squared: Array  # (n,) m^2, distance to the nearest item
    item: Indices  # (n,)


@dataclass(frozen=True, eq=False)
class Cells:
    """Points (m, 3), or triangles (m, 9), each a corner and the two edges from it; m. At least one.

    A triangle lies in the cell of its centre, and reaches from there as far as its farthest corner.
    """

    items: Array
    coarser: float = 1.0  # the cells' edge over the one that suits the items

    @staticmethod
    def of_points(points: NDArray[Any]) -> "Cells":
        """Return the cells of a cloud (m, 3) m."""
        return Cells(np.ascontiguousarray(points, dtype=np.float64))

    def nearest(self, points: NDArray[Any], *, within: float = np.inf) -> NearestItem:
        """Return exact nearest items of points (n, 3) m. A tie goes to any of them.

        within [m]: what is farther is not looked for; where nothing is nearer, the distance is infinite, the item -1.
        """
        at = np.ascontiguousarray(points, dtype=np.float64)
        squared, item = np.full(len(at), within**2), np.full(len(at), -1, dtype=np.intp)
        pending, cells = np.arange(len(at)), self
        while len(pending):
            grid = cells._grid
            low, edge, widest, shape, *_ = grid
            long = edge * _TOGETHER if widest > 0 else edge  # those of one cell are asked together
            wide = (shape * edge / long).astype(np.int32) + np.int32(1)
            first, asked = kernels.sorted_into_cells(at, pending, low, long, wide)
            pending = kernels.search_cells(at, first, asked, grid, squared, item)
            cells = cells._next
        squared[item < 0] = np.inf
        return NearestItem(squared, item)

    def weights(self, points: NDArray[Any], item: Indices) -> Array:
        """Return (n, 2) of the two edges of each point's triangle at its place nearest to the point (n, 3) m.

        |corner + v b + w c - p|^2 is convex: the least is at the plane's foot if that is inside, else on an edge.
        """
        corner, b, c = self.items[item].reshape(-1, 3, 3).transpose(1, 2, 0)
        p = np.asarray(points, dtype=np.float64).T - corner
        bb, cc, bc, pb, pc = _dot(b, b), _dot(c, c), _dot(b, c), _dot(p, b), _dot(p, c)
        determinant, v, w = bb * cc - bc * bc, cc * pb - bc * pc, bb * pc - bc * pb
        inside = (determinant > 0) & (v >= 0) & (w >= 0) & (v + w <= determinant)
        ways = (pb, bb), (pc, cc), (bb - bc - pb + pc, bb + cc - 2 * bc)  # along each edge, and its length, squared
        with np.errstate(divide="ignore", invalid="ignore"):
            foot = np.stack([v, w]) / determinant
            at_b, at_c, across = (np.where(size > 0, np.clip(way / size, 0.0, 1.0), 0.0) for way, size in ways)
        edges = np.array([[at_b, 0 * at_b], [0 * at_c, at_c], [1.0 - across, across]])  # (edge, weight, n)
        off = p[:, None] - edges[:, 0] * b[:, None] - edges[:, 1] * c[:, None]
        nearest = np.take_along_axis(edges, _dot(off, off).argmin(axis=0)[None, None], axis=0)[0]
        return np.where(inside, foot, nearest).T

    @cached_property
    def _grid(self) -> kernels.CellGrid:
        centres, low, size, widest = kernels.centres_of(self.items)
        long = np.sort(size)[::-1]
        suits = np.sqrt(_PER_CELL * long[0] * max(long[1], 1e-3 * long[0]) / len(centres))
        edge = max(float(suits), widest) or 1.0
        while np.prod(np.floor(size / edge) + 1) > _CELLS * len(centres) + 1:
            edge *= 1.25
        edge *= self.coarser
        shape = (np.floor(size / edge) + 1).astype(np.int32)
        start, order = kernels.sorted_into_cells(centres, np.arange(len(centres)), low, edge, shape)
        bodies, boxes = kernels.bodies_of(self.items, order), kernels.boxes_of(self.items, order)
        return low, edge, widest, shape, start, order, bodies, boxes

    @cached_property
    def _next(self) -> "Cells":
        return Cells(self.items, self.coarser * _COARSER)


def _dot(a: Array, b: Array) -> Array:
    """Return the products of vectors (3, ...), in the order of their axes."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def nearest_distances(points: Floats, others: Floats) -> Array:
    """Return (n,) m: distance of each of `points` (n, 3) to the nearest of `others` (m, 3)."""
    return np.sqrt(Cells.of_points(others).nearest(points).squared)


def chamfer(a: Floats, b: Floats) -> float:
    """Return the Chamfer distance [m] of clouds (n, 3) and (m, 3): unsquared, each way the mean, both ways summed."""
    return float(nearest_distances(a, b).mean() + nearest_distances(b, a).mean())


class ChamferTo:
    """Chamfer distances of several clouds to one, which is sorted once. weights: of each of its points, which their
    distances count by, and those of the points that they are nearest to."""

    def __init__(self, cloud: Floats, weights: Array | None = None) -> None:
        self._cloud, self._cells, self._weights = cloud, Cells.of_points(cloud), weights

    def of(self, points: Floats) -> float:
        """Return `chamfer(points, cloud)` [m]."""
        nearest = self._cells.nearest(points)
        to_cloud, to_points = np.sqrt(nearest.squared), nearest_distances(self._cloud, points)
        if self._weights is None:
            return float(to_cloud.mean() + to_points.mean())
        one, other = self._weights[nearest.item], self._weights
        return float(one @ to_cloud / one.sum() + other @ to_points / other.sum())

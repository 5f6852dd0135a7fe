"""Cell lists (Hockney and Eastwood 1981): points or triangles sorted into cubes; a search looks into those near by.

Compiled; the kernels do not hold the interpreter's lock, so that threads search on all cores. Their first use on a
machine compiles for some seconds.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
Indices = NDArray[np.intp]

_ROUNDED_UP = 1 + 1e-12  # distances that must not be too short
_PER_CELL = 8.0  # items in an occupied cell, were they all on one flat sheet
_CELLS = 8  # at most, for each item
_COARSER = 3.0  # times as long are the cells that points are looked for in that are far from everything


class Found(NamedTuple):
    """For each of n points."""

    squared: Array  # (n,) m^2, distance to the nearest item
    item: Indices  # (n,)
    weights: Array  # (n, 2) of a triangle's two edges at the nearest place; 0 for points


@dataclass(frozen=True, eq=False)
class Cells:
    """Points (m, 3), or triangles (m, 9), each a corner and the two edges from it; m. At least one.

    A triangle lies in the cell of its centre, and reaches from there as far as its farthest corner.
    """

    items: Array
    coarser: float = 1.0  # the cells' edge over the one that suits the items

    @staticmethod
    def of_points(points: NDArray[Any]) -> "Cells":
        """Of a cloud (m, 3) m."""
        return Cells(np.ascontiguousarray(points, dtype=np.float64))

    def nearest(self, points: NDArray[Any], *, within: float = np.inf) -> Found:
        """Exact nearest items of points (n, 3) m. A tie goes to any of them.

        within [m]: what is farther is not looked for; where nothing is nearer, the distance is infinite, the item -1.
        """
        at = np.ascontiguousarray(points, dtype=np.float64)
        found = Found(np.full(len(at), within**2), np.full(len(at), -1, dtype=np.intp), np.zeros((len(at), 2)))
        pending, cells = np.arange(len(at)), self
        while len(pending):
            pending = _search(at, pending, *cells._grid, *found)
            cells = cells._next
        found.squared[found.item < 0] = np.inf
        return found

    @cached_property
    def _centred(self) -> tuple[Array, Array, Array, float]:
        return _centres(self.items)

    @cached_property
    def _grid(self) -> tuple[Array, float, float, Ints, Ints, Indices, Array, Array]:
        """What `_search` takes: least corner, cells' edge, how far items reach from their centres, how many cells each
        way, first place of each cell's items in their order, that order, and centres and items in it."""
        centres, low, size, widest = self._centred
        long = np.sort(size)[::-1]
        suits = np.sqrt(_PER_CELL * long[0] * max(long[1], 1e-3 * long[0]) / len(centres))
        edge = max(float(suits), widest) or 1.0
        while np.prod(np.floor(size / edge) + 1) > _CELLS * len(centres) + 1:
            edge *= 1.25
        edge *= self.coarser
        shape = (np.floor(size / edge) + 1).astype(np.int32)
        start, order = _sort(centres, low, edge, shape)
        return low, edge, widest, shape, start, order, centres[order], self.items[order]

    @cached_property
    def _next(self) -> "Cells":
        return Cells(self.items, self.coarser * _COARSER)


@njit(cache=True, nogil=True)
def _centres(items: Array) -> tuple[Array, Array, Array, float]:
    """(m, 3) centres, least corner (3,) and size (3,) of their box, and how far an item reaches from its centre."""
    count, width = items.shape
    centres, widest = np.empty((count, 3)), 0.0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(count):
        for a in range(3):
            centres[i, a] = items[i, a] if width == 3 else items[i, a] + (items[i, a + 3] + items[i, a + 6]) / 3
            low[a], high[a] = min(low[a], centres[i, a]), max(high[a], centres[i, a])
        if width == 9:
            first = second = third = 0.0
            for a in range(3):
                b, c = items[i, a + 3], items[i, a + 6]
                first += ((b + c) / 3) ** 2
                second += (b - (b + c) / 3) ** 2
                third += (c - (b + c) / 3) ** 2
            widest = max(widest, first, second, third)
    return centres, low, high - low, np.sqrt(widest) * _ROUNDED_UP


@njit(cache=True, nogil=True)
def _sort(centres: Array, low: Array, edge: float, shape: Ints) -> tuple[Ints, Indices]:
    """(cells + 1,) first place of each cell's items in the order, and that order, cell by cell."""
    cell = np.empty(len(centres), dtype=np.int32)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.int32)
    for i in range(len(centres)):
        c = 0
        for a in range(3):
            c = c * shape[a] + min(int((centres[i, a] - low[a]) / edge), shape[a] - 1)
        cell[i] = c
        start[c + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    order, place = np.empty(len(centres), dtype=np.intp), start[:-1].copy()
    for i in range(len(centres)):
        order[place[cell[i]]] = i
        place[cell[i]] += 1
    return start, order


@njit(cache=True, nogil=True)
def _search(
    points: Array,
    pending: Indices,
    low: Array,
    edge: float,
    widest: float,
    shape: Ints,
    start: Ints,
    order: Indices,
    centres: Array,
    items: Array,
    squared: Array,
    item: Indices,
    weights: Array,
) -> Indices:
    """Nearest items of the pending points among those in their own cells and the ones around; those left unsure.

    All centres nearer than an edge and the way to the own cell's wall are there, and an item nearer than what is found
    has its centre within that and how far items reach.
    """
    left, unsure = np.empty_like(pending), 0
    own = np.empty(3, dtype=np.int64)
    for i in pending:
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        wall, inside, all_seen = np.inf, True, True
        for a in range(3):
            place = (points[i, a] - low[a]) / edge
            own[a] = int(np.floor(place))
            wall = min(wall, edge * min(place - own[a], own[a] + 1 - place))
            inside = inside and -1 <= own[a] <= shape[a]
            all_seen = all_seen and own[a] <= 1 and shape[a] - own[a] <= 2
        best = squared[i]
        limit = (np.sqrt(best) * _ROUNDED_UP + widest) ** 2 if widest > 0 else best  # of a centre's square
        z0, z1 = max(own[2] - 1, 0), min(own[2] + 2, shape[2])
        for step in range(9 if inside else 0):
            t = (step + 4) % 9  # the own column first
            x, y = own[0] + t // 3 - 1, own[1] + t % 3 - 1
            if x < 0 or x >= shape[0] or y < 0 or y >= shape[1]:
                continue
            column = (x * shape[1] + y) * shape[2]
            for k in range(start[column + z0], start[column + z1]):
                d0, d1, d2 = p0 - centres[k, 0], p1 - centres[k, 1], p2 - centres[k, 2]
                q, v, w = d0 * d0 + d1 * d1 + d2 * d2, 0.0, 0.0
                if q >= limit:
                    continue
                if items.shape[1] == 9:
                    q, v, w = _to_triangle(p0, p1, p2, items, k)
                    if q >= best:
                        continue
                best, item[i], weights[i, 0], weights[i, 1] = q, order[k], v, w
                limit = (np.sqrt(best) * _ROUNDED_UP + widest) ** 2 if widest > 0 else best
        squared[i] = best
        if not all_seen and limit > (edge + wall) ** 2:
            left[unsure] = i
            unsure += 1
    return left[:unsure]


@njit(cache=True, nogil=True)
def _to_triangle(p0: float, p1: float, p2: float, items: Array, k: int) -> tuple[float, float, float]:
    """Squared distance of a point to a triangle (corner, edges b and c from it), and the weights of its edges there.

    |corner + v b + w c - p|^2 is convex: the least is at the plane's foot if that is inside, else on an edge.
    """
    p0, p1, p2 = p0 - items[k, 0], p1 - items[k, 1], p2 - items[k, 2]
    b0, b1, b2 = items[k, 3], items[k, 4], items[k, 5]
    c0, c1, c2 = items[k, 6], items[k, 7], items[k, 8]
    bb, cc, bc = _squared(b0, b1, b2), _squared(c0, c1, c2), b0 * c0 + b1 * c1 + b2 * c2
    pb, pc = p0 * b0 + p1 * b1 + p2 * b2, p0 * c0 + p1 * c1 + p2 * c2
    determinant = bb * cc - bc * bc
    v, w = cc * pb - bc * pc, bb * pc - bc * pb
    if determinant > 0 and v >= 0 and w >= 0 and v + w <= determinant:
        v, w = v / determinant, w / determinant
        return _squared(p0 - v * b0 - w * c0, p1 - v * b1 - w * c1, p2 - v * b2 - w * c2), v, w
    v = min(max(pb / bb, 0.0), 1.0) if bb > 0 else 0.0
    least, best_v, best_w = _squared(p0 - v * b0, p1 - v * b1, p2 - v * b2), v, 0.0
    w = min(max(pc / cc, 0.0), 1.0) if cc > 0 else 0.0
    q = _squared(p0 - w * c0, p1 - w * c1, p2 - w * c2)
    if q < least:
        least, best_v, best_w = q, 0.0, w
    across = bb + cc - 2 * bc
    w = min(max((bb - bc - pb + pc) / across, 0.0), 1.0) if across > 0 else 0.0
    v = 1.0 - w
    q = _squared(p0 - v * b0 - w * c0, p1 - v * b1 - w * c1, p2 - v * b2 - w * c2)
    if q < least:
        least, best_v, best_w = q, v, w
    return least, best_v, best_w


@njit(cache=True, nogil=True, inline="always")
def _squared(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z

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
Place = int | np.int64 | np.uint64  # of an item: unsigned where it counts up, which compiles to less

_ROUNDED_UP = 1 + 1e-12  # distances that must not be too short
_PER_CELL = 8.0  # items in an occupied cell, were they all on one flat sheet
_CELLS = 8  # at most, for each item
_COARSER = 3.0  # times as long are the cells that points are looked for in that are far from everything
_WIDE = 3.5  # cells' edges: from a point with an item in the cells around, as far as a nearer one can be
_SLIM = 1e-4  # of the product of its edges: a triangle's normal is not asked where twice its area is less


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
        low, edge, _, shape, *_ = self._grid
        (_, pending), cells = _sort(at, low, edge, shape), self  # neighbours in a row find what is at hand
        while len(pending):
            pending = _search(at, pending, *cells._grid, *found)
            cells = cells._next
        found.squared[found.item < 0] = np.inf
        return found

    @staticmethod
    def of_triangles(vertices: Array, triangles: Indices) -> "Cells":
        """Of a mesh: vertices (m, 3) m, and the corners of each triangle (t, 3)."""
        return Cells(_corner_and_edges(vertices, triangles))

    @cached_property
    def _centred(self) -> tuple[Array, Array, Array, float]:
        return _centres(self.items)

    @cached_property
    def _grid(self) -> tuple[Array, float, float, Ints, Ints, Indices, Array, Array]:
        """What `_search` takes: least corner, cells' edge, how far items reach from their centres, how many cells each
        way, first place of each cell's items in their order, that order, and `_bodies` and items in it."""
        centres, low, size, widest = self._centred
        long = np.sort(size)[::-1]
        suits = np.sqrt(_PER_CELL * long[0] * max(long[1], 1e-3 * long[0]) / len(centres))
        edge = max(float(suits), widest) or 1.0
        while np.prod(np.floor(size / edge) + 1) > _CELLS * len(centres) + 1:
            edge *= 1.25
        edge *= self.coarser
        shape = (np.floor(size / edge) + 1).astype(np.int32)
        start, order = _sort(centres, low, edge, shape)
        items = self.items[order]
        return low, edge, widest, shape, start, order, _bodies(items), items

    @cached_property
    def _next(self) -> "Cells":
        return Cells(self.items, self.coarser * _COARSER)


@njit(cache=True, nogil=True, error_model="numpy")
def _corner_and_edges(vertices: Array, triangles: Indices) -> Array:
    items = np.empty((len(triangles), 9))
    for k in range(len(triangles)):
        for a in range(3):
            corner = vertices[triangles[k, 0], a]
            items[k, a] = corner
            items[k, a + 3] = vertices[triangles[k, 1], a] - corner
            items[k, a + 6] = vertices[triangles[k, 2], a] - corner
    return items


@njit(cache=True, nogil=True, error_model="numpy")
def _bodies(items: Array) -> Array:
    """(3, m) centres; of triangles (7, m), unit normals (0 where there is none) and how far each reaches besides."""
    bodies = np.empty((3 if items.shape[1] == 3 else 7, len(items)))
    for k in range(len(items)):
        if items.shape[1] == 3:
            for a in range(3):
                bodies[a, k] = items[k, a]
            continue
        b0, b1, b2, c0, c1, c2 = items[k, 3], items[k, 4], items[k, 5], items[k, 6], items[k, 7], items[k, 8]
        n0, n1, n2 = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
        bb, cc, bc = _squared(b0, b1, b2), _squared(c0, c1, c2), b0 * c0 + b1 * c1 + b2 * c2
        long = np.sqrt(_squared(n0, n1, n2))
        scale = 1 / long if long > _SLIM * np.sqrt(bb * cc) else 0.0
        bodies[3, k], bodies[4, k], bodies[5, k] = scale * n0, scale * n1, scale * n2
        for a in range(3):
            bodies[a, k] = items[k, a] + (items[k, a + 3] + items[k, a + 6]) / 3
        bodies[6, k] = _reach(bb, cc, bc)
    return bodies


@njit(cache=True, nogil=True, error_model="numpy")
def _reach(bb: float, cc: float, bc: float) -> float:
    """How far a triangle with edges b and c (by their products) reaches from its centre (b + c) / 3."""
    squared = max(bb + cc + 2 * bc, max(4 * bb + cc, bb + 4 * cc) - 4 * bc)
    return np.sqrt(max(squared, 0.0)) / 3 * _ROUNDED_UP


@njit(cache=True, nogil=True, error_model="numpy")
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
            bb = cc = bc = 0.0
            for a in range(3):
                b, c = items[i, a + 3], items[i, a + 6]
                bb, cc, bc = bb + b * b, cc + c * c, bc + b * c
            widest = max(widest, _reach(bb, cc, bc))
    return centres, low, high - low, widest


@njit(cache=True, nogil=True, error_model="numpy")
def _sort(points: Array, low: Array, edge: float, shape: Ints) -> tuple[Ints, Indices]:
    """(cells + 1,) first place of each cell's points in the order, and that order, cell by cell; a point outside counts
    to the cell at the border."""
    cell = np.empty(len(points), dtype=np.int32)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.int32)
    for i in range(len(points)):
        c = 0
        for a in range(3):
            place = (points[i, a] - low[a]) / edge
            c = c * shape[a] + (int(min(max(place, 0.0), shape[a] - 1.0)) if place == place else 0)
        cell[i] = c
        start[c + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    order, place = np.empty(len(points), dtype=np.intp), start[:-1].copy()
    for i in range(len(points)):
        order[place[cell[i]]] = i
        place[cell[i]] += 1
    return start, order


@njit(cache=True, nogil=True, error_model="numpy")
def _search(
    points: Array,
    pending: Indices,
    low: Array,
    edge: float,
    widest: float,
    shape: Ints,
    start: Ints,
    order: Indices,
    bodies: Array,
    items: Array,
    squared: Array,
    item: Indices,
    weights: Array,
) -> Indices:
    """Nearest items of the pending points; those left that have nothing near and may have something far off.

    First comes the item with the nearest centre in a point's own cell, else in the cells around. Whatever is nearer has
    its centre within that distance and how far items reach: cells that come so near are looked through.
    """
    left, unsure, least_of = np.empty_like(pending), 0, np.empty(len(order))
    at, own, first, last = np.empty(3), np.empty(3, dtype=np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    for i in pending:
        for a in range(3):
            at[a] = points[i, a] - low[a]
        if not np.isfinite(at[0] + at[1] + at[2]):  # what is nowhere is near nothing
            continue
        near = True
        for a in range(3):
            own[a] = int(np.floor(at[a] / edge))
            near = near and -1 <= own[a] <= shape[a]
        best, p0, p1, p2 = squared[i], points[i, 0], points[i, 1], points[i, 2]
        middle = _nearest_centre(p0, p1, p2, own, shape, start, bodies) if near else -1
        if middle >= 0:
            q, v, w = _to_item(p0, p1, p2, items, middle)
            if q < best:
                best, item[i], weights[i, 0], weights[i, 1] = q, order[middle], v, w
        limit = np.sqrt(best) * _ROUNDED_UP + widest  # of a centre's distance
        if limit > _WIDE * edge:
            left[unsure] = i
            unsure += 1
            continue
        for a in range(3):
            first[a] = max(int(np.floor((at[a] - limit) / edge)), 0)
            last[a] = min(int(np.floor((at[a] + limit) / edge)), shape[a] - 1)
        if first[0] > last[0] or first[1] > last[1] or first[2] > last[2]:
            continue  # all cells are farther than what is looked for
        for x in range(first[0], last[0] + 1):
            aside_x = max(edge * x - at[0], at[0] - edge * (x + 1), 0.0)
            for y in range(first[1], last[1] + 1):
                aside_y = max(edge * y - at[1], at[1] - edge * (y + 1), 0.0)
                if aside_x * aside_x + aside_y * aside_y > limit * limit:
                    continue
                column = (x * shape[1] + y) * shape[2]
                begin, end = np.uint64(start[column + first[2]]), np.uint64(start[column + last[2] + 1])
                _at_least(p0, p1, p2, bodies, begin, end, least_of)
                for k in range(begin, end):
                    if least_of[k] < best:
                        q, v, w = _to_item(p0, p1, p2, items, k)
                        if q < best:
                            best, item[i], weights[i, 0], weights[i, 1] = q, order[k], v, w
        squared[i] = best
    return left[:unsure]


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_centre(p0: float, p1: float, p2: float, own: Indices, shape: Ints, start: Ints, bodies: Array) -> Place:
    """Place of the item with the nearest centre in the column of a point's own cell, and where that is empty in those
    beside it; -1 where they all are."""
    found, nearest = np.int64(-1), np.inf
    z0, z1 = max(own[2] - 1, 0), min(own[2] + 1, shape[2] - 1)
    for around in range(2):
        for x in range(max(own[0] - around, 0), min(own[0] + around, shape[0] - 1) + 1):
            for y in range(max(own[1] - around, 0), min(own[1] + around, shape[1] - 1) + 1):
                column = (x * shape[1] + y) * shape[2]
                for k in range(np.uint64(start[column + z0]), np.uint64(start[column + z1 + 1])):
                    q = _squared(p0 - bodies[0, k], p1 - bodies[1, k], p2 - bodies[2, k])
                    if q < nearest:
                        found, nearest = np.int64(k), q
        if found >= 0:
            break
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _at_least(p0: float, p1: float, p2: float, bodies: Array, begin: Place, end: Place, squared: Array) -> None:
    """Squared distances of a point to the items from `begin` on, of triangles at least so much: the height over the
    plane, and beside that what the disc around the centre leaves. Loops without branches, for the vector units."""
    if len(bodies) == 3:
        for k in range(begin, end):
            squared[k] = _squared(p0 - bodies[0, k], p1 - bodies[1, k], p2 - bodies[2, k])
        return
    for k in range(begin, end):
        d0, d1, d2 = p0 - bodies[0, k], p1 - bodies[1, k], p2 - bodies[2, k]
        off = d0 * bodies[3, k] + d1 * bodies[4, k] + d2 * bodies[5, k]
        off = off * off
        beside = max(np.sqrt(max(_squared(d0, d1, d2) - off, 0.0)) - bodies[6, k], 0.0)
        squared[k] = off + beside * beside


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _to_item(p0: float, p1: float, p2: float, items: Array, k: Place) -> tuple[float, float, float]:
    """Squared distance to a point or triangle, and the weights of a triangle's edges there."""
    if items.shape[1] == 3:
        return _squared(p0 - items[k, 0], p1 - items[k, 1], p2 - items[k, 2]), 0.0, 0.0
    return _to_triangle(p0, p1, p2, items, k)


@njit(cache=True, nogil=True, error_model="numpy")
def _to_triangle(p0: float, p1: float, p2: float, items: Array, k: Place) -> tuple[float, float, float]:
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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _squared(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z

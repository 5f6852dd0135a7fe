"""The cells of `distances`: points or triangles sorted into them, and laid out as the search takes them; and the search
of the nearest item of each point, asked of the cells near by. Compiled, and kept by numba: a compiled function of
another file must not be called here, for numba would not see when that file changes."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fabdesign.nouns.array import Array, Indices
from fabdesign.runtime.working_time import watch_numba

watch_numba()

Ints = NDArray[np.int32]
Place = int | np.int64 | np.uint64  # unsigned where it counts up, which compiles to less

# cells and what lies in them, as the search takes it: their least corner (3,) and edge [m], how far items reach from
# their centres, cells each way (3,), the first place of each cell's items in their order, that order, and `bodies_of`
# and `boxes_of` in it. A plain tuple: numba's cache could not be read once a class of its own was renamed
CellGrid = tuple[Array, float, float, Ints, Ints, Indices, Array, Array]
ROUNDED_UP = 1 + 1e-12  # distances that must not be too short
_SLIM = 1e-9  # of its longest edge: a triangle less high is one in length only
_GROUP = 32  # points that are asked together, at most
_ABREAST = 8  # points that the vector units take at once
_SHORT = 0.3  # of a cell's edge, the first way
_WIDE = 3.5  # cells' edges, the farthest way


@njit(cache=True, nogil=True, error_model="numpy")
def bodies_of(items: Array, order: Indices) -> Array:
    """Return points (m, 3) in that order; triangles (m, 18), each as the search takes it: a corner, the axes of a frame
    there (along an edge, across it in the plane, the normal), the edge's length, the third corner in that frame, its
    squared distance and that of the edge's end, inverted, and how far it lies from that end along the edge."""
    if items.shape[1] == 3:
        return items[order]
    bodies = np.empty((len(items), 18))
    b, c, n = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(order)):
        i = order[k]
        bb = cc = bc = 0.0
        for a in range(3):
            b[a], c[a] = items[i, a + 3], items[i, a + 6]
            bb, cc, bc = bb + b[a] * b[a], cc + c[a] * c[a], bc + b[a] * c[a]
        # the longest edge lies along: a sliver has a direction, and where it has no normal any will do
        bodies[k, 0], bodies[k, 1], bodies[k, 2] = items[i, 0], items[i, 1], items[i, 2]
        across = bb + cc - 2 * bc
        if cc > bb and cc >= across:
            b, c = c, b
            bb, cc = cc, bb
        elif across > bb:
            for a in range(3):
                bodies[k, a] += b[a]
                b[a], c[a] = c[a] - b[a], -b[a]
            bb, cc, bc = across, bb, bb - bc
        long = np.sqrt(bb)
        scale = 1 / long if long > 0 else 0.0
        x = bc * scale
        for a in range(3):
            b[a] *= scale
            c[a] -= x * b[a]
        if long == 0:
            b[0] = 1.0
        y = np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
        if y > _SLIM * long:
            c /= y
        else:
            y = 0.0
            least = np.argmin(np.abs(b))
            for a in range(3):
                c[a] = (1.0 if a == least else 0.0) - b[least] * b[a]
            c /= np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
        n[0], n[1], n[2] = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        for a in range(3):
            bodies[k, 3 + a], bodies[k, 6 + a], bodies[k, 9 + a] = b[a], c[a], n[a]
        there, beyond = x * x + y * y, (x - long) * (x - long) + y * y
        bodies[k, 12], bodies[k, 13], bodies[k, 14] = long, x, y
        bodies[k, 15], bodies[k, 16] = 1 / there if there > 0 else 0.0, 1 / beyond if beyond > 0 else 0.0
        bodies[k, 17] = x - long
    return bodies


@njit(cache=True, nogil=True, error_model="numpy")
def _reach(bb: float, cc: float, bc: float) -> float:
    """Return how far a triangle with edges b and c (by their products) reaches from its centre (b + c) / 3."""
    squared = max(bb + cc + 2 * bc, max(4 * bb + cc, bb + 4 * cc) - 4 * bc)
    return np.sqrt(max(squared, 0.0)) / 3 * ROUNDED_UP


@njit(cache=True, nogil=True, error_model="numpy")
def centres_of(items: Array) -> tuple[Array, Array, Array, float]:
    """Return (m, 3) centres, least corner (3,) and size (3,) of their box, and how far an item reaches from its
    centre."""
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
def sorted_into_cells(points: Array, some: Indices, low: Array, edge: float, shape: Ints) -> tuple[Ints, Indices]:
    """Return (cells + 1,) first place of each cell's points in the order, and that order of those points (some,), cell
    by cell; a point outside counts to the cell at the border."""
    cell = np.empty(len(some), dtype=np.int32)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.int32)
    for k in range(len(some)):
        c = 0
        for a in range(3):
            place = (points[some[k], a] - low[a]) / edge
            c = c * shape[a] + (int(min(max(place, 0.0), shape[a] - 1.0)) if place == place else 0)
        cell[k] = c
        start[c + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    order, place = np.empty(len(some), dtype=np.intp), start[:-1].copy()
    for k in range(len(some)):
        order[place[cell[k]]] = some[k]
        place[cell[k]] += 1
    return start, order


@njit(cache=True, nogil=True, error_model="numpy")
def boxes_of(items: Array, order: Indices) -> Array:
    """Return (6, m) least and largest coordinates of each item in that order."""
    boxes = np.empty((6, len(order)))
    for k in range(len(order)):
        for a in range(3):
            p = items[order[k], a]
            least = most = 0.0
            if items.shape[1] == 9:
                b, c = items[order[k], a + 3], items[order[k], a + 6]
                least, most = min(b, c, 0.0), max(b, c, 0.0)
            boxes[a, k], boxes[a + 3, k] = p + least, p + most
    return boxes


@njit(cache=True, nogil=True, error_model="numpy")
def search_cells(points: Array, first: Ints, asked: Indices, grid: CellGrid, squared: Array, item: Indices) -> Indices:
    """Return the nearest items of the points `asked`, in the order that `sorted_into_cells` gave them; those remain
    that have nothing near and may have something far off.

    Points near each other are asked together about the items around their box: first those that come within a short way
    of it, then, as long as one may be nearer to any of them than what it has, those within twice the way.
    """
    low, edge, widest, shape, start, order, bodies, _ = grid
    unfinished, unsure, several = np.empty_like(asked), 0, len(start) > 2
    farthest = _WIDE * edge if several else np.inf
    at, best, nearest = np.empty((3, _GROUP)), np.empty(_GROUP), np.empty(_GROUP, dtype=np.int64)
    lower, upper = np.empty(3), np.empty(3)
    apart, which = np.empty(len(order)), np.empty(len(order), dtype=np.int64)
    for cell in range(len(first) - 1):
        for group in range(first[cell], first[cell + 1], _GROUP):
            members = asked[group : min(group + _GROUP, first[cell + 1])]
            lanes = np.uint64((len(members) + _ABREAST - 1) // _ABREAST * _ABREAST)
            best[:], nearest[:] = -1.0, -1  # of lanes that no point fills: nothing is nearer
            lower[:], upper[:] = np.inf, -np.inf
            for j in range(len(members)):
                i = members[j]
                off = _off_cells(points[i], low, edge, shape) - widest
                nowhere = not np.isfinite(points[i, 0] + points[i, 1] + points[i, 2])
                if nowhere or off > np.sqrt(squared[i]) * ROUNDED_UP:  # or farther than what is looked for
                    continue
                if off > farthest:
                    unfinished[unsure] = i
                    unsure += 1
                    continue
                best[j] = squared[i]
                for a in range(3):
                    at[a, j] = points[i, a]
                    lower[a], upper[a] = min(lower[a], points[i, a]), max(upper[a], points[i, a])
            done, way = -1.0, _SHORT * edge if several else np.inf
            while _most(best) > done and way <= farthest:
                reach = min(way, _most(best))
                count = _around(grid, lower, upper, done, reach, apart, which)
                _ask(bodies, which, count, lanes, at, best, nearest)
                done, way = reach, 2 * way
            for j in range(len(members)):
                if nearest[j] >= 0:
                    squared[members[j]], item[members[j]] = best[j], order[nearest[j]]
                if best[j] >= 0 and np.sqrt(best[j]) * ROUNDED_UP > done:
                    unfinished[unsure] = members[j]
                    unsure += 1
    return unfinished[:unsure]


@njit(cache=True, nogil=True, error_model="numpy")
def _off_cells(point: Array, low: Array, edge: float, shape: Ints) -> float:
    """Return how far a point lies from all cells."""
    squared = 0.0
    for a in range(3):
        squared += max(low[a] - point[a], point[a] - low[a] - edge * shape[a], 0.0) ** 2
    return np.sqrt(squared)


@njit(cache=True, nogil=True, error_model="numpy")
def _most(best: Array) -> float:
    """Return the longest distance of squared ones, rounded up; negative where all are."""
    most = best.max()
    return np.sqrt(most) * ROUNDED_UP if most >= 0 else -1.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _around(grid: CellGrid, lower: Array, upper: Array, done: float, reach: float, apart: Array, which: Indices) -> int:
    """Put into `which` the items whose boxes lie farther from the box from `lower` to `upper` than `done`, and within
    `reach`, m; how many there are. apart: (m,) room. Its loop has no branches, for the vector units."""
    low, edge, widest, shape, start, _, _, boxes = grid
    begin, end, count = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64), 0
    for a in range(3):
        least, most = lower[a] - low[a] - reach - widest, upper[a] - low[a] + reach + widest
        begin[a] = int(min(max(np.floor(least / edge), 0.0), shape[a] - 1.0))
        end[a] = int(min(max(np.floor(most / edge), 0.0), shape[a] - 1.0)) + 1
    l0, l1, l2, u0, u1, u2 = lower[0], lower[1], lower[2], upper[0], upper[1], upper[2]
    past, reach_squared = done * abs(done), reach * reach
    for u in range(begin[0], end[0]):
        for v in range(begin[1], end[1]):
            column = (u * shape[1] + v) * shape[2]
            some, others = np.uint64(start[column + begin[2]]), np.uint64(start[column + end[2]])
            for k in range(some, others):
                d0 = max(boxes[0, k] - u0, l0 - boxes[3, k], 0.0)
                d1 = max(boxes[1, k] - u1, l1 - boxes[4, k], 0.0)
                d2 = max(boxes[2, k] - u2, l2 - boxes[5, k], 0.0)
                apart[k] = d0 * d0 + d1 * d1 + d2 * d2
            for k in range(some, others):
                which[count] = k
                count += (apart[k] > past) & (apart[k] <= reach_squared)
    return count


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _ask(bodies: Array, which: Indices, count: int, lanes: Place, at: Array, best: Array, nearest: Indices) -> None:
    """Note for points `at` (3, lanes) which of the items `which` (count,) is nearer than the best so far, m^2.

    To a triangle in its own frame (u, v, height): the height, and beside it, outside, the way to the nearest edge. The
    inner loops have no branches, for the vector units.
    """
    x, y, z = at[0], at[1], at[2]
    if bodies.shape[1] == 3:
        for i in range(count):
            k = which[i]
            a0, a1, a2 = bodies[k, 0], bodies[k, 1], bodies[k, 2]
            for j in range(lanes):
                p0, p1, p2 = x[j] - a0, y[j] - a1, z[j] - a2
                q = p0 * p0 + p1 * p1 + p2 * p2
                nearer = q < best[j]
                best[j] = q if nearer else best[j]
                nearest[j] = k if nearer else nearest[j]
        return
    for i in range(count):
        k = which[i]
        a0, a1, a2 = bodies[k, 0], bodies[k, 1], bodies[k, 2]
        b0, b1, b2 = bodies[k, 3], bodies[k, 4], bodies[k, 5]
        c0, c1, c2 = bodies[k, 6], bodies[k, 7], bodies[k, 8]
        n0, n1, n2 = bodies[k, 9], bodies[k, 10], bodies[k, 11]
        length, c_u, c_v = bodies[k, 12], bodies[k, 13], bodies[k, 14]
        from_start, from_end, g_u = bodies[k, 15], bodies[k, 16], bodies[k, 17]
        for j in range(lanes):
            p0, p1, p2 = x[j] - a0, y[j] - a1, z[j] - a2
            u = p0 * b0 + p1 * b1 + p2 * b2
            v = p0 * c0 + p1 * c1 + p2 * c2
            h = p0 * n0 + p1 * n1 + p2 * n2
            w = u - length
            t = max(min(u, length), 0.0)
            beside = (u - t) * (u - t) + v * v
            t = max(min((u * c_u + v * c_v) * from_start, 1.0), 0.0)
            d, e = u - t * c_u, v - t * c_v
            beside = min(beside, d * d + e * e)
            t = max(min((w * g_u + v * c_v) * from_end, 1.0), 0.0)
            d, e = w - t * g_u, v - t * c_v
            beside = min(beside, d * d + e * e)
            inside = (c_v > 0) & (v >= 0) & (u * c_v - v * c_u >= 0) & (v * g_u - w * c_v >= 0)
            q = h * h + (0.0 if inside else beside)
            nearer = q < best[j]
            best[j] = q if nearer else best[j]
            nearest[j] = k if nearer else nearest[j]

"""Points or triangles sorted into the cells of `cells`, and laid out as the search takes them. Compiled."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
Indices = NDArray[np.intp]


# cells and what lies in them, as the search takes it: their least corner (3,) and edge [m], how far items reach from
# their centres, cells each way (3,), the first place of each cell's items in their order, that order, and `bodies_of`
# and `boxes_of` in it. A plain tuple: numba's cache could not be read once a class of its own was renamed
CellGrid = tuple[Array, float, float, Ints, Ints, Indices, Array, Array]
ROUNDED_UP = 1 + 1e-12  # distances that must not be too short
_SLIM = 1e-9  # of its longest edge: a triangle less high is one in length only


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

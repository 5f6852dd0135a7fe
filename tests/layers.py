"""How deep layers of a cloth lie inside each other: every point against every triangle, without any pairs kept."""

import numpy as np
from scipy.spatial.distance import cdist

SAME_LAYER = 0.02  # m along the cloth: nearer points belong to the same layer


def depth(middle, design):
    """Largest depth of a point in another layer of the mid-surface (n, n, 3), in thicknesses: 1 - distance / thickness
    of points twice as dense as the nodes from the triangles; infinity where an edge of the grid pierces a triangle."""
    fabric, n = design.fabric, len(middle)
    spacing = np.array([fabric.width, fabric.height]) / (n - 1)
    corners, centres = _triangles(n)
    triangles, centres = middle.reshape(-1, 3)[corners], centres * spacing
    size = 1.5 * spacing.max()  # no point of a triangle or an edge is farther from its middle, if stretched by less
    ends, places = _edges(n)
    segments = middle.reshape(-1, 3)[ends]
    for edge, triangle in _pairs(segments.mean(1), places * spacing, triangles, centres, 2 * size):
        if _pierced(segments[edge], triangles[triangle]).any():
            return np.inf
    points, at = _dense(middle)
    nearest = fabric.thickness
    for point, triangle in _pairs(points, at * spacing, triangles, centres, fabric.thickness + size):
        nearest = min(nearest, _distance(points[point], triangles[triangle]).min())
    return 1 - nearest / fabric.thickness


def _pairs(x, at, triangles, centres, radius):
    """Pairs of `x` (k, 3) and triangles (m, 3, 3) of other layers whose middles are within `radius`, by hundreds of x;
    `at`, `centres`: their places in the flat cloth."""
    for first in range(0, len(x), 500):
        part = slice(first, first + 500)
        i, j = np.nonzero((cdist(x[part], triangles.mean(1)) < radius) & (cdist(at[part], centres) > SAME_LAYER))
        if len(i):
            yield first + i, j


def _triangles(n):
    """(m, 3) nodes, and (m, 2) column and row of the middles."""
    nodes = np.arange(n * n).reshape(n, n)
    a, b, c, d = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]
    corners = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])
    row, column = np.divmod(corners, n)
    return corners, np.stack([column.mean(1), row.mean(1)], axis=1)


def _edges(n):
    """(m, 2) nodes, and (m, 2) column and row of the middles."""
    nodes = np.arange(n * n).reshape(n, n)
    ends = [np.stack(pair, axis=-1).reshape(-1, 2) for pair in ((nodes[:, :-1], nodes[:, 1:]), (nodes[:-1], nodes[1:]))]
    row, column = np.divmod(np.concatenate(ends), n)
    return np.concatenate(ends), np.stack([column.mean(1), row.mean(1)], axis=1)


def _dense(middle):
    """Nodes, middles of edges and of cells (points, 3), and their columns and rows (points, 2)."""
    n = len(middle)
    x = np.empty((2 * n - 1, 2 * n - 1, 3))
    x[::2, ::2] = middle
    x[1::2, ::2] = (middle[1:] + middle[:-1]) / 2
    x[:, 1::2] = (x[:, 2::2] + x[:, :-2:2]) / 2
    row, column = np.mgrid[: 2 * n - 1, : 2 * n - 1] / 2
    return x.reshape(-1, 3), np.stack([column, row], axis=-1).reshape(-1, 2)


def _distance(p, triangles):
    """(m,) m from points (m, 3) to triangles (m, 3, 3): the foot of the plumb line, or the nearest point of a side."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    foot = p - np.sum((p - a) * normal, axis=1)[:, None] * normal
    sides, inside = [], np.ones(len(a), bool)
    for s, e in ((a, b), (b, c), (c, a)):
        inside &= np.sum(np.cross(e - s, foot - s) * normal, axis=1) >= 0
        share = np.clip(np.sum((p - s) * (e - s), axis=1) / np.sum((e - s) ** 2, axis=1), 0, 1)
        sides.append(np.linalg.norm(s + share[:, None] * (e - s) - p, axis=1))
    return np.where(inside, np.linalg.norm(foot - p, axis=1), np.min(sides, axis=0))


def _volume(p, q, r, s):
    return np.sum(np.cross(q - p, r - p) * (s - p), axis=-1)


def _pierced(segments, triangles):
    """(m,) whether the segments (m, 2, 3) pass through the triangles (m, 3, 3): their ends lie on either side, and the
    line passes all three sides the same way round."""
    (s, e), (a, b, c) = segments.transpose(1, 0, 2), triangles.transpose(1, 0, 2)
    way = [_volume(s, e, p, q) > 0 for p, q in ((a, b), (b, c), (c, a))]
    return (_volume(a, b, c, s) * _volume(a, b, c, e) < 0) & (np.all(way, axis=0) | ~np.any(way, axis=0))

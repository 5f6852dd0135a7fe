"""Whether a cloth passes through itself."""

from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.geometry.surface import face_triangles

Array = NDArray[np.float64]
NEIGHBOURS = 3  # cells along the cloth within which an edge and a triangle belong to one layer


def pierced(points: NDArray[np.floating[Any]]) -> Array | None:
    """Where one layer of a cloth passes through another: (u, v) as shares of width and height, the middle of all edges
    of the grid's mid-surface that pierce a triangle of another layer; None where no edge does.

    points (2 n n, 3) m: front face, then back face, as `ForwardModel` gives them.
    """
    n = isqrt(len(points) // 2)
    middle = np.asarray(points, np.float64).reshape(2, n * n, 3).mean(axis=0)
    corners = face_triangles(n, n)[: 2 * (n - 1) ** 2]
    ends = _edges(n)
    triangles, segments = middle[corners], middle[ends]
    centres, middles = triangles.mean(axis=1), segments.mean(axis=1)
    # a triangle or half an edge reaches no farther from its middle than this
    reach = np.linalg.norm(triangles - centres[:, None], axis=2).max()
    reach += np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1).max() / 2
    near = cKDTree(centres).query_ball_point(middles, reach)
    edge = np.repeat(np.arange(len(ends)), [len(own) for own in near])
    triangle = np.concatenate([np.asarray(own, np.intp) for own in near])
    places = np.stack(np.divmod(np.arange(n * n), n)[::-1], axis=1)  # column and row
    apart = np.abs(places[ends].mean(axis=1)[edge] - places[corners].mean(axis=1)[triangle]).max(axis=1) > NEIGHBOURS
    edge, triangle = edge[apart], triangle[apart]
    through = _pierces(segments[edge], triangles[triangle])
    if not through.any():
        return None
    return np.asarray(places[ends[np.unique(edge[through])]].mean(axis=(0, 1)) / (n - 1))


def _edges(n: int) -> NDArray[np.intp]:
    """(m, 2) nodes of the grid's edges."""
    nodes = np.arange(n * n).reshape(n, n)
    pairs = ((nodes[:, :-1], nodes[:, 1:]), (nodes[:-1], nodes[1:]))
    return np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in pairs])


def _pierces(segments: Array, triangles: Array) -> NDArray[np.bool_]:
    """(m,) whether segments (m, 2, 3) pass through triangles (m, 3, 3): their ends lie on either side, and the line
    passes the three sides the same way round."""
    (s, e), (a, b, c) = segments.transpose(1, 0, 2), triangles.transpose(1, 0, 2)
    way = [_volume(s, e, p, q) > 0 for p, q in ((a, b), (b, c), (c, a))]
    across = _volume(a, b, c, s) * _volume(a, b, c, e) < 0
    return np.asarray(across & (np.all(way, axis=0) | ~np.any(way, axis=0)))


def _volume(p: Array, q: Array, r: Array, s: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", np.cross(q - p, r - p), s - p))

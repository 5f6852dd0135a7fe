"""Whether a cloth passes through itself: how its layers lie to each other in one shape."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.fabric import Fabric

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NEAR_CELLS, NEAR_THICKNESSES = 3, 5  # along the cloth: nearer is the same layer


def passes_through(points: NDArray[np.floating[Any]], fabric: Fabric) -> bool:
    """Whether the mid-surface of a shape pierces itself: (2 n, 3) m, front face, then back face, as many rows as
    columns. Layers that only touch, or lie inside each other by less than their thickness, do not."""
    side = round(np.sqrt(len(points) / 2))
    middle = np.asarray(points, np.float64).reshape(2, side * side, 3).mean(axis=0)
    if not np.all(np.isfinite(middle)):
        return False
    spacing = np.array([fabric.width, fabric.height]) / (side - 1)
    near = max(NEAR_CELLS * float(spacing.max()), NEAR_THICKNESSES * fabric.thickness)
    nodes = np.arange(side * side).reshape(side, side)
    rest = np.stack(np.meshgrid(*[np.arange(side)] * 2), axis=-1).reshape(-1, 2) * spacing
    ends, corners = _edges(nodes), _triangles(nodes)
    edge, triangle = _candidates(middle, rest, ends, corners, near)
    return bool(np.any(_pierced(middle[ends[edge]], middle[corners[triangle]])))


def _candidates(middle: Array, rest: Array, ends: Indices, corners: Indices, near: float) -> tuple[Indices, Indices]:
    """Edges and triangles of different layers that may meet: balls around their middles do."""
    radii = [
        np.linalg.norm(middle[parts] - middle[parts].mean(axis=1, keepdims=True), axis=2).max()
        for parts in (ends, corners)
    ]
    pairs = cKDTree(middle[ends].mean(axis=1)).sparse_distance_matrix(
        cKDTree(middle[corners].mean(axis=1)), sum(radii), output_type="ndarray"
    )
    edge, triangle = pairs["i"], pairs["j"]
    along = np.linalg.norm(rest[ends].mean(axis=1)[edge] - rest[corners].mean(axis=1)[triangle], axis=1)
    return edge[along > near], triangle[along > near]


def _edges(nodes: Indices) -> Indices:
    """(m, 2) nodes of the grid's edges and of its cells' diagonals, which bound the triangles."""
    pairs = (nodes[:, :-1], nodes[:, 1:]), (nodes[:-1], nodes[1:]), (nodes[:-1, :-1], nodes[1:, 1:])
    return np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in pairs])


def _triangles(nodes: Indices) -> Indices:
    """(m, 3) nodes, two triangles a cell."""
    a, b, c, d = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]
    return np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))])


def _pierced(segments: Array, triangles: Array) -> NDArray[np.bool_]:
    """(m,) whether segments (m, 2, 3) pass through triangles (m, 3, 3): their ends lie on either side, and their line
    passes all sides the same way round (Möller and Trumbore 1997, by volumes)."""
    (s, e), (a, b, c) = segments.transpose(1, 0, 2), triangles.transpose(1, 0, 2)
    around = np.stack([_volume(s, e, p, q) for p, q in ((a, b), (b, c), (c, a))])
    same_way = np.all(around > 0, axis=0) | np.all(around < 0, axis=0)
    return np.asarray((_volume(a, b, c, s) * _volume(a, b, c, e) < 0) & same_way)


def _volume(p: Array, q: Array, r: Array, s: Array) -> Array:
    """Six times that of a tetrahedron."""
    return np.asarray(np.einsum("mk,mk->m", np.cross(q - p, r - p), s - p))

"""The two faces of a cloth as triangles, and the exact distance of points to them."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from fabdesign.formats.toml_file import require_count
from fabdesign.geometry.distances import Cells
from fabdesign.geometry.shape import Face, Shape
from fabdesign.nouns.array import Array, Floats, Indices

_TURNED = 1e-6  # of the area of a polygon, squared


class Nearest(NamedTuple):
    """The nearest place on a surface for each of n points. The place is `weights @ vertices[triangles[triangle]]`."""

    distance: Array  # (n,) m
    signed: Array  # (n,) m, positive on the outer side of the triangle: off the sheet, for a face of a cloth
    triangle: Indices  # (n,)
    weights: Array  # (n, 3) barycentric


def fans_of(vertices: Array, corners: NDArray[Any], lengths: Indices, path: Path, *, first: int = 0) -> Indices:
    """Return the triangles (t, 3) of polygons that are cut into fans. corners: of all polygons, one after another.
    lengths: of each polygon. first: what the file calls the first vertex.

    Raises InputError for a corner that is no vertex, for too many triangles, and where a polygon is not what its fan
    covers: where a triangle is turned over, as at a corner that points inwards.
    """
    count = np.maximum(lengths - 2, 0)  # triangles of a polygon
    require_count(int(count.sum()), path, "triangles")
    start = np.repeat(np.cumsum(lengths) - lengths, count)
    second = start + np.arange(len(start)) - np.repeat(np.cumsum(count) - count, count) + 1
    triangles = corners.astype(np.intp)[np.stack([start, second, second + 1], axis=1)]
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        kind = path.suffix[1:].upper()
        raise InputError(
            f"{path}: a face names vertex {triangles.max() + first} of {len(vertices)}; expected a sound {kind}"
        )
    if (count <= 1).all():
        return triangles
    polygons = np.repeat(np.arange(len(count)), count)
    with np.errstate(over="ignore", invalid="ignore"):
        normals = Surface(vertices, triangles)._normals
        sums = np.stack([np.bincount(polygons, normals[:, axis]) for axis in range(3)], axis=1)
        turned = np.einsum("ti,ti->t", normals, sums[polygons]) < -_TURNED * np.square(sums).sum(axis=1)[polygons]
    if turned.any():
        raise InputError(
            f"{path}: a face of {lengths[polygons[turned][0]]} corners has one that points inwards; expected "
            "triangles, or convex faces"
        )
    return triangles


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh. Seen from outside, corners run counter-clockwise."""

    vertices: Array  # (m, 3) m
    triangles: Indices  # (t, 3)

    @staticmethod
    def of_faces(points: Floats, face: Face = "both") -> "Surface":
        """Return both faces of one frame of a motion, (2 n n, 3) m as `ForwardModel` gives it, or one of them."""
        side = isqrt(len(points) // 2)
        if 2 * side * side != len(points):
            raise ValueError(f"{len(points)} points are not two faces of {side} rows")
        triangles = face_triangles(side, side)
        return Surface(np.asarray(points, dtype=np.float64), half_of(triangles, face))

    def _corners(self, triangle: Indices | slice = slice(None)) -> Array:
        """Return (3, n, 3): first corner, and the two edges from it, of those triangles (n,)."""
        a, b, c = (self.vertices[self.triangles[triangle, i]] for i in range(3))
        return np.stack([a, b - a, c - a])

    @cached_property
    def areas(self) -> Array:
        """Return (t,) m^2."""
        return np.sqrt(np.einsum("ti,ti->t", self._normals, self._normals)) / 2

    def normals_of(self, triangle: Indices) -> Array:
        """Return (n, 3) of those triangles (n,), of unit length, outwards."""
        return self._normals[triangle] / (2 * self.areas[triangle, None])

    @cached_property
    def _normals(self) -> Array:
        """Return (t, 3), twice the area long."""
        _, ab, ac = self._corners()
        return _cross(ab, ac)

    def nearest(self, points: Floats) -> Nearest:
        """Return exact nearest places for points (n, 3) m."""
        at: Array = np.asarray(points, dtype=np.float64)
        squared, triangle = self._cells.nearest(at)
        edges = self._cells.weights(at, triangle)
        weights = np.concatenate([1 - edges.sum(axis=1, keepdims=True), edges], axis=1)
        a, ab, ac = self._corners(triangle)
        offset = at - a - edges[:, :1] * ab - edges[:, 1:] * ac
        distance = np.sqrt(squared)
        outside = np.einsum("nd,nd->n", offset, np.cross(ab, ac)) >= 0
        return Nearest(distance, np.where(outside, distance, -distance), triangle, weights)

    def distance(self, points: Floats, *, within: float = np.inf) -> Array:
        """Return (n,) m from points (n, 3) to their nearest places; infinite where that is not within `within` [m]."""
        return np.sqrt(self._cells.nearest(points, within=within).squared)

    @cached_property
    def _cells(self) -> Cells:
        return Cells(np.concatenate(self._corners(), axis=1))

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Array, Indices]:
        """Return (count, 3) points, uniform over the area, and the triangles (count,) that they lie in."""
        triangle = rng.choice(len(self.areas), count, p=self.areas / self.areas.sum())
        v, w = rng.random((2, count))
        v, w = np.where(v + w > 1, 1 - v, v), np.where(v + w > 1, 1 - w, w)
        a, ab, ac = self._corners(triangle)
        return a + v[:, None] * ab + w[:, None] * ac, triangle


def _cross(a: Array, b: Array) -> Array:
    """Return numpy's cross of (n, 3), four times as fast."""
    (a0, a1, a2), (b0, b1, b2) = a.T, b.T
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=1)


def half_of(faces: Floats | Indices, face: Face) -> Any:
    """Return what belongs to `face` of what is listed for the front face, then for the back face."""
    half = len(faces) // 2
    return {"both": faces, "front": faces[:half], "back": faces[half:]}[face]


@lru_cache
def face_triangles(rows: int, cols: int) -> Indices:
    """Return the (4 (rows - 1) (cols - 1), 3) triangles of two faces of rows x cols points, outer side off the sheet.

    Vertices are numbered as in the simulator's output: front face, then back face, each by rising v, then rising u.
    """
    corner = np.arange(rows * cols).reshape(rows, cols)
    a, b = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()  # left and right above
    c, d = corner[1:, :-1].ravel(), corner[1:, 1:].ravel()  # left and right below
    front = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    triangles = np.concatenate([front, front[:, ::-1] + rows * cols])
    triangles.setflags(write=False)
    return triangles


def front_triangles(rows: int, cols: int) -> Indices:
    """Return the triangles of one face, which are those of a mid-surface."""
    return np.asarray(half_of(face_triangles(rows, cols), "front"))


CAP = 0.010  # m, of a distance to a surface: strays beyond it do not decide


def capped_rms(distance: Array, shares: Array | None = None) -> float:
    """Return the root mean square [m] of capped distances. shares: of each in the mean, by default all alike."""
    return float(np.sqrt(np.average(np.square(np.minimum(np.abs(distance), CAP)), weights=shares)))


NEIGHBOURS = 3  # cells along the cloth within which an edge and a triangle belong to one layer


def pierced(points: NDArray[np.floating[Any]]) -> Array | None:
    """Return where one layer of a cloth passes through another: (u, v) as shares of width and height, the middle of all
    edges of the grid's mid-surface that pierce a triangle of another layer; None where no edge does.

    points (2 n n, 3) m: front face, then back face, as `ForwardModel` gives them.
    """
    shape = Shape.of(points)
    n, middle = shape.side, shape.middle.reshape(-1, 3)
    corners = front_triangles(n, n)
    nodes = np.arange(n * n).reshape(n, n)
    pairs = (nodes[:, :-1], nodes[:, 1:]), (nodes[:-1], nodes[1:])
    ends = np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in pairs])  # of the grid's edges
    triangles, segments = middle[corners], middle[ends]
    centres, middles = triangles.mean(axis=1), segments.mean(axis=1)
    # a triangle or half an edge reaches no farther from its middle than this
    reach = np.linalg.norm(triangles - centres[:, None], axis=2).max()
    reach += np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1).max() / 2
    neighbours = cKDTree(centres).query_ball_point(middles, reach)
    edge = np.repeat(np.arange(len(ends)), [len(indices) for indices in neighbours])
    triangle = np.concatenate([np.asarray(indices, np.intp) for indices in neighbours])
    places = np.stack(np.divmod(np.arange(n * n), n)[::-1], axis=1)  # column and row
    apart = np.abs(places[ends].mean(axis=1)[edge] - places[corners].mean(axis=1)[triangle]).max(axis=1) > NEIGHBOURS
    edge, triangle = edge[apart], triangle[apart]
    through = _pierces(segments[edge], triangles[triangle])
    if not through.any():
        return None
    return np.asarray(places[ends[np.unique(edge[through])]].mean(axis=(0, 1)) / (n - 1))


def _pierces(segments: Array, triangles: Array) -> NDArray[np.bool_]:
    """Return (m,) whether segments (m, 2, 3) pass through triangles (m, 3, 3): their ends lie on either side, and the
    line passes the three sides the same way round."""
    (s, e), (a, b, c) = segments.transpose(1, 0, 2), triangles.transpose(1, 0, 2)
    way = [_volume(s, e, p, q) > 0 for p, q in ((a, b), (b, c), (c, a))]
    across = _volume(a, b, c, s) * _volume(a, b, c, e) < 0
    return np.asarray(across & (np.all(way, axis=0) | ~np.any(way, axis=0)))


def _volume(p: Array, q: Array, r: Array, s: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", np.cross(q - p, r - p), s - p))

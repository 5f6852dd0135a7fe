"""The two faces of a cloth as triangles, and the exact distance of points to them."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import isqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
Indices = NDArray[np.intp]

_CANDIDATES = 10  # nearest centroids asked for every point
_ROUNDING = 1e-9  # m


class Nearest(NamedTuple):
    """The nearest place on a surface for each of n points. The place is `weights @ vertices[triangles[triangle]]`."""

    distance: Array  # (n,) m
    signed: Array  # (n,) m, positive on the outer side of the triangle: off the sheet, for a face of a cloth
    triangle: Indices  # (n,)
    weights: Array  # (n, 3) barycentric


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh. Seen from outside, corners run counter-clockwise."""

    vertices: Array  # (m, 3) m
    triangles: Indices  # (t, 3)

    @staticmethod
    def of_faces(points: Floats, rows: int | None = None) -> "Surface":
        """Both faces of one frame of a motion, (2 rows cols, 3) m as `ForwardModel` gives it; square without `rows`."""
        per_face = len(points) // 2
        rows = rows or isqrt(per_face)
        if rows * (per_face // rows) * 2 != len(points):
            raise ValueError(f"{len(points)} points are not two faces of {rows} rows")
        return Surface(np.asarray(points, dtype=np.float64), face_triangles(rows, per_face // rows))

    @cached_property
    def _corners(self) -> Array:
        """(3, t, 3): first corner, and the two edges from it."""
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        return np.stack([a, b - a, c - a])

    @cached_property
    def areas(self) -> Array:
        """(t,) m^2."""
        return np.asarray(np.linalg.norm(self._normals, axis=1) / 2)

    @cached_property
    def normals(self) -> Array:
        """(t, 3), of unit length, outwards."""
        return self._normals / (2 * self.areas[:, None])

    @cached_property
    def _normals(self) -> Array:
        """(t, 3), twice the area long."""
        _, ab, ac = self._corners
        return np.cross(ab, ac)

    def nearest(self, points: Floats) -> Nearest:
        """Exact nearest places for points (n, 3).

        A triangle lies within `reach` of its centroid, so none whose centroid is further than a distance already found
        plus `reach` can be nearer. Points whose last candidate is not that far get all centroids up to there.
        """
        at: Array = np.asarray(points, dtype=np.float64)
        count = min(_CANDIDATES, len(self.triangles))
        a, ab, ac = self._corners
        centroids = a + (ab + ac) / 3
        reach = np.sqrt(np.max([np.square(p - centroids).sum(axis=1) for p in (a, a + ab, a + ac)]))
        tree = cKDTree(centroids)
        spread, candidates = tree.query(at, k=np.arange(1, count + 1))
        found, *_ = self._best(at, np.ones(len(at), dtype=np.intp), candidates[:, 0])
        tried = spread <= found[:, None] + reach + _ROUNDING
        found, triangle, weights = self._best(at, tried.sum(axis=1), candidates[tried])
        doubtful = np.flatnonzero(found + reach + _ROUNDING > spread[:, -1]) if count < len(centroids) else np.arange(0)
        if len(doubtful):
            within = tree.query_ball_point(at[doubtful], found[doubtful] + reach + _ROUNDING)
            counts = np.array([len(some) for some in within])
            _, triangle[doubtful], weights[doubtful] = self._best(at[doubtful], counts, np.concatenate(within))
        offset = at - np.einsum("nc,ncd->nd", weights, self.vertices[self.triangles[triangle]])
        distance = np.linalg.norm(offset, axis=1)
        outside = np.einsum("nd,nd->n", offset, self._normals[triangle]) >= 0
        return Nearest(distance, np.where(outside, distance, -distance), triangle, weights)

    def _best(self, points: Array, counts: Indices, candidates: Indices) -> tuple[Array, Indices, Array]:
        """(n,) least distance, (n,) its triangle, (n, 3) its weights; candidates: those of each point in a row."""
        squared, v, w = self._closest(np.repeat(points, counts, axis=0), candidates)
        start = np.cumsum(counts) - counts
        least = np.minimum.reduceat(squared, start)
        hit = np.flatnonzero(squared == np.repeat(least, counts))
        best = hit[np.searchsorted(hit, start)]  # the first of each point's own
        return np.sqrt(least), candidates[best], np.stack([1 - v[best] - w[best], v[best], w[best]], axis=1)

    def _closest(self, points: Array, triangle: Indices) -> tuple[Array, Array, Array]:
        """Squared distance of each point to its triangle and the weights (v, w) of the edges ab, ac at that place.

        q(v, w) = |a + v ab + w ac - p|^2 is convex: its least value is inside, or the least of those on the edges.
        """
        a, ab, ac = self._corners
        d00, d01, d11, inv_ab, inv_ac, inv_bc, inv_det = (x[triangle] for x in self._products)
        ap = [points[:, i] - a[:, i][triangle] for i in range(3)]
        d1 = sum(ap[i] * ab[:, i][triangle] for i in range(3))
        d2 = sum(ap[i] * ac[:, i][triangle] for i in range(3))
        zero = np.zeros_like(d1)
        v, w = (d11 * d1 - d01 * d2) * inv_det, (d00 * d2 - d01 * d1) * inv_det
        inside = (v >= 0) & (w >= 0) & (v + w <= 1)
        on_bc = ((d2 - d1 + d00 - d01) * inv_bc).clip(0, 1)
        # where the projection is outside, (0, 0) stands in for it: a corner, no better than the edges
        best_v, best_w = np.where(inside, v, 0.0), np.where(inside, w, 0.0)
        best = best_v * (best_v * d00 + 2 * best_w * d01 - 2 * d1) + best_w * (best_w * d11 - 2 * d2)
        for v, w in (((d1 * inv_ab).clip(0, 1), zero), (zero, (d2 * inv_ac).clip(0, 1)), (1 - on_bc, on_bc)):
            q = v * (v * d00 + 2 * w * d01 - 2 * d1) + w * (w * d11 - 2 * d2)
            better = q < best
            best, best_v, best_w = np.where(better, q, best), np.where(better, v, best_v), np.where(better, w, best_w)
        return (best + sum(x * x for x in ap)).clip(0), best_v, best_w

    @cached_property
    def _products(self) -> Array:
        """(7, t): ab.ab, ab.ac, ac.ac and the inverses of |ab|^2, |ac|^2, |bc|^2 and of the determinant."""
        _, ab, ac = self._corners
        d00, d01, d11 = (np.einsum("ij,ij->i", x, y) for x, y in ((ab, ab), (ab, ac), (ac, ac)))
        inverted = np.stack([d00, d11, d00 + d11 - 2 * d01, d00 * d11 - d01**2])
        return np.vstack([d00, d01, d11, 1 / inverted.clip(np.finfo(float).tiny)])

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """(count, 3) points, uniform over the area, and the outer unit normals there."""
        triangle = rng.choice(len(self.triangles), size=count, p=self.areas / self.areas.sum())
        v, w = rng.random((2, count))
        v, w = np.where(v + w > 1, 1 - v, v), np.where(v + w > 1, 1 - w, w)
        a, ab, ac = self._corners[:, triangle]
        normals = self.normals[triangle]
        return a + v[:, None] * ab + w[:, None] * ac, normals


@lru_cache
def face_triangles(rows: int, cols: int) -> Indices:
    """(4 (rows - 1) (cols - 1), 3) triangles of two faces of rows x cols points, outer side off the sheet.

    Vertices are numbered as in the simulator's output: front face, then back face, each by rising v, then rising u.
    """
    corner = np.arange(rows * cols).reshape(rows, cols)
    a, b = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()  # left and right above
    c, d = corner[1:, :-1].ravel(), corner[1:, 1:].ravel()  # left and right below
    front = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    triangles = np.concatenate([front, front[:, ::-1] + rows * cols])
    triangles.setflags(write=False)
    return triangles


CAP = 0.010  # m, of a distance to a surface: strays beyond it do not decide


def capped_rms(distance: Array, cap: float = CAP) -> float:
    """Root mean square [m] of distances capped at `cap` [m], so that strays cannot decide it."""
    return float(np.sqrt(np.mean(np.square(np.minimum(np.abs(distance), cap)))))

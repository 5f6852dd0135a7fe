"""How far a cloth that was seen lies from a model's frame: a displacement on the model's own grid, from the heights of
a cloud over its faces."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from fabdesign.geometry.shape import normals
from fabdesign.nouns.array import Array, Indices
from optimize.fit.clouds import Match, places_on_cloth
from optimize.fit.misfit import deviation_by_median

WAVES = 6  # cosines along each side of the cloth: what muscles and buckles do to it
_LARGE, _NOISE = 3e-3, 6e-4  # m, of a wave and of a point, so that no wave is made of noise where points are missing
_FAR = 1.5  # times the usual residual, over which a point counts less: a stray, or a place that waves do not follow
_REWEIGHTED = 3  # times


def heights(match: Match, rows: Sequence[Indices], n: int) -> Array:
    """Return (frames, n, n) m: how far clouds lie off the mid-surface, towards the front; of the frames whose points
    are `rows`."""
    u, v, side = places_on_cloth(match)
    along = _waves(np.linspace(-1, 1, n))
    result = np.empty((len(rows), n, n))
    for f, points in enumerate(rows):
        table = (_waves(u[points])[:, :, None] * _waves(v[points])[:, None, :]).reshape(len(points), -1)
        share = _fitted(table, match.residual[points] * side[points]).reshape(WAVES, WAVES)
        result[f] = along @ share.T @ along.T
    return result


def _waves(place: Array) -> Array:
    """Return (k, WAVES) at places from -1 to 1 along a side."""
    return np.cos(0.5 * np.pi * np.arange(WAVES) * (place[:, None] + 1))


def _fitted(table: Array, height: Array) -> Array:
    """Return the share of each column of a table (N, k) in heights (N,) m, strays apart; NaN where a height is."""
    ridge = (_NOISE / _LARGE) ** 2 * np.eye(table.shape[1])
    weight: Array = np.ones(len(height))
    share: Array = np.zeros(table.shape[1])
    for _ in range(_REWEIGHTED):
        weighted = table * weight[:, None]
        share = np.asarray(np.linalg.solve(weighted.T @ table + ridge, weighted.T @ height), dtype=np.float64)
        remaining = np.abs(height - table @ share)
        usual = max(deviation_by_median(remaining), 0.5 * _NOISE)
        weight = 1 / np.maximum(remaining / (_FAR * usual), 1.0)
    return share


def savitzky_golay(offsets: Array, values: Array, order: int) -> tuple[Array, Array]:
    """Return the velocity and the acceleration, at 0, of a polynomial through `values` (k, ...) at `offsets` (k,) s
    (Savitzky and Golay 1964)."""
    scale = float(np.abs(offsets).max())
    rows = np.linalg.pinv(np.vander(offsets / scale, order + 1, increasing=True))
    return np.tensordot(rows[1] / scale, values, 1), np.tensordot(2 * rows[2] / scale**2, values, 1)


def rms_of(field: Array) -> float:
    """Return the RMS over a field (..., 3)."""
    return float(np.sqrt(np.square(field).sum(axis=-1).mean()))


class Unstrained:
    """Displacements of a mid-surface (n, n, 3) m that strain it least, of those along its normals."""

    def __init__(self, middle: Array) -> None:
        n = len(middle)
        (first, second), weight = _edges(n)
        place, normal = middle.reshape(-1, 3), normals(middle).reshape(-1, 3)
        edge = place[second] - place[first]
        pull = edge * (weight / np.square(edge).sum(axis=1))[:, None]  # strain of the edge by a displacement
        across = np.gradient(middle, axis=1).reshape(-1, 3)
        across -= (across * normal).sum(axis=1, keepdims=True) * normal
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        self._tangents = across, np.cross(normal, across)
        self._ends, self._pull = (first, second), pull
        row = np.tile(np.arange(len(first)), 4)
        column = np.concatenate([2 * end + k for end in (first, second) for k in range(2)])
        values = [
            sign * (pull * tangent[end]).sum(axis=1)
            for sign, end in ((-1, first), (1, second))
            for tangent in self._tangents
        ]
        self._strain = sparse.csr_matrix((np.concatenate(values), (row, column)), shape=(len(first), 2 * n * n))
        self._solve = splu((self._strain.T @ self._strain + sparse.identity(2 * n * n)).tocsc()).solve

    def __call__(self, along: Array) -> Array:
        """Return (n, n, 3): a field along the normals, with what moves in the surface so that edges keep their
        lengths."""
        field = along.reshape(-1, 3)
        first, second = self._ends
        strain = ((field[second] - field[first]) * self._pull).sum(axis=1)
        inside = self._solve(-(self._strain.T @ strain))
        moved = [one * share[:, None] for one, share in zip(self._tangents, (inside[::2], inside[1::2]), strict=True)]
        return np.asarray(field + sum(moved)).reshape(along.shape)


def _edges(n: int) -> tuple[Indices, Array]:
    """Return both ends (2, m) of the edges and diagonals of an n x n grid, and their weights (m,)."""
    k = np.arange(n * n).reshape(n, n)
    pairs = (k[:, :-1], k[:, 1:]), (k[:-1], k[1:]), (k[:-1, :-1], k[1:, 1:]), (k[1:, :-1], k[:-1, 1:])
    ends = np.array([np.concatenate([pair[end].ravel() for pair in pairs]) for end in (0, 1)])
    weights = np.concatenate([np.full(one.size, w) for (one, _), w in zip(pairs, (1.0, 1.0, 0.5, 0.5), strict=True)])
    return ends, weights

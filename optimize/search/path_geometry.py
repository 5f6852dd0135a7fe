"""Plane geometry of muscle paths: how far apart two of them lie and how sharply one turns. Stacks of them at once."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

Path = NDArray[np.float64]  # (corners, 2) m
Points = NDArray[np.float64]  # (..., 2) m


def clearance(a: Path, b: Path) -> float:
    """Return the least distance [m] between two polylines; where they cross, minus the least shift of an end that parts
    them."""
    i, j = np.array(list(product(range(len(a) - 1), range(len(b) - 1)))).T
    return float(segment_clearance(a[i], a[i + 1], b[j], b[j + 1]).min())


def segment_clearance(p: Points, q: Points, r: Points, s: Points) -> NDArray[np.float64]:
    """Return (...,) m: the clearance of the segments from p to q and from r to s."""
    ends = np.minimum(
        np.minimum(_to_segment(p, r, s), _to_segment(q, r, s)), np.minimum(_to_segment(r, p, q), _to_segment(s, p, q))
    )
    crossing = (_turn(p, q, r) * _turn(p, q, s) < 0) & (_turn(r, s, p) * _turn(r, s, q) < 0)
    return np.where(crossing, -ends, ends)


def bend_radius(path: Points) -> NDArray[np.float64]:
    """Return (...,) m, of paths (..., corners, 2): the largest radius that rounds every corner, tangent to both its
    legs; neighbours share a leg half and half."""
    legs = np.diff(path, axis=-2)
    lengths = np.linalg.norm(legs, axis=-1)
    reach = lengths / 2
    reach[..., 0], reach[..., -1] = lengths[..., 0], lengths[..., -1]
    if legs.shape[-2] == 2:
        reach = lengths
    along = np.einsum("...ij,...ij->...i", legs[..., :-1, :], legs[..., 1:, :])
    cosine = along / np.maximum(lengths[..., :-1] * lengths[..., 1:], 1e-12)
    half_turn = np.arccos(np.clip(cosine, -1.0, 1.0)) / 2
    radii = np.minimum(reach[..., :-1], reach[..., 1:]) / np.maximum(np.tan(half_turn), 1e-9)
    return np.asarray(radii.min(axis=-1))


def _to_segment(point: Points, a: Points, b: Points) -> NDArray[np.float64]:
    along, to = b - a, point - a
    t = np.clip(_dot(to, along) / np.maximum(_dot(along, along), 1e-18), 0.0, 1.0)[..., None]
    off = to - t * along
    return np.sqrt(_dot(off, off))


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _turn(a: Points, b: Points, c: Points) -> NDArray[np.float64]:
    ab, ac = b - a, c - a
    return ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]

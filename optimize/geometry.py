"""Plane geometry of muscle paths: how far apart two of them lie and how sharply one turns."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Path = NDArray[np.float64]  # (corners, 2) m


def clearance(a: Path, b: Path) -> float:
    """Least distance [m] between two polylines; where they cross, minus the least shift of an end that parts them."""
    return min(_segment_clearance(p, q, r, s) for p, q in pairwise(a) for r, s in pairwise(b))


def bend_radius(path: Path) -> float:
    """Largest radius [m] that rounds every corner: tangent to both legs, and neighbours share a leg half and half."""
    legs = np.diff(path, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    reach = lengths / 2
    reach[0], reach[-1] = lengths[0], lengths[-1]
    if len(legs) == 2:
        reach = lengths
    cosine = np.einsum("ij,ij->i", legs[:-1], legs[1:]) / np.maximum(lengths[:-1] * lengths[1:], 1e-12)
    half_turn = np.arccos(np.clip(cosine, -1.0, 1.0)) / 2
    return float(np.min(np.minimum(reach[:-1], reach[1:]) / np.maximum(np.tan(half_turn), 1e-9)))


def _segment_clearance(p: Path, q: Path, r: Path, s: Path) -> float:
    ends = (_to_segment(p, r, s), _to_segment(q, r, s), _to_segment(r, p, q), _to_segment(s, p, q))
    crossing = _turn(p, q, r) * _turn(p, q, s) < 0 and _turn(r, s, p) * _turn(r, s, q) < 0
    return -min(ends) if crossing else min(ends)


def _to_segment(point: Path, a: Path, b: Path) -> float:
    ax, ay, dx, dy = a[0], a[1], b[0] - a[0], b[1] - a[1]
    t = ((point[0] - ax) * dx + (point[1] - ay) * dy) / max(dx * dx + dy * dy, 1e-18)
    t = min(1.0, max(0.0, t))
    return float(np.hypot(point[0] - ax - t * dx, point[1] - ay - t * dy))


def _turn(a: Path, b: Path, c: Path) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

"""Lacing rows: the lines on which fixed points are sewn, and how a dragged point falls onto them."""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from studies.studio.layout import Point

LEAST_SPACING = 1e-3  # m between rows


def row_distance(design: Design) -> float:
    """m between lacing rows where nobody says: half the pitch that most muscles have, so that a row runs through every
    fixed point of one that starts on a row, and between."""
    pitches = Counter(muscle.fixed_point_pitch for muscle in design.muscles)
    return max((pitches.most_common(1)[0][0] if pitches else 0.02) / 2, LEAST_SPACING)


def rows(length: float, distance: float) -> NDArray[np.float64]:
    """(n,) m from an edge: rows every `distance`, the edges themselves left out."""
    places = distance * np.arange(1, int(np.ceil(length / distance)))
    return np.asarray(places[places < length - 1e-9], dtype=np.float64)


def snapped(point: Point, size: Point, distance: float) -> Point:
    """The crossing of two rows that lies nearest to `point`, on a cloth of `size` (width, height) m; a cloth narrower
    than two rows has none, and keeps the coordinate."""
    u, v = (_nearest(x, rows(length, distance)) for x, length in zip(point, size, strict=True))
    return u, v


def _nearest(x: float, among: NDArray[np.float64]) -> float:
    return float(round(among[np.argmin(np.abs(among - x))], 9)) if len(among) else x

"""Muscles: a type with its bench table, and one laced through the cloth along a path."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class BenchTable:
    """Isometric tension of one bare muscle, as measured: one entry a row."""

    pressure: tuple[float, ...]  # Pa, gauge
    contraction: tuple[float, ...]  # 1 - l / l0
    force: tuple[float, ...]  # N, positive is tension


WIDEST = 0.05  # m, of any muscle that is laced


def diameter_slip(diameter: float) -> str:
    """Return what is said of a diameter [m] that no laced muscle has; empty for any other."""
    if diameter <= WIDEST:
        return ""
    return f"; outer_diameter is in m, and {diameter:g} was probably given in mm"


@dataclass(frozen=True)
class MuscleType:
    """A kind of thin McKibben muscle: its bench table says what it pulls, the rest how it is built and mounted.

    Limits: one law for all lengths (tension by contraction and pressure); no hysteresis, no creep. `max_pressure`,
    `stock_length`, `min_bend_radius` and `tail_length` bind designs and cut lists, not the simulator; None: not bound.

    >>> table = BenchTable((0.0, 0.0, 200e3, 200e3), (0.0, 0.2, 0.0, 0.2), (0.0, -8.0, 12.0, 2.0))  # Pa, 1, N
    >>> thin = MuscleType("thin", outer_diameter=0.002, mass_per_length=0.004, axis_offset=0.0015, bench=table)
    >>> thin.max_pressure is None
    True
    """

    name: str
    outer_diameter: float  # m
    mass_per_length: float  # kg/m
    axis_offset: float  # m, of the laced axis from the mid-surface
    bench: BenchTable
    viscosity: float = 0.0  # N s, tension lost per contraction rate
    max_pressure: float | None = None  # Pa
    stock_length: float | None = None  # m
    min_bend_radius: float | None = None  # m
    tail_length: float | None = None  # m


@dataclass(frozen=True)
class Muscle:
    """One muscle, laced along a polyline in fabric coordinates (u, v)."""

    type: str
    side: Literal["front", "back"]
    channel: int
    path: tuple[tuple[float, float], ...]  # m, corner points
    fixed_point_pitch: float  # m

    @property
    def length(self) -> float:
        """Rest length [m]: that of the path on the flat cloth."""
        return float(np.linalg.norm(np.diff(np.array(self.path), axis=0), axis=1).sum())

    def fixed_points(self) -> NDArray[np.float64]:
        """(n, 2) fixed points [m]: both ends, every corner, round(length / pitch) equal intervals between corners."""
        corners = np.array(self.path)
        points = [corners[:1]]
        for a, b in pairwise(corners):
            n = max(1, round(float(np.linalg.norm(b - a)) / self.fixed_point_pitch))
            points.append(a + (b - a) * (np.arange(1, n + 1) / n)[:, None])
        return np.concatenate(points)

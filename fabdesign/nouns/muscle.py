"""Muscles: a type with its bench table, and one laced through the cloth along a path."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.law_tables import BenchTable as BenchTable
from fabdesign.files.law_tables import read_bench_table
from fabdesign.formats.schema import ABOVE_0, FROM_0, FileUnit, Key, Kilopascal, Metre, Within
from fabdesign.formats.table import Table, nearest
from fabdesign.nouns.fabric import LARGEST
from fabdesign.runtime.effort import CLOSEST, MUSCLES

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

    name: Annotated[str, Key("", absent=lambda table: table.name)]
    outer_diameter: Annotated[Metre, ABOVE_0]
    mass_per_length: Annotated[float, FileUnit("kg/m"), ABOVE_0]
    axis_offset: Annotated[Metre, FROM_0, "of the laced axis from the mid-surface"]
    bench: Annotated[BenchTable, Key(file=read_bench_table), "isometric force at pressure and contraction"]
    viscosity: Annotated[float, FileUnit("N s"), FROM_0, "tension lost per contraction rate"] = 0.0
    max_pressure: Annotated[Kilopascal | None, ABOVE_0, "gauge"] = None
    stock_length: Annotated[Metre | None, ABOVE_0, "the longest piece to be had"] = None
    min_bend_radius: Annotated[Metre | None, FROM_0, "of the laced axis"] = None
    tail_length: Annotated[Metre | None, FROM_0, "left over at each end for tube and knot"] = None


def _known(kind: str, table: Table) -> str:
    """Return the name of a muscle type. Raises InputError where the design has none of that name."""
    types = table.find("muscle_types")
    if types and kind not in types:
        raise table.bad("type", f"one of {', '.join(types)}{nearest(kind, [*types])}")
    if not types:
        raise table.bad("type", f"[muscle_types.{kind}] in this file, or in one that it includes")
    return kind


@dataclass(frozen=True)
class Muscle:
    """One muscle, laced along a polyline in fabric coordinates (u, v)."""

    type: Annotated[str, Key(form=str, read=_known), "one of [muscle_types]"]
    side: Annotated[Literal["front", "back"], "the face that it is laced on"]
    channel: Annotated[int, Within(least=0, most=MUSCLES - 1), "of pressure"]
    path: Annotated[tuple[tuple[float, float], ...], FileUnit("m"), "(u, v) of its ends and corners"]
    fixed_point_pitch: Annotated[Metre, Within(least=CLOSEST), "between fixed points"]

    def resolved(self, table: Table) -> "Muscle":
        """Raise InputError for a path that is none on the cloth."""
        if len(self.path) < 2:
            raise table.bad("path", "at least two [u, v] points")
        for i, point in enumerate(self.path):
            table.find("fabric").require_inside(point, table, f"path[{i}]")
            if i and point == self.path[i - 1]:
                raise table.error(f"path[{i}] repeats the point before it")
        if self.fixed_point_pitch > LARGEST:
            raise table.bad("fixed_point_pitch", "metres (is it in millimetres?)")
        return self

    def along(self, path: NDArray[np.float64]) -> "Muscle":
        """Return the muscle laced along another path (corners, 2) m."""
        return replace(self, path=tuple((float(u), float(v)) for u, v in path))

    @property
    def length(self) -> float:
        """Return the rest length [m]: that of the path on the flat cloth."""
        return float(np.linalg.norm(np.diff(np.array(self.path), axis=0), axis=1).sum())

    def fixed_points(self) -> NDArray[np.float64]:
        """Return (n, 2) fixed points [m]: both ends, every corner, round(length / pitch) equal intervals between
        corners."""
        corners = np.array(self.path)
        points = [corners[:1]]
        for a, b in pairwise(corners):
            n = max(1, round(float(np.linalg.norm(b - a)) / self.fixed_point_pitch))
            points.append(a + (b - a) * (np.arange(1, n + 1) / n)[:, None])
        return np.concatenate(points)

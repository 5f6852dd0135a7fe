"""What a search may change, and what it must respect: a vector in [0, 1]^n stands for a design and its pressures."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.muscle import Muscle
from optimize.geometry import bend_radius, clearance

Vector = NDArray[np.float64]

PRESSURE_STEP = 0.04  # of the pressure range: 16 kPa of 400, above the simulator's rounding, below the S-curve's width
POSITION_STEP = 0.01  # of the cloth: 2 mm of 200, a fraction of a mesh width
PRESSURE_REACH = 1.0  # of the pressure range that a trust region of radius 1 spans
POSITION_REACH = 0.5  # of the cloth: positions act less linearly than pressures


@dataclass(frozen=True)
class Limits:
    """What every proposal respects. Lengths in m, pressures in Pa."""

    pressure: tuple[float, float] = (0.0, 400e3)
    spacing: float = 0.006  # between muscles on one face
    edge: float = 0.005  # from a muscle's corner points to the cloth's edge


@dataclass(frozen=True)
class DesignSpace:
    """The start and what varies of it. Several poses share the layout and have pressures of their own.

    start_pressures (poses, channels) Pa: where a search begins, and what holds where pressures do not vary.
    """

    design: Design
    limits: Limits
    start_pressures: NDArray[np.float64]
    vary_pressures: bool = True
    vary_positions: bool = False

    @property
    def dimension(self) -> int:
        """n: positions first, muscle by muscle and corner by corner, then pressures pose by pose."""
        return self.position_count + self.start_pressures.size * self.vary_pressures

    @property
    def position_count(self) -> int:
        return 2 * sum(len(m.path) for m in self.design.muscles) * self.vary_positions

    @property
    def step(self) -> Vector:
        """(n,) finite-difference steps."""
        return self._by_kind(POSITION_STEP, PRESSURE_STEP)

    @property
    def reach(self) -> Vector:
        """(n,) half widths of a trust region of radius 1."""
        return self._by_kind(POSITION_REACH, PRESSURE_REACH)

    def _by_kind(self, position: float, pressure: float) -> Vector:
        pressures = self.dimension - self.position_count
        return np.array([position] * self.position_count + [pressure] * pressures)

    def encode(self, design: Design, pressures: NDArray[np.float64]) -> Vector:
        """(n,) the vector of a layout with this space's muscles and of (poses, channels) pressures [Pa]."""
        parts = []
        if self.vary_positions:
            low, span = self._position_range()
            parts.append(((np.concatenate([np.array(m.path) for m in design.muscles]) - low) / span).ravel())
        if self.vary_pressures:
            lowest, highest = self.limits.pressure
            parts.append((np.asarray(pressures, float).ravel() - lowest) / (highest - lowest))
        return np.clip(np.concatenate([*parts, np.empty(0)]), 0.0, 1.0)

    def decode(self, x: Vector) -> tuple[Design, NDArray[np.float64]]:
        """The design and its (poses, channels) pressures [Pa]."""
        design, pressures, used = self.design, self.start_pressures, 0
        if self.vary_positions:
            low, span = self._position_range()
            used = self.position_count
            corners = low + span * x[:used].reshape(-1, 2)
            design = replace(design, muscles=_with_corners(design.muscles, corners))
        if self.vary_pressures:
            lowest, highest = self.limits.pressure
            pressures = lowest + (highest - lowest) * x[used:].reshape(self.start_pressures.shape)
        return design, pressures

    def _position_range(self) -> tuple[Vector, Vector]:
        fabric, edge = self.design.fabric, self.limits.edge
        return np.full(2, edge), np.array([fabric.width, fabric.height]) - 2 * edge

    def margins(self, x: Vector) -> Vector:
        """(k,) m, nowhere negative for a vector that may be built; empty where positions are fixed."""
        if not self.vary_positions:
            return np.empty(0)
        return np.array(list(_margins(self.decode(x)[0], self.limits).values()))

    def feasible(self, x: Vector) -> bool:
        return bool(np.all(self.margins(x) >= -1e-7))


def constraint_margins(design: Design, pressures: NDArray[np.float64], limits: Limits) -> dict[str, float]:
    """The least margin of every limit by name: m, and Pa for `pressure`. Negative: violated.

    `spacing` is absent where no face has two muscles, `min_bend_radius` and `stock_length` where no type states one.
    """
    fabric = design.fabric
    least: dict[str, float] = {}
    for (name, _), margin in _margins(design, limits).items():
        least[name] = min(margin, least.get(name, np.inf))
    corners = np.concatenate([np.array(m.path) for m in design.muscles])
    least["inside_cloth"] = float(np.min([corners, np.array([fabric.width, fabric.height]) - corners]))
    least["pressure"] = float(min(np.min(pressures) - limits.pressure[0], limits.pressure[1] - np.max(pressures)))
    return least


def _margins(design: Design, limits: Limits) -> Mapping[tuple[str, tuple[int, ...]], float]:
    """m by (limit, muscle or pair of muscles)."""
    margins: dict[tuple[str, tuple[int, ...]], float] = {}
    for i, muscle in enumerate(design.muscles):
        kind = design.muscle_types[muscle.type]
        margins["shortest", (i,)] = muscle.length - 2 * muscle.fixed_point_pitch  # fewer intervals bend next to nothing
        if kind.stock_length is not None:
            margins["stock_length", (i,)] = kind.stock_length - 2 * (kind.tail_length or 0.0) - muscle.length
        if kind.min_bend_radius is not None and len(muscle.path) > 2:
            margins["min_bend_radius", (i,)] = bend_radius(np.array(muscle.path)) - kind.min_bend_radius
        for j in range(i):
            if design.muscles[j].side == muscle.side:
                gap = clearance(np.array(design.muscles[j].path), np.array(muscle.path))
                margins["spacing", (j, i)] = gap - limits.spacing
    return margins


def _with_corners(muscles: tuple[Muscle, ...], corners: NDArray[np.float64]) -> tuple[Muscle, ...]:
    moved, used = [], 0
    for muscle in muscles:
        path = corners[used : used + len(muscle.path)]
        moved.append(replace(muscle, path=tuple((float(u), float(v)) for u, v in path)))
        used += len(muscle.path)
    return tuple(moved)

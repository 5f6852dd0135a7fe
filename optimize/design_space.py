"""What a search may change, and what it must respect: a vector in [0, 1]^n stands for a design and its pressures."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.muscle import Muscle
from optimize.margins import Limits, Margins

Vector = NDArray[np.float64]

PRESSURE_STEP = 0.04  # of the pressure range: 16 kPa of 400, above the simulator's rounding, below the S-curve's width
POSITION_STEP = 0.01  # of the cloth: 2 mm of 200, a fraction of a mesh width
PRESSURE_REACH = 1.0  # of the pressure range that a trust region of radius 1 spans
POSITION_REACH = 0.5  # of the cloth: positions act less linearly than pressures


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

    @property
    def units(self) -> Vector:
        """(n,) m of positions and Pa of pressures that a variable from 0 to 1 is."""
        _, span = self._position_range()
        lowest, highest = self.limits.pressure
        pressures = self.dimension - self.position_count
        return np.concatenate([np.tile(span, self.position_count // 2), np.full(pressures, highest - lowest)])

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
        """(..., k) m of vectors (..., n), nowhere negative for what may be built; empty where positions are fixed."""
        if not self.vary_positions:
            return np.empty((*x.shape[:-1], 0))
        low, span = self._position_range()
        corners = x[..., : self.position_count].reshape(*x.shape[:-1], -1, 2)
        return self._margins.at(low + span * corners)

    @cached_property
    def _margins(self) -> Margins:
        return Margins(self.design, self.limits)

    def feasible(self, x: Vector) -> bool:
        return bool(np.all(self.margins(x) >= -1e-7))


def _with_corners(muscles: tuple[Muscle, ...], corners: NDArray[np.float64]) -> tuple[Muscle, ...]:
    moved, used = [], 0
    for muscle in muscles:
        path = corners[used : used + len(muscle.path)]
        moved.append(replace(muscle, path=tuple((float(u), float(v)) for u, v in path)))
        used += len(muscle.path)
    return tuple(moved)

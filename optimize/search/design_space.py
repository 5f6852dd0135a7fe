"""The design space: what a search may change and must respect. A vector in [0, 1]^n stands for a design and its
pressures."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from optimize.search.contraction import largest_contraction
from optimize.search.margins import Limits, Margins, free_air

Vector = NDArray[np.float64]

PRESSURE_STEP = 0.04  # of the pressure range: 16 kPa of 400, above the simulator's rounding, below the S-curve's width
POSITION_STEP = 0.01  # of the cloth: 2 mm of 200, a fraction of a mesh width
PRESSURE_REACH = 1.0  # of the pressure range that a trust region of radius 1 spans
CONTRACTION_ROUNDING = 1e-4
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
    def channels(self) -> int:
        return self.start_pressures.shape[1]

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
        """Return (n,) the vector of a layout with this space's muscles and of (poses, channels) pressures [Pa].

        All pressures of a pose come down alike where they take more air than there is.
        """
        parts = []
        if self.vary_positions:
            low, span = self._position_range()
            parts.append(((np.concatenate([np.array(m.path) for m in design.muscles]) - low) / span).ravel())
        if self.vary_pressures:
            lowest, highest = self.limits.pressure
            shares = np.clip((np.asarray(pressures, float) - lowest) / (highest - lowest), 0.0, 1.0)
            parts.append((self._airs(design, shares) * shares).ravel())
        return np.clip(np.concatenate([*parts, np.empty(0)]), 0.0, 1.0)

    def decode(self, x: Vector) -> tuple[Design, NDArray[np.float64]]:
        """Return the design and its (poses, channels) pressures [Pa]."""
        design = self.design
        if self.vary_positions:
            design = replace(design, muscles=_with_corners(design.muscles, self._corners(x)))
        return design, self._pressures(x)

    def _position_range(self) -> tuple[Vector, Vector]:
        fabric, edge = self.design.fabric, self.limits.edge
        return np.full(2, edge), np.array([fabric.width, fabric.height]) - 2 * edge

    def margins(self, x: Vector) -> Vector:
        """Return (..., k) of vectors (..., n), nowhere negative for what may be built: m of all geometry, and shares of
        the air that are left. Empty where nothing that is limited varies."""
        parts = [np.empty((*x.shape[:-1], 0))]
        if self.vary_positions:
            parts.append(self._margins.at(self._corners(x)))
        if self.limits.air is not None:
            used = free_air(self.design, self._margins.lengths(self._corners(x)), self._pressures(x))
            parts.append(1 - np.broadcast_to(used / self.limits.air, (*x.shape[:-1], used.shape[-1])))
        return np.concatenate(parts, axis=-1)

    def _corners(self, x: Vector) -> Vector:
        """Return (..., corners, 2) m of vectors (..., n)."""
        if not self.vary_positions:
            return np.concatenate([np.array(m.path) for m in self.design.muscles])
        low, span = self._position_range()
        return np.asarray(low + span * x[..., : self.position_count].reshape(*x.shape[:-1], -1, 2))

    def _pressures(self, x: Vector) -> Vector:
        """Return (..., poses, channels) Pa of vectors (..., n)."""
        if not self.vary_pressures:
            return self.start_pressures
        lowest, highest = self.limits.pressure
        shares = x[..., self.position_count :].reshape(*x.shape[:-1], *self.start_pressures.shape)
        return np.asarray(lowest + (highest - lowest) * shares)

    @property
    def limited(self) -> int:
        """How many variables, from the first on, `margins` depend on."""
        return self.position_count if self.limits.air is None else self.dimension

    def _airs(self, design: Design, shares: Vector) -> Vector:
        """Return (poses, 1) by which shares (poses, channels) of the pressure range come down to keep the air."""
        if self.limits.air is None:
            return np.ones((len(shares), 1))
        lowest, highest = self.limits.pressure
        lengths = np.array([muscle.length for muscle in design.muscles])
        least = free_air(design, lengths, np.full(shares.shape, lowest))
        more = free_air(design, lengths, (highest - lowest) * shares)
        return np.clip((self.limits.air - least) / np.maximum(more, 1e-12 * self.limits.air), 0.0, 1.0)[:, None]

    @cached_property
    def _margins(self) -> Margins:
        return Margins(self.design, self.limits)

    def feasible(self, x: Vector) -> bool:
        return bool(np.all(self.margins(x) >= -1e-7))

    def keeps(self, x: Vector, shape: NDArray[np.float64]) -> bool:
        """Return whether it is feasible with the shape (poses, 2 n n, 3) m that it has."""
        most = self.limits.contraction
        if not self.feasible(x):
            return False
        return most is None or largest_contraction(self.decode(x)[0], shape) <= most + CONTRACTION_ROUNDING


def _with_corners(muscles: tuple[Muscle, ...], corners: NDArray[np.float64]) -> tuple[Muscle, ...]:
    moved, used = [], 0
    for muscle in muscles:
        path = corners[used : used + len(muscle.path)]
        moved.append(replace(muscle, path=tuple((float(u), float(v)) for u, v in path)))
        used += len(muscle.path)
    return tuple(moved)

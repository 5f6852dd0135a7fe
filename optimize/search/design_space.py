"""The design space: what a search may change and must respect. A vector in [0, 1]^n stands for a design and its
pressures.

Muscles on pressure channels: one each, or shared ones where there are fewer channels or pressures agree.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from optimize.search.margins import Limits, Margins, free_air, largest_contraction

Vector = Array

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
    start_pressures: Array
    vary_pressures: bool = True
    vary_positions: bool = False

    @property
    def dimension(self) -> int:
        """Return n: positions first, muscle by muscle and corner by corner, then pressures pose by pose."""
        return self.position_count + self.start_pressures.size * self.vary_pressures

    @property
    def channels(self) -> int:
        return self.start_pressures.shape[1]

    @property
    def position_count(self) -> int:
        return 2 * sum(len(m.path) for m in self.design.muscles) * self.vary_positions

    @property
    def size(self) -> Vector:
        """Return (2,) m, of the cloth."""
        return np.array([self.design.fabric.width, self.design.fabric.height])

    @property
    def step(self) -> Vector:
        """Return (n,) finite-difference steps."""
        return self._by_kind(POSITION_STEP, PRESSURE_STEP)

    @property
    def reach(self) -> Vector:
        """Return (n,) half widths of a trust region of radius 1."""
        return self._by_kind(POSITION_REACH, PRESSURE_REACH)

    @property
    def units(self) -> Vector:
        """Return (n,) m of positions and Pa of pressures that a variable from 0 to 1 is."""
        return self._by_kind(self._position_range()[1], np.ptp(self.limits.pressure))

    def _by_kind(self, position: float | Vector, pressure: float) -> Vector:
        """Return (n,) of values of a position, or of (u, v), and of a pressure."""
        positions = np.tile(np.broadcast_to(position, 2), self.position_count // 2)
        return np.concatenate([positions, np.full(self.dimension - self.position_count, pressure)])

    def encode(self, design: Design, pressures: Array) -> Vector:
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

    def decode(self, x: Vector) -> tuple[Design, Array]:
        """Return the design and its (poses, channels) pressures [Pa]."""
        design = self.design
        if self.vary_positions:
            ends = np.cumsum([len(muscle.path) for muscle in design.muscles])[:-1]
            paths = np.split(self._corners(x), ends)
            muscles = tuple(muscle.along(path) for muscle, path in zip(design.muscles, paths, strict=True))
            design = replace(design, muscles=muscles)
        return design, self._pressures(x)

    def _position_range(self) -> tuple[Vector, Vector]:
        return np.full(2, self.limits.edge), self.size - 2 * self.limits.edge

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
        """Return how many variables, from the first on, `margins` depend on."""
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

    def keeps(self, x: Vector, shape: Array) -> bool:
        """Return whether it is feasible with the shape (poses, 2 n n, 3) m that it has."""
        most = self.limits.contraction
        if not self.feasible(x):
            return False
        return most is None or largest_contraction(self.decode(x)[0], shape) <= most + CONTRACTION_ROUNDING


Layout = tuple[Sequence[Muscle], Array]  # and (poses, muscles) Pa
Groups = list[list[int]]  # muscles, from 0, that share a channel

SHARED = 0.05  # of the pressure range, within which two muscles may share a channel in every pose


def start_of(layout: Layout, space: DesignSpace) -> tuple[DesignSpace, Vector] | None:
    """Return the layout on the cloth of `space`, with a channel for each muscle or, where its limits have fewer, with
    those on one channel whose pressures are nearest; None where a limit is broken."""
    grouped = _on_channels(layout, space, _nearest_groups(layout[1], space.limits.channels))
    return grouped if grouped[0].feasible(grouped[1]) else None


def starts_of(layouts: Iterable[Layout], space: DesignSpace) -> list[tuple[DesignSpace, Vector]]:
    """Return the same of several, without those that break a limit."""
    starts = (start_of(layout, space) for layout in layouts)
    return [start for start in starts if start is not None]


def by_muscle(start: tuple[DesignSpace, Vector]) -> Layout:
    """Return the muscles of a start, and what acts in each."""
    design, pressures = start[0].decode(start[1])
    return design.muscles, pressures[:, [muscle.channel for muscle in design.muscles]]


def with_shared_channels(start: tuple[DesignSpace, Vector]) -> tuple[DesignSpace, Vector] | None:
    """Return the same layout with muscles on one channel whose pressures agree in every pose, at their mean; None where
    that saves no channel."""
    space = start[0]
    muscles, levels = by_muscle(start)
    low, high = space.limits.pressure
    groups: Groups = []
    for k in range(len(muscles)):
        alike = [g for g in groups if np.all(np.abs(levels[:, k] - levels[:, g[0]]) <= SHARED * (high - low))]
        if alike:
            alike[0].append(k)
        else:
            groups.append([k])
    return _on_channels((muscles, levels), space, groups) if len(groups) < space.channels else None


def _nearest_groups(pressures: Array, most: int | None) -> Groups:
    """Return at most so many groups: the two whose mean pressures are nearest become one until they are that few."""
    groups: Groups = [[k] for k in range(pressures.shape[1])]
    while most is not None and len(groups) > most:
        means = [pressures[:, group].mean(axis=1) for group in groups]
        pairs = combinations(range(len(groups)), 2)
        i, j = min(pairs, key=lambda pair: float(np.linalg.norm(means[pair[0]] - means[pair[1]])))
        groups[i] += groups.pop(j)
    return groups


def _on_channels(layout: Layout, space: DesignSpace, groups: Groups) -> tuple[DesignSpace, Vector]:
    """Return groups that share a channel have their mean pressure."""
    muscles, pressures = layout
    channel_of = {k: channel for channel, group in enumerate(groups) for k in group}
    placed = tuple(replace(muscle, channel=channel_of[k]) for k, muscle in enumerate(muscles))
    shared = np.stack([pressures[:, group].mean(axis=1) for group in groups], axis=1)
    reduced = replace(space, design=replace(space.design, muscles=placed), start_pressures=shared, vary_positions=True)
    return reduced, reduced.encode(reduced.design, shared)

"""How far a layout is from what may be built: a margin for every limit of every muscle or pair of muscles."""

from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design
from fabdesign.study_files.study_file import StudyLimits
from optimize.search.contraction import largest_contraction
from optimize.search.path_geometry import bend_radius, segment_clearance

Array = NDArray[np.float64]

ATMOSPHERE = 101_325.0  # Pa
Limits = StudyLimits  # that every proposal respects; `air`: `free_air`


class Margins:
    """The margins [m] of a design's muscles, wherever their corners lie; nowhere negative where they may be built.

    `names` says which limit each of them is of: `shortest` (fewer than two intervals bend next to nothing),
    `stock_length`, `min_bend_radius` and, of two muscles on one face, `spacing`; `muscles`, which one or two it is of.
    """

    def __init__(self, design: Design, limits: Limits) -> None:
        muscles = design.muscles
        ends = np.cumsum([0, *(len(muscle.path) for muscle in muscles)]).tolist()
        self._corners = list(pairwise(ends))
        kinds = [design.muscle_types[muscle.type] for muscle in muscles]
        self._shortest = np.array([2 * muscle.fixed_point_pitch for muscle in muscles])
        self._stocked = [i for i, kind in enumerate(kinds) if kind.stock_length is not None]
        self._stock = np.array(
            [(kinds[i].stock_length or 0.0) - 2 * (kinds[i].tail_length or 0.0) for i in self._stocked]
        )
        bent = [i for i, kind in enumerate(kinds) if kind.min_bend_radius is not None and len(muscles[i].path) > 2]
        self._bent = [(*self._corners[i], kinds[i].min_bend_radius or 0.0) for i in bent]
        self._spacing = limits.spacing
        pairs = [(j, i) for i in range(len(muscles)) for j in range(i) if muscles[i].side == muscles[j].side]
        self._first, self._second, self._groups = self._segments(pairs)
        alone = {"shortest": range(len(muscles)), "stock_length": self._stocked, "min_bend_radius": bent}
        of: list[tuple[str, tuple[int, ...]]] = [(name, (i,)) for name, whom in alone.items() for i in whom]
        of += [("spacing", pair) for pair in pairs]
        self.names, self.muscles = tuple(name for name, _ in of), tuple(whom for _, whom in of)

    def _segments(self, pairs: list[tuple[int, int]]) -> tuple[list[int], list[int], list[int]]:
        """Return the corners that all pairs of segments start at, and where each pair of muscles begins."""
        first: list[int] = []
        second: list[int] = []
        groups: list[int] = []
        for j, i in pairs:
            groups.append(len(first))
            segment_pairs = list(product(*(range(a, b - 1) for a, b in (self._corners[j], self._corners[i]))))
            first += [p for p, _ in segment_pairs]
            second += [q for _, q in segment_pairs]
        return first, second, groups

    def lengths(self, corners: Array) -> Array:
        """Return (..., muscles) m on the flat cloth."""
        legs = np.linalg.norm(np.diff(corners, axis=-2), axis=-1)
        return np.stack([legs[..., a : b - 1].sum(axis=-1) for a, b in self._corners], axis=-1)

    def at(self, corners: Array) -> Array:
        """Return (..., k) m, of layouts whose muscles' corners, one after another, are (..., corners, 2) m."""
        lengths = self.lengths(corners)
        parts = [lengths - self._shortest, self._stock - lengths[..., self._stocked]]
        parts += [(bend_radius(corners[..., a:b, :]) - least)[..., None] for a, b, least in self._bent]
        if self._groups:
            p, r = np.array(self._first), np.array(self._second)
            apart = segment_clearance(*(corners[..., k, :] for k in (p, p + 1, r, r + 1)))
            parts.append(np.minimum.reduceat(apart, self._groups, axis=-1) - self._spacing)
        return np.concatenate(parts, axis=-1)


def free_air(design: Design, lengths: Array, pressures: Array) -> Array:
    """Return (..., poses) m^3 at atmospheric pressure that pressures (..., poses, channels) Pa take beside what is in
    muscles of lengths (..., muscles) m anyway: of cylinders of the outer diameter, which a muscle that swells
    exceeds."""
    areas = np.array([np.pi / 4 * design.muscle_types[muscle.type].outer_diameter ** 2 for muscle in design.muscles])
    by_muscle = pressures[..., [muscle.channel for muscle in design.muscles]]
    return np.asarray((by_muscle * (areas * lengths)[..., None, :]).sum(axis=-1) / ATMOSPHERE)


def constraint_margins(
    design: Design, pressures: Array, limits: Limits, shape: Array | None = None
) -> dict[str, float]:
    """Return the least margin of every limit by name: m; Pa for `pressure`, m^3 for `air`, none for `contraction` and
    `channels`. Negative: violated. shape: (poses, 2 n n, 3) m, by which `contraction` goes.

    `spacing` is absent where no face has two muscles, `min_bend_radius` and `stock_length` where no type states one,
    the last three where there is no limit.
    """
    fabric = design.fabric
    corners = np.concatenate([np.array(muscle.path) for muscle in design.muscles])
    margins = Margins(design, limits)
    least: dict[str, float] = {}
    for name, margin in zip(margins.names, margins.at(corners).tolist(), strict=True):
        least[name] = min(margin, least.get(name, np.inf))
    least["inside_cloth"] = float(np.min([corners, np.array([fabric.width, fabric.height]) - corners]))
    least["pressure"] = float(min(np.min(pressures) - limits.pressure[0], limits.pressure[1] - np.max(pressures)))
    if limits.contraction is not None and shape is not None:
        least["contraction"] = limits.contraction - largest_contraction(design, shape)
    if limits.channels is not None:
        least["channels"] = float(limits.channels - design.channels)
    if limits.air is not None:
        least["air"] = float(np.min(limits.air - free_air(design, margins.lengths(corners), pressures)))
    return least

"""The limits of a layout in words, where they are broken: the margins of the search, and what `check` finds."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import LARGEST
from fabdesign.nouns.pressure import limits as pressure_limits
from fabdesign.units import in_kpa, in_mm
from optimize.search.margins import Limits, Margins
from studies.studio.layout import Layout

_ROUNDING = 1e-6  # m


@dataclass(frozen=True)
class Broken:
    """A limit that is broken: its name in `optimize`'s results, a sentence, and whom it is about."""

    limit: str
    message: str
    muscles: tuple[int, ...] = ()
    channel: int | None = None


def broken_limits(layout: Layout, limits: Limits) -> list[Broken]:
    """Return those of every muscle, every two on one face, and every channel, which count from 0 as in files."""
    broken = [*_of_edges(layout.design, limits), *_of_margins(layout.design, limits)]
    return [*sorted(broken, key=lambda line: (len(line.muscles), line.muscles)), *_of_pressures(layout, limits)]


def _of_edges(design: Design, limits: Limits) -> Iterator[Broken]:
    size = np.array([design.fabric.width, design.fabric.height])
    for i, muscle in enumerate(design.muscles):
        free = float(np.min([muscle.path, size - muscle.path]))
        if free < limits.edge - _ROUNDING:
            message = f"lies {in_mm(free):.1f} mm from the edge; expected {in_mm(limits.edge):g} mm"
            yield Broken("edge", f"muscle {i} {message}", (i,))


def _of_margins(design: Design, limits: Limits) -> Iterator[Broken]:
    if not design.muscles:
        return
    margins = Margins(design, limits)
    values = margins.at(np.concatenate([muscle.path for muscle in design.muscles])).tolist()
    for name, who, margin in zip(margins.names, margins.muscles, values, strict=True):
        crossing = name == "spacing" and margin + limits.spacing < 0
        if crossing or margin < -_ROUNDING:
            yield Broken("crossing" if crossing else name, _in_words(design, limits, name, who, margin), who)


def _in_words(design: Design, limits: Limits, name: str, who: tuple[int, ...], margin: float) -> str:
    muscle = design.muscles[who[0]]
    kind = design.muscle_types[muscle.type]
    if name == "spacing":
        pair, gap, least = f"muscles {who[0]} and {who[1]}", margin + limits.spacing, in_mm(limits.spacing)
        if gap < 0:
            return f"{pair} cross on the {muscle.side}; expected them apart"
        return f"{pair} lie {in_mm(gap):.1f} mm apart on the {muscle.side}; expected {least:g} mm"
    if name == "min_bend_radius":
        least = kind.min_bend_radius or 0.0
        corner = f"a corner of {in_mm(margin + least):.1f} mm radius"
        return f"muscle {who[0]} has {corner}; expected {in_mm(least):g} mm of {kind.name}"
    length = f"muscle {who[0]} is {in_mm(muscle.length):.1f} mm long"
    if name == "shortest":
        pitches = f"two pitches, {in_mm(2 * muscle.fixed_point_pitch):g} mm"
        return f"{length}; expected {pitches}, or it hardly bends the cloth"
    stock = in_mm((kind.stock_length or 0.0) - 2 * (kind.tail_length or 0.0))
    return f"{length}; expected at most {stock:.0f} mm, the stock of {kind.name} less its tails"


def _of_pressures(layout: Layout, limits: Limits) -> Iterator[Broken]:
    low, searched = limits.pressure
    for channel, (pressure, most) in enumerate(zip(layout.pressures, pressure_limits(layout.design), strict=True)):
        by_type = most < LARGEST and most <= searched
        high, why = (most, "the muscles' maximum") if by_type else (searched, "the highest that is searched")
        if not low - 1e-6 <= pressure <= high + 1e-6:
            expected = f"expected {in_kpa(low):g} to {in_kpa(high):g} kPa, {why}"
            yield Broken("pressure", f"channel {channel} has {in_kpa(pressure):g} kPa; {expected}", channel=channel)

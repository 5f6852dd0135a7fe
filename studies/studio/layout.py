"""The layout that is edited: a design and the pressures of its channels, each change that a person can make, lacing
rows, and the limits that it breaks: the margins of the search, and what `check` finds."""

import itertools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import dist
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.pressure import LARGEST
from fabdesign.nouns.pressure import limits as pressure_limits
from fabdesign.runtime.effort import MUSCLES
from fabdesign.units import in_kpa, in_mm
from optimize.search.margins import Limits, Margins

Point = tuple[float, float]  # (u, v) m
HIGHEST = 400e3  # Pa, of a slider where no muscle type on the channel says less
LEAST_SPACING = 1e-3  # m between lacing rows
_MARGIN = 0.1  # of the cloth's side, that a new muscle leaves free
_ROUNDING = 1e-6  # m
_MICRO = 6  # digits of a coordinate in m: a micrometre is finer than any hand sews


@dataclass(frozen=True)
class Layout:
    """A design under constant pressures, in the pose that is shown. by_pose: (channels,) Pa, by the numbers of the
    poses that were shown."""

    design: Design
    by_pose: Mapping[int, tuple[float, ...]]
    pose: int = 0

    @staticmethod
    def of(design: Design, pressures: tuple[float, ...] = ()) -> "Layout":
        """Return a layout with a pressure for each of the design's channels: those given, then zero."""
        return Layout(design, {0: pressures}).on(design)

    @property
    def pressures(self) -> tuple[float, ...]:
        """Return (channels,) Pa in the pose that is shown."""
        return self.by_pose[self.pose]

    def on(self, design: Design) -> "Layout":
        """Return another design under the same pressures: those of its channels, then zero."""
        count = design.channels
        by_pose = {pose: (*p[:count], *(0.0,) * (count - len(p))) for pose, p in self.by_pose.items()}
        return Layout(design, by_pose, self.pose)

    def at(self, pose: int) -> "Layout":
        """Return the layout with a pose shown; one that was never shown has the pressures of the one that is."""
        by_pose = {pose: self.pressures, **self.by_pose}
        return self if pose == self.pose else Layout(self.design, by_pose, pose)

    def without(self, pose: int) -> "Layout":
        """Return the layout without a pose: those after it move up, and a neighbour is shown in place of it."""
        kept = self.at(pose - 1 if pose else 1) if pose == self.pose else self
        by_pose = {k - (k > pose): p for k, p in kept.by_pose.items() if k != pose}
        return Layout(self.design, by_pose, kept.pose - (kept.pose > pose))

    def same_content(self, other: "Layout") -> bool:
        """Return whether design and pressures of every pose are the same, whichever pose is shown."""
        poses = {*self.by_pose, *other.by_pose}
        same = all(self.at(pose).pressures == other.at(pose).pressures for pose in poses)
        return same and self.design == other.design

    def with_muscles(self, *muscles: Muscle) -> "Layout":
        return self.on(replace(self.design, muscles=muscles))

    def with_muscle(self, index: int, **changes: Any) -> "Layout":
        """Return the layout with changes of a muscle's fields."""
        muscles = list(self.design.muscles)
        muscles[index] = replace(muscles[index], **changes)
        return self.with_muscles(*muscles)

    def with_pressure(self, channel: int, pressure: float) -> "Layout":
        """Return the layout with another pressure [Pa] on a channel."""
        pressures = (*self.pressures[:channel], pressure, *self.pressures[channel + 1 :])
        return replace(self, by_pose={**self.by_pose, self.pose: pressures})


def highest(design: Design) -> list[float]:
    """Return the end [Pa] of each channel's slider: what its muscles bear, HIGHEST at most where none says."""
    return [min(HIGHEST, float(most)) if most >= 1e6 else float(most) for most in pressure_limits(design)]


def point_name(muscle: Muscle, point: int) -> str:
    """Return what a point of a muscle's path is: one of its ends, or a corner between them."""
    return "end" if point in (0, len(muscle.path) - 1) else "corner"


def move_corner(layout: Layout, index: int, corner: int, to: Point) -> Layout:
    """Put an end or a corner of a muscle at `to`, or where the cloth ends."""
    path = list(layout.design.muscles[index].path)
    path[corner] = _within(layout.design, to)
    if any(a == b for a, b in itertools.pairwise(path)):
        return layout  # two points in one place: no leg between them
    return layout.with_muscle(index, path=tuple(path))


def move_muscle(layout: Layout, index: int, by: Point) -> Layout:
    """Shift a whole muscle, as far as the cloth goes."""
    design, path = layout.design, np.array(layout.design.muscles[index].path)
    size = [design.fabric.width, design.fabric.height]
    shifted = path + np.clip(by, -path.min(axis=0), size - path.max(axis=0))
    return layout.with_muscle(index, path=tuple(_within(design, (u, v)) for u, v in shifted.tolist()))


def add_muscle(layout: Layout, like: int | None = None) -> Layout:
    """Add a muscle, last in the list, down the middle of the front, on a channel of its own; `like` another one in
    type, face and pitch. Raises InputError where the design has no muscle type, or as many muscles as there may be."""
    design, fabric = layout.design, layout.design.fabric
    if not design.muscle_types:
        raise InputError(f"{design.name}: has no muscle types; expected one for a muscle to be of")
    if len(design.muscles) >= MUSCLES:
        raise InputError(f"{design.name}: has {MUSCLES} muscles; expected no more")
    middle, end = fabric.width / 2, _MARGIN * fabric.height
    path = (_within(design, (middle, end)), _within(design, (middle, fabric.height - end)))
    usual = Muscle(next(iter(design.muscle_types)), "front", 0, path, 0.02)
    new = replace(usual if like is None else design.muscles[like], channel=design.channels, path=path)
    return layout.with_muscles(*design.muscles, new)


def remove_muscle(layout: Layout, index: int) -> Layout:
    """Take a muscle off. A channel that no muscle is on any more goes, and those above it move down."""
    empty = layout.design.muscles[index].channel
    muscles = [muscle for i, muscle in enumerate(layout.design.muscles) if i != index]
    if all(muscle.channel != empty for muscle in muscles):
        muscles = [replace(m, channel=m.channel - (m.channel > empty)) for m in muscles]
        layout = replace(layout, by_pose={k: (*p[:empty], *p[empty + 1 :]) for k, p in layout.by_pose.items()})
    return layout.with_muscles(*muscles)


def flip(layout: Layout, index: int) -> Layout:
    """Put a muscle on the other face, in the same place of the cloth."""
    return layout.with_muscle(index, side="back" if layout.design.muscles[index].side == "front" else "front")


def set_type(layout: Layout, index: int, name: str) -> Layout:
    """Make a muscle of another type. Raises InputError for a type that the design does not have."""
    if name not in layout.design.muscle_types:
        raise InputError(f"muscle type {name}: expected one of {', '.join(layout.design.muscle_types)}")
    return layout.with_muscle(index, type=name)


def set_channel(layout: Layout, index: int, number: float) -> Layout:
    """Put a muscle on a channel. Raises InputError for a channel that would leave empty ones below it."""
    channel = int(number)
    if not 0 <= channel <= layout.design.channels:
        raise InputError(f"channel {channel}: expected 0 to {layout.design.channels}, the next free one")
    return layout.with_muscle(index, channel=channel)


def add_corner(layout: Layout, index: int) -> Layout:
    """Split a muscle's longest leg in the middle."""
    path = layout.design.muscles[index].path
    at = max(range(1, len(path)), key=lambda k: dist(path[k - 1], path[k]))
    (a, b), (c, d) = path[at - 1], path[at]
    middle = _within(layout.design, ((a + c) / 2, (b + d) / 2))
    return layout.with_muscle(index, path=(*path[:at], middle, *path[at:]))


def remove_corner(layout: Layout, index: int, corner: int) -> Layout:
    """Take a point off a muscle. Raises InputError where one point would remain, or two in one place."""
    muscle = layout.design.muscles[index]
    path = (*muscle.path[:corner], *muscle.path[corner + 1 :])
    if len(path) < 2 or any(a == b for a, b in itertools.pairwise(path)):
        raise InputError(f"muscle {index}: has {len(muscle.path)} points; expected two apart to remain")
    return layout.with_muscle(index, path=path)


def _within(design: Design, point: Point) -> Point:
    fabric = design.fabric
    u, v = min(max(point[0], 0.0), fabric.width), min(max(point[1], 0.0), fabric.height)
    return min(round(u, _MICRO), fabric.width), min(round(v, _MICRO), fabric.height)


def row_distance(design: Design) -> float:
    """Return the distance [m] between lacing rows where nobody says: half the pitch that most muscles have, so that a
    row runs through every fixed point of a muscle that starts on a row, and between."""
    pitches = Counter(muscle.fixed_point_pitch for muscle in design.muscles)
    return max((pitches.most_common(1)[0][0] if pitches else 0.02) / 2, LEAST_SPACING)


def rows(length: float, distance: float) -> Array:
    """Return rows (n,) m from an edge, every `distance`; the edges themselves are none."""
    places = distance * np.arange(1, int(np.ceil(length / distance)))
    return np.asarray(places[places < length - 1e-9], dtype=np.float64)


def snapped(point: Point, size: Point, distance: float) -> Point:
    """Return the crossing of two rows that lies nearest to `point`, on a cloth of `size` (width, height) m; a cloth
    narrower than two rows has none, and keeps the coordinate."""
    u, v = (
        float(round(among[np.argmin(np.abs(among - x))], 9)) if len(among := rows(length, distance)) else x
        for x, length in zip(point, size, strict=True)
    )
    return u, v


@dataclass(frozen=True)
class Broken:
    """A limit that is broken: its name in `optimize`'s results, a sentence, and whom it is about."""

    limit: str
    message: str
    muscles: tuple[int, ...] = ()
    channel: int | None = None


def broken_limits(layout: Layout, limits: Limits) -> list[Broken]:
    """Return those of every muscle, every two on one face, and every channel, which count from 0 as in files."""
    design, broken = layout.design, []
    size = np.array([design.fabric.width, design.fabric.height])
    for i, muscle in enumerate(design.muscles):
        free = float(np.min([muscle.path, size - muscle.path]))
        if free < limits.edge - _ROUNDING:
            message = f"lies {in_mm(free):.1f} mm from the edge; expected {in_mm(limits.edge):g} mm"
            broken.append(Broken("edge", f"muscle {i} {message}", (i,)))
    if design.muscles:
        margins = Margins(design, limits)
        values = margins.at(np.concatenate([muscle.path for muscle in design.muscles])).tolist()
        for name, who, margin in zip(margins.names, margins.muscles, values, strict=True):
            crossing = name == "spacing" and margin + limits.spacing < 0
            if crossing or margin < -_ROUNDING:
                message = _in_words(design, limits, name, who, margin)
                broken.append(Broken("crossing" if crossing else name, message, who))
    broken.sort(key=lambda line: (len(line.muscles), line.muscles))
    low, searched = limits.pressure
    for channel, (pressure, most) in enumerate(zip(layout.pressures, pressure_limits(design), strict=True)):
        by_type = most < LARGEST and most <= searched
        high, why = (most, "the muscles' maximum") if by_type else (searched, "the highest that is searched")
        if not low - 1e-6 <= pressure <= high + 1e-6:
            expected = f"expected {in_kpa(low):g} to {in_kpa(high):g} kPa, {why}"
            message = f"channel {channel} has {in_kpa(pressure):g} kPa; {expected}"
            broken.append(Broken("pressure", message, channel=channel))
    return broken


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

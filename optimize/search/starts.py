"""Where searches begin: pressures that fill their space, and layouts as a designer would draw them."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.stats import qmc

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import LAYOUTS, build
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.study_files.study_file import MuscleChoice, Side
from optimize.search.design_space import DesignSpace, Layout, Vector, start_of, starts_of
from optimize.search.margins import Limits

Start = tuple[DesignSpace, Vector]

TRIES = 60  # draws of a layout before a muscle count counts as too many for the cloth
ONE_WAY = 0.6  # of the drawn layouts have all muscles on one face, and as many one pressure for all
PITCH = 0.02  # m, between fixed points, where the design has no muscle to copy it from
PARTS = ((0.0, 1.0), (0.0, 2 / 3), (1 / 3, 1.0))  # of the way through the cloth, that even lines run
ANGLES = (0.0, np.pi / 2, np.pi / 4, -np.pi / 4)  # of parallel muscles against the v axis; and any angle


def pressure_starts(space: DesignSpace, count: int, seed: int) -> list[Start]:
    """Return the space's start, and `count` vectors with pressures from a scrambled Sobol sequence, positions
    unchanged."""
    first = space.encode(space.design, space.start_pressures)
    pressures = space.dimension - space.position_count
    sequence = qmc.Sobol(pressures, rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(count + 1))))
    rows = [np.concatenate([first[: space.position_count], row]) for row in sequence[:count]]
    return [(space, first), *((space, row) for row in rows)]


def catalogue_starts(design: Design, limits: Limits, poses: int, choice: MuscleChoice) -> list[Start]:
    """Return the catalogue's layouts and even lines on each side, through the whole cloth and through two thirds of it
    from either end, of the most and of about half as many muscles, at the highest pressure and at the middle; those
    that keep the limits. Several poses have different pressures, and pull on each face alone too."""
    space = DesignSpace(design, limits, np.zeros((poses, 0)))
    name, kind = next(iter(design.muscle_types.items()))
    layouts: list[Layout] = []
    for count in sorted({choice.most, max(choice.least, (choice.most + 1) // 2)}, reverse=True):
        gaps = (np.arange(count) + 0.5) / count - 0.5
        layouts += [
            (_straight(space, _part(lines, *part), [name] * count, [side] * count), pressures)
            for side in choice.sides
            for lines in (_lines(space, gaps, angle) for angle in (0.0, np.pi / 2))
            for part in PARTS
            for pressures in _levels(limits, poses, [side] * count)
        ]
        for layout in LAYOUTS:
            try:
                drawn = build(
                    layout, fabric=design.fabric, muscle_type=kind, muscles=count, fixed_point_pitch=_pitch(design)
                ).muscles
            except InputError:  # no such count, or no room for it
                continue
            if {muscle.side for muscle in drawn} <= set(choice.sides):
                levels = _levels(limits, poses, [muscle.side for muscle in drawn])
                layouts += [(drawn, pressures) for pressures in levels]
    return starts_of(layouts, space)


def _levels(limits: Limits, poses: int, sides: Sequence[str]) -> list[Array]:
    """Return (poses, muscles) Pa each: for one pose all muscles at the highest pressure and at the middle; for several
    these, and those with one face idle, spread over the poses, since each takes the nearest of a layout's shapes."""
    faces = _faces(sides) if poses > 1 else [np.ones(len(sides), dtype=bool)]
    low, high = limits.pressure
    rows = [np.where(face, level, low) for level in (high, (low + high) / 2) for face in faces]
    return [np.resize(rows[k : k + poses], (poses, len(sides))) for k in range(0, len(rows), poses)]


def _faces(sides: Sequence[str]) -> list[NDArray[np.bool_]]:
    """Return which muscles (muscles,) pull: all, and where both faces have some, those of each alone."""
    front = np.array(sides) == "front"
    return [np.full(len(sides), True), *([front, ~front] if front.any() and not front.all() else [])]


def layout_starts(
    design: Design, limits: Limits, poses: int, choice: MuscleChoice, *, number: int, seed: int
) -> list[Start]:
    """Return up to `number` drawn layouts on the design's cloth, each with a channel of its own for every muscle.

    A count comes as often as it is large: there is more to draw. Half are parallel lines (upright, level, diagonal or
    at any angle), half loose lines; more than half have all muscles on one face and one pressure, as large shapes
    want them, or of several poses one in each, of muscles that pull there; all keep the limits, so that counts that do
    not fit the cloth are absent.
    """
    space, rng = DesignSpace(design, limits, np.zeros((poses, 0))), np.random.default_rng(seed)
    turns = [n for lowest in range(choice.most, 0, -1) for n in choice.counts if n >= lowest]
    starts: list[Start] = []
    crowded = set()
    for i in range(number):
        count = turns[i % len(turns)]
        start = None if count in crowded else _draw(space, count, choice.sides, rng)
        if start is None:
            crowded.add(count)
        else:
            starts.append(start)
    return starts


def thinned_starts(space: DesignSpace, count: int, *, number: int, seed: int) -> list[Start]:
    """Return layouts of `count` of the design's own muscles, under the pressures that it begins with, a channel for
    each: all that there are, or `number` of them drawn by `seed`."""
    design, pressures = space.design, space.start_pressures
    subsets = list(combinations(range(len(design.muscles)), count))
    if len(subsets) > number:
        chosen = np.random.default_rng(seed).choice(len(subsets), number, replace=False)
        subsets = [subsets[i] for i in sorted(chosen)]
    layouts = [[design.muscles[i] for i in subset] for subset in subsets]
    by_channel = ((kept, pressures[:, [muscle.channel for muscle in kept]]) for kept in layouts)
    return starts_of(by_channel, space)


def _draw(space: DesignSpace, count: int, sides: Sequence[Side], rng: Generator) -> Start | None:
    limits = space.limits
    for _ in range(TRIES):
        lines = _parallel(space, count, rng) if rng.random() < 0.5 else rng.uniform(*_box(space), (count, 2, 2))
        kinds = [str(rng.choice(list(space.design.muscle_types))) for _ in range(count)]
        drawn = [sides[int(k)] for k in rng.integers(len(sides), size=count)]
        pressures = rng.uniform(*limits.pressure, (len(space.start_pressures), count))
        if rng.random() < ONE_WAY:
            drawn = drawn[:1] * count
        if rng.random() < ONE_WAY:
            pressures[:] = limits.pressure[0] + rng.uniform(0.5, 1.0) * np.ptp(limits.pressure)
            if len(pressures) > 1:
                pressures = _parts_pull(limits, len(pressures), drawn, rng)
        start = start_of((_straight(space, lines, kinds, drawn), pressures), space)
        if start is not None:
            return start
    return None


def _parts_pull(limits: Limits, poses: int, sides: Sequence[str], rng: Generator) -> Array:
    """Return (poses, muscles) Pa: in each pose one pressure in a part of the muscles; on two faces one after the other,
    else by chance."""
    _, *faces = _faces(sides)
    parts = rng.random((poses, len(sides))) < 0.5
    parts[~parts.any(axis=1)] = True
    if faces:
        first = int(rng.integers(2))
        parts = np.array([faces[(first + pose) % 2] for pose in range(poses)])
    low, high = limits.pressure
    return np.where(parts, low + rng.uniform(0.5, 1.0, (poses, 1)) * (high - low), low)


def _straight(space: DesignSpace, lines: Array, kinds: Sequence[str], sides: Sequence[Side]) -> list[Muscle]:
    """Return a muscle along each of (muscles, 2, 2) m."""
    pitch = _pitch(space.design)
    return [Muscle(kind, side, 0, (), pitch).along(line) for kind, side, line in zip(kinds, sides, lines, strict=True)]


def _pitch(design: Design) -> float:
    return design.muscles[0].fixed_point_pitch if design.muscles else PITCH


def _parallel(space: DesignSpace, count: int, rng: Generator) -> Array:
    """Return (count, 2, 2) even lines through the cloth, shortened by up to half."""
    angle = rng.choice(ANGLES) if rng.random() < 0.7 else rng.uniform(-np.pi / 2, np.pi / 2)
    gaps = (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count - 0.5
    lines = _lines(space, gaps, angle)
    kept = rng.uniform(0.5, 1.0)
    shift = rng.uniform(0.0, 1.0 - kept)
    return _part(lines, shift, shift + kept)


def _part(lines: Array, begin: float, end: float) -> Array:
    """Return the part of each line from one share of its length to another."""
    return np.array([[a + begin * (b - a), a + end * (b - a)] for a, b in lines])


def _lines(space: DesignSpace, gaps: Array, angle: float) -> Array:
    """Return (count, 2, 2) lines at `angle` [rad] against the v axis through the whole box, `gaps` of its extent
    apart."""
    along, across = np.array([np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
    low, high = _box(space)
    middle, extent = (low + high) / 2, float(np.abs(across) @ (high - low))
    return np.array([_clipped(middle + gap * extent * across, along, low, high) for gap in gaps])


def random_line(space: DesignSpace, rng: Generator) -> Array:
    """Return (2, 2) m: a line through the cloth's box at any angle, cut to a part of it."""
    angle, gap = rng.uniform(-np.pi / 2, np.pi / 2), rng.uniform(-0.45, 0.45)
    if rng.random() < 0.5:
        angle = rng.choice(ANGLES)
    begin = rng.uniform(0.0, 0.4)
    return _part(_lines(space, np.array([gap]), angle), begin, rng.uniform(begin + 0.4, 1.0))[0]


def _box(space: DesignSpace) -> tuple[Array, Array]:
    """Return the least and largest (u, v) [m] of corners."""
    return np.full(2, space.limits.edge), space.size - space.limits.edge


def _clipped(point: Array, along: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the ends of the line through a point of the box, clipped to the box (Liang and Barsky 1984)."""
    safe = np.where(np.abs(along) < 1e-12, 1e-12, along)
    borders = np.sort([(low - point) / safe, (high - point) / safe], axis=0)
    return point + np.max(borders[0]) * along, point + np.min(borders[1]) * along

"""A good layout with muscles more: where the search for a larger layout begins, so that it is no worse."""

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from fabdesign.nouns.muscle import Muscle
from optimize.search.channels import Layout, by_muscle, start_of
from optimize.search.design_space import DesignSpace
from optimize.search.starts import PITCH, Side, Start, random_line

TRIES = 40  # draws of a further muscle before a layout counts as full
BESIDE = 0.5  # of the further muscles are drawn beside one that is there, the others anywhere
SHIFT = 0.15  # of the cloth, standard deviation from the muscle beside which one is drawn


def with_idle(best: Start, *, count: int, sides: Sequence[Side], number: int, seed: int) -> list[Start]:
    """Return up to `number` layouts of `count` muscles that hold those of `best`, each with a channel of its own; the
    further ones are drawn on `sides` and idle, at the lowest pressure. All keep the limits.

    A layout that has `count` muscles already comes back alone.
    """
    layout, space = by_muscle(best), best[0]
    rng = np.random.default_rng(seed)
    further = count - len(layout[0])
    starts = []
    for _ in range(number if further > 0 else 1):
        grown: Layout | None = layout
        for _ in range(further):
            grown = None if grown is None else _with_one_more(grown, space, sides, rng)
        start = None if grown is None else start_of(grown, space)
        if start is not None:
            starts.append(start)
    return starts


def pulling(starts: Sequence[Start], muscles: int, share: float) -> list[Start]:
    """Return the same layouts with their muscles from number `muscles` on at a share of the pressure range."""
    shifted = []
    for start in starts:
        single, pressures = by_muscle(start)
        low, high = start[0].limits.pressure
        pressures[:, muscles:] = low + share * (high - low)
        shifted.append(start_of((single, pressures), start[0]))
    return [start for start in shifted if start is not None]


def _with_one_more(layout: Layout, space: DesignSpace, sides: Sequence[Side], rng: Generator) -> Layout | None:
    muscles, pressures = layout
    for _ in range(TRIES):
        muscle = _drawn(muscles, space, sides, rng)
        idle = np.full((len(pressures), 1), space.limits.pressure[0])
        grown = [*muscles, muscle], np.concatenate([pressures, idle], axis=1)
        if start_of(grown, space) is not None:
            return grown
    return None


def _drawn(muscles: Sequence[Muscle], space: DesignSpace, sides: Sequence[Side], rng: Generator) -> Muscle:
    fabric = space.design.fabric
    side = sides[int(rng.integers(len(sides)))]
    if muscles and rng.random() < BESIDE:
        neighbour = muscles[int(rng.integers(len(muscles)))]
        shift = SHIFT * np.array([fabric.width, fabric.height]) * rng.standard_normal((len(neighbour.path), 2))
        path = np.array(neighbour.path) + shift
        kind, pitch = neighbour.type, neighbour.fixed_point_pitch
    else:
        path = random_line(space.design, space.limits, rng)
        kind = str(rng.choice(list(space.design.muscle_types)))
        pitch = muscles[0].fixed_point_pitch if muscles else PITCH
    inside = np.clip(path, space.limits.edge, np.array([fabric.width, fabric.height]) - space.limits.edge)
    corners = tuple((float(u), float(v)) for u, v in inside)
    return Muscle(type=kind, side=side, channel=0, path=corners, fixed_point_pitch=pitch)

"""Layouts near a good one: where a search begins anew that has come to the end of its slopes, and with muscles more,
where the search for a larger layout begins, so that it is no worse."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.random import Generator

from fabdesign.nouns.muscle import Muscle
from fabdesign.study_files.study_file import MuscleChoice, Side
from optimize.search.design_space import DesignSpace, Layout, Vector, by_muscle, start_of, starts_of
from optimize.search.starts import PITCH, Start, random_line

TRIES = 40  # of a variation before it is left out
SHIFT = 0.15  # of the cloth: a line's end moves by as much, as a standard deviation
SLIGHT = 0.05  # the same where all lines move
BEND = 0.1  # of a leg, that its new corner lies off it, as a standard deviation


def variations(best: Start, choice: MuscleChoice, *, number: int, seed: int) -> list[Start]:
    """Return up to `number` layouts that differ from `best` by a move or two: a muscle added, left out, on the other
    face, drawn anew, with a corner more or less, or its ends or pressure moved; all lines shifted or moved a little.
    All keep the limits.

    A muscle that shares its channel gets one of its own, as far as the limits have channels.
    """
    space, _ = best
    rng = np.random.default_rng(seed)
    starts: list[Start] = []
    for _ in range(number):
        for _ in range(TRIES):
            layout = by_muscle(best)
            for _ in range(int(rng.integers(1, 3))):
                layout = _moved(layout, space, choice, rng)
            start = start_of(layout, space)
            if start is not None:
                starts.append(start)
                break
    return starts


def with_corners(best: Start, corners: int) -> list[Start]:
    """Return the same layout with a corner in the middle of every muscle that has fewer than `corners`, where it lies:
    for a search by derivatives to move. None where no muscle may have one more."""
    muscles, pressures = by_muscle(best)
    bent = [_bent(muscle, 0.0) if len(muscle.path) - 2 < corners else muscle for muscle in muscles]
    return starts_of([(bent, pressures)] if bent != [*muscles] else [], best[0])


def straightened(start: Start) -> Start | None:
    """Return the same layout without corners between the ends; None where there are none, or that breaks a limit."""
    muscles, pressures = by_muscle(start)
    straight = [replace(muscle, path=(muscle.path[0], muscle.path[-1])) for muscle in muscles]
    return start_of((straight, pressures), start[0]) if straight != [*muscles] else None


def doubled(start: Start, muscle: int, share: float) -> Start | None:
    """Return the same layout with a muscle, from 0, as two beside each other at that share of its pressures; None where
    that breaks a limit. Errors of the two are independent, so that they average out."""
    (muscles, pressures), space = by_muscle(start), start[0]
    path = _path(muscles[muscle])
    along = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    off = space.limits.spacing * np.array([-along[1], along[0]])
    pair = [_inside(muscles[muscle], path + side * off, space) for side in (1, -1)]
    both = np.insert(pressures, muscle, pressures[:, muscle], axis=1)
    both[:, muscle : muscle + 2] *= share
    return start_of(([*muscles[:muscle], *pair, *muscles[muscle + 1 :]], both), space)


def _moved(layout: Layout, space: DesignSpace, choice: MuscleChoice, rng: Generator) -> Layout:
    muscles, pressures = [*layout[0]], layout[1].copy()
    k = int(rng.integers(len(muscles)))
    size, placed = space.size, partial(_inside, space=space)
    moves = ["add", "drop", "flip", "draw", "ends", "pressure", "shift", "all"]
    moves += ["bend"] * (choice.corners > 0) + ["straighten"] * (len(muscles[k].path) > 2)
    move = rng.choice(moves)
    if move == "add" and len(muscles) + 1 in choice.counts:
        muscles.append(placed(muscles[k], _path(muscles[k]) + SHIFT * size * rng.standard_normal(2)))
        pressures = np.concatenate([pressures, pressures[:, k : k + 1]], axis=1)
    elif move == "drop" and len(muscles) - 1 in choice.counts:
        del muscles[k]
        pressures = np.delete(pressures, k, axis=1)
    elif move == "flip":
        muscles[k] = replace(muscles[k], side=choice.sides[int(rng.integers(len(choice.sides)))])
        pressures[:, k] = pressures.max(axis=1)  # what was idle on one face may pull on the other
    elif move == "draw":
        muscles[k] = placed(muscles[k], rng.uniform(0.0, 1.0, (2, 2)) * size)
    elif move == "ends":
        noise = SHIFT * size * rng.standard_normal((len(muscles[k].path), 2))
        muscles[k] = placed(muscles[k], _path(muscles[k]) + noise)
    elif move == "bend" and len(muscles[k].path) - 2 < choice.corners:
        bent = _bent(muscles[k], BEND * rng.standard_normal())
        muscles[k] = placed(bent, _path(bent))
    elif move == "straighten":
        path = [*muscles[k].path]
        del path[int(rng.integers(1, len(path) - 1))]
        muscles[k] = replace(muscles[k], path=tuple(path))
    elif move == "pressure":
        pressures[:, k] = rng.uniform(*space.limits.pressure, len(pressures))
    elif move == "shift":
        step = SHIFT * size * rng.standard_normal(2)
        muscles = [placed(m, _path(m) + step) for m in muscles]
    elif move == "all":
        muscles = [placed(m, _path(m) + SLIGHT * size * rng.standard_normal((len(m.path), 2))) for m in muscles]
    return muscles, pressures


def _bent(muscle: Muscle, off: float) -> Muscle:
    """Return the muscle with a corner in the middle of its longest leg, off it by a share of its length."""
    path = _path(muscle)
    legs = np.diff(path, axis=0)
    k = int(np.argmax(np.linalg.norm(legs, axis=1)))
    return muscle.along(
        np.insert(path, k + 1, path[k] + legs[k] / 2 + off * np.array([-legs[k, 1], legs[k, 0]]), axis=0)
    )


def _path(muscle: Muscle) -> Vector:
    return np.array(muscle.path)


def _inside(muscle: Muscle, path: Vector, space: DesignSpace) -> Muscle:
    """Return the muscle with its path within the cloth less its edge."""
    return muscle.along(np.clip(path, space.limits.edge, space.size - space.limits.edge))


BESIDE = 0.5  # of the further muscles are drawn beside one that is there, the others anywhere


def with_idle(best: Start, *, count: int, sides: Sequence[Side], number: int, seed: int) -> list[Start]:
    """Return up to `number` layouts of `count` muscles that hold those of `best`, each with a channel of its own; the
    further ones are drawn on `sides` and idle, at the lowest pressure. All keep the limits.

    A layout that has `count` muscles already comes back alone.
    """
    layout, space = by_muscle(best), best[0]
    rng = np.random.default_rng(seed)
    further = count - len(layout[0])
    layouts = []
    for _ in range(number if further > 0 else 1):
        grown: Layout | None = layout
        for _ in range(further):
            grown = None if grown is None else _with_one_more(grown, space, sides, rng)
        layouts += [] if grown is None else [grown]
    return starts_of(layouts, space)


def pulling(starts: Sequence[Start], muscles: int, share: float) -> list[Start]:
    """Return the same layouts with their muscles from number `muscles` on at a share of the pressure range."""
    shifted = []
    for start in starts:
        single, pressures = by_muscle(start)
        low, high = start[0].limits.pressure
        pressures[:, muscles:] = low + share * (high - low)
        shifted += starts_of([(single, pressures)], start[0])
    return shifted


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
    side = sides[int(rng.integers(len(sides)))]
    if muscles and rng.random() < BESIDE:
        neighbour = muscles[int(rng.integers(len(muscles)))]
        shift = SHIFT * space.size * rng.standard_normal((len(neighbour.path), 2))
        path = _path(neighbour) + shift
        kind, pitch = neighbour.type, neighbour.fixed_point_pitch
    else:
        path = random_line(space, rng)
        kind = str(rng.choice(list(space.design.muscle_types)))
        pitch = muscles[0].fixed_point_pitch if muscles else PITCH
    return _inside(Muscle(kind, side, 0, (), pitch), path, space)

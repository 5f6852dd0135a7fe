"""No more muscles, corners and channels than needed: those whose absence costs least are left out, the others take
over, while the objective stays within a tolerance or a price pays for it.

The number of muscles is found by bisection. A smaller layout is the greedy choice of muscles: drop one, or
lay two that do the same into one, whichever costs least. Its pressures and places are then searched on the coarse model
and on the full one; what is near enough is kept, and is where the next begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fabdesign.study_files.study_targets import Price
from optimize.search.design_space import DesignSpace, Layout, by_muscle, start_of, with_shared_channels
from optimize.search.evaluations import Evaluations, Stop
from optimize.search.local_search import LocalSearch
from optimize.search.multistart import run_rounds, searches_from
from optimize.search.starts import Start
from optimize.search.variations import straightened

ROUNDS = 5  # of a smaller layout on the coarse model,
FINE_ROUNDS = 4  # and on the full one
CLOSE = 0.1  # of the cloth's longer side: so near, in the mean of their ends, two muscles do the same
HOPEFUL = 1.5  # times what is allowed: a layout on the coarse model is tried on the full one up to there


@dataclass(frozen=True, eq=False)
class Fewer:
    """start: with its value in m on the full model; before, count: of the layout that it comes from. ended: why it is
    that layout itself, empty where it is another. cut: by a limit, before all was tried. front: numbers of muscles, and
    m of the nearest layout of each that came nearer than all smaller numbers; what was tried on the full model."""

    start: Start
    value: float
    before: float
    count: int
    ended: str
    cut: bool = False
    front: tuple[tuple[int, float], ...] = ()


def fewer_muscles(evaluations: Evaluations, *, least: int, price: Price) -> Fewer:
    """Return the best of `evaluations` with as few muscles as the price allows, never under `least`; itself where none
    may go.

    Nothing that is evaluated here becomes the `best` of the evaluations. Ends at their limits with what it has.
    """
    best, last = evaluations.nearest(), len(evaluations.stages) - 1
    space, x = evaluations.best_point() if best is None else evaluations.point(best)
    value, count = np.inf if best is None else best.value, len(space.design.muscles)
    smallest = Fewer((space, x), value, value, count, "no smaller layout is near enough")
    if best is None or not evaluations.stages[best.stage].values_as(evaluations.stages[last]):
        return replace(smallest, ended="the search ended before the full model", cut=True)
    begun, lowest, highest = len(evaluations.starts), least, count
    layout = by_muscle((space, x))
    evaluations.noting = False
    try:
        while lowest < highest:
            size = (lowest + highest) // 2
            allowed = price.allowed(value, count - size)
            smaller = _searched(evaluations, _thinned(evaluations, layout, space, size), allowed)
            if smaller is None:
                lowest = size + 1
                continue
            highest = size
            smallest = replace(smallest, start=(smaller.space, smaller.x), value=smaller.value, ended="")
            layout = by_muscle((smaller.space, smaller.x))
        if evaluations.stages[last].vary_positions:
            smallest = _simpler(evaluations, smallest, straightened(smallest.start), price)
        return _simpler(evaluations, smallest, with_shared_channels(smallest.start), price)
    except Stop as stop:
        return replace(smallest, ended=smallest.ended and str(stop), cut=True)
    finally:
        evaluations.noting = True
        del evaluations.starts[begun:]


def _thinned(evaluations: Evaluations, layout: Layout, space: DesignSpace, size: int) -> LocalSearch | None:
    """Return the greedy choice of `size` of the layout's muscles, on the coarse model; None where there is none."""
    stage, local = len(evaluations.stages) - 2, None
    while len(layout[0]) > size:
        muscles, pressures = layout
        drops = [([*muscles[:k], *muscles[k + 1 :]], np.delete(pressures, k, axis=1)) for k in range(len(muscles))]
        choices = [*drops, *_merges(layout, space)]
        candidates = [(choice, start) for choice in choices if (start := start_of(choice, space))]
        if not candidates:
            return None
        searches = _searches(evaluations, stage, [start for _, start in candidates])
        best = min(range(len(searches)), key=lambda k: searches[k].value)
        layout, local = candidates[best][0], searches[best]
    return local


def _searched(evaluations: Evaluations, local: LocalSearch | None, allowed: float) -> LocalSearch | None:
    """Return the search on from there, first on the coarse model; None where it does not come to what is allowed, m."""
    last = len(evaluations.stages) - 1
    coarse = run_rounds(evaluations, last - 1, [local], ROUNDS, until=allowed) if local else []
    if not coarse or coarse[0].value > HOPEFUL * allowed:
        return None
    fine = run_rounds(evaluations, last, coarse, FINE_ROUNDS, until=allowed)
    return fine[0] if fine and fine[0].value <= allowed else None


def _searches(evaluations: Evaluations, stage: int, starts: Sequence[Start]) -> list[LocalSearch]:
    """Return searches from starts that the evaluations get to know, valued on the model of a stage."""
    first = len(evaluations.starts)
    evaluations.starts += starts
    return searches_from(evaluations, stage, first)


def _simpler(evaluations: Evaluations, smallest: Fewer, start: Start | None, price: Price) -> Fewer:
    """Return a simpler layout of as many muscles where it is near enough, or the price of the channels that it saves
    pays for it; else `smallest`."""
    if start is None:
        return smallest
    saved = smallest.start[0].channels - start[0].channels
    allowed = max(price.allowed(smallest.before, 0), smallest.value + saved * price.channel)
    last = len(evaluations.stages) - 1
    local = run_rounds(evaluations, last, _searches(evaluations, last, [start]), FINE_ROUNDS, until=allowed)
    if local and local[0].value <= allowed:
        return replace(smallest, start=(local[0].space, local[0].x), value=local[0].value, ended="")
    return smallest


def _merges(layout: Layout, space: DesignSpace) -> list[Layout]:
    """Return pairs on one face that lie close become one between them, with the higher pressures."""
    muscles, pressures = layout
    size = max(space.design.fabric.width, space.design.fabric.height)
    merged: list[Layout] = []
    for i, j in combinations(range(len(muscles)), 2):
        a, b = muscles[i], muscles[j]
        if (a.side, a.type, len(a.path)) != (b.side, b.type, len(b.path)):
            continue
        one, other = np.array(a.path), np.array(b.path)
        ways = [other, other[::-1]]
        other = min(ways, key=lambda way: float(np.linalg.norm(way - one)))
        if np.linalg.norm(one - other, axis=1).mean() > CLOSE * size:
            continue
        kept = [*muscles[:j], *muscles[j + 1 :]]
        kept[i] = a.along((one + other) / 2)
        thinned = np.delete(pressures, j, axis=1)
        thinned[:, i] = np.maximum(pressures[:, i], pressures[:, j])
        merged.append((kept, thinned))
    return merged

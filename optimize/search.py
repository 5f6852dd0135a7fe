"""The search: screen many starts, follow the best side by side, finish the best of those on the full model.

Every forward evaluation is part of a batch: the screening, and in a round the trial steps of all searches with the
finite differences around them. A round of a search is a linear model of the shape, NLopt's best step on it, and that
step tried at several lengths at once. Nothing depends on time or order, so that a seed gives one result.
"""

from typing import Any

import numpy as np

from fabdesign.forward import ForwardModel
from optimize.design_space import Vector
from optimize.evaluations import Best, Evaluations, Stop
from optimize.local_search import LocalSearch
from optimize.objective import Shape

INTERRUPTED = "interrupted; the same command goes on from here"


def search(evaluations: Evaluations) -> str:
    """Run the stages of `evaluations`, whose `best` is the result whatever ends it; why it ended, as a sentence.

    The first stage screens the starts. The same search on the same history goes on after the last round that was
    finished, and ends where it would have ended.
    """
    try:
        at, searches = _load(evaluations)
        if reason := evaluations.ended():
            return reason
        for number in range(at, len(evaluations.stages)):
            if number > at or not searches:
                searches = _enter(evaluations, number, searches or _screen(evaluations))
                _save(evaluations, number, searches)
            while (going := [s for s in searches if not s.done]) and evaluations.may_begin(number):
                _round(evaluations, number, going)
                _save(evaluations, number, searches)
    except Stop as stop:
        evaluations.set_down(str(stop))
        return str(stop)
    except KeyboardInterrupt:
        evaluations.set_down()
        return INTERRUPTED
    return "converged: no search promises a further gain"


def _screen(evaluations: Evaluations) -> list[LocalSearch]:
    spaces = [evaluations.space(i, 0) for i in range(len(evaluations.starts))]
    xs = [own.encode(*space.decode(x)) for own, (space, x) in zip(spaces, evaluations.starts, strict=True)]
    values = evaluations.evaluate(0, list(enumerate(xs)))
    return [LocalSearch(i, spaces[i], xs[i], value, shape=shape) for i, (value, shape) in enumerate(values)]


def _enter(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> list[LocalSearch]:
    """The best go on in the stage's space, valued by its forward model.

    They are distinct, and at most half of them have one count of muscles where there are several: few muscles
    come near a target soon, more come nearer later.
    """
    stage = evaluations.stages[number]
    kept: list[LocalSearch] = []
    counts = [len(s.space.design.muscles) for s in searches]
    most = stage.keep if len(set(counts)) == 1 else (stage.keep + 1) // 2
    for local in sorted(searches, key=lambda s: s.value):
        alike = sum(len(k.space.design.muscles) == len(local.space.design.muscles) for k in kept)
        if len(kept) < stage.keep and alike < most and all(local.distinct(other) for other in kept):
            kept.append(local)
    spaces = [evaluations.space(s.start, number) for s in kept]
    xs = [space.encode(*s.space.decode(s.x)) for space, s in zip(spaces, kept, strict=True)]
    values = evaluations.evaluate(number, [(s.start, x) for s, x in zip(kept, xs, strict=True)])
    moved = [
        local.enter(space, x, value, shape)
        for local, space, x, (value, shape) in zip(kept, spaces, xs, values, strict=True)
        if np.all(np.isfinite(shape))
    ]
    if not moved:
        raise Stop("every design diverged")
    for local in moved:
        local.done = stage.rounds == 0
    return moved


def _round(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> None:
    _find_slopes(evaluations, number, [s for s in searches if s.model is None])
    trials, wanted = [], []
    stage = evaluations.stages[number]
    for local in searches:
        evaluations.require_time()
        xs = local.trials(evaluations.objective)
        trials.append(xs)
        ahead = xs and local.rounds < stage.rounds - 1 and stage.slopes is None
        wanted.append(xs + (local.differences(xs[0]) if ahead else []))
    for local, xs, found in zip(searches, trials, _evaluate_all(evaluations, number, searches, wanted), strict=True):
        local.accept(evaluations.objective, xs, found[: len(xs)], [shape for _, shape in found[len(xs) :]])
        local.done = local.done or local.rounds >= stage.rounds


def _find_slopes(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> None:
    bare = [s for s in searches if s.shape is None]
    for local, [(_, shape)] in zip(bare, _evaluate_all(evaluations, number, bare, [[s.x] for s in bare]), strict=True):
        local.shape = shape
    cheap = evaluations.stages[number].slopes
    wanted = [s.lacks(known=cheap is None) for s in searches]
    for local, found in zip(searches, _evaluate_all(evaluations, number, searches, wanted, cheap), strict=True):
        local.linearise([shape for _, shape in found])


def _evaluate_all(
    evaluations: Evaluations,
    number: int,
    searches: list[LocalSearch],
    xs: list[list[Vector]],
    cheap: ForwardModel | None = None,
) -> list[list[tuple[float, Shape]]]:
    """Each search's own vectors, all in common batches; on the stage's model, or on `cheap`."""
    flat = [(local.start, x) for local, own in zip(searches, xs, strict=True) for x in own]
    results = iter(evaluations.evaluate(number, flat, cheap))
    return [[next(results) for _ in own] for own in xs]


def _save(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> None:
    found = evaluations.best
    best = None if found is None else [found.start, found.x.tolist(), found.value, found.stage]
    rows = [
        [
            s.start,
            s.x.tolist(),
            s.value,
            s.radius,
            s.rounds,
            s.done,
            None if s.slopes_at is None else s.slopes_at.tolist(),
        ]
        for s in searches
    ]
    evaluations.history.save({"stage": number, "best": best, "searches": rows}, evaluations.elapsed)


def _load(evaluations: Evaluations) -> tuple[int, list[LocalSearch]]:
    state: Any = evaluations.history.load()
    if state is None:
        return 0, []
    if state["best"] is not None:
        start, x, value, at = state["best"]
        evaluations.best = Best(start, np.array(x), value, at)
    searches = [
        LocalSearch(
            start,
            evaluations.space(start, state["stage"]),
            np.array(x),
            value,
            radius,
            rounds,
            done,
            slopes_at=None if slopes_at is None else np.array(slopes_at),
        )
        for start, x, value, radius, rounds, done, slopes_at in state["searches"]
    ]
    return state["stage"], searches

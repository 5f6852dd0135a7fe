"""The search is a multistart. Each restart, the first included, screens many starts, follows the best side by side, and
finishes the best of those on the full model. It ends where searches from new starts agree, the target is reached, or
the time is used.

Every forward evaluation is part of a batch: the screening, the derivatives of all searches, and the trial steps of all
searches; where the forward model has no derivatives, finite differences with those. A round of a search is a linear
model of the shape, NLopt's best step on it, and that step tried at several lengths at once. Nothing but where the
limits cut depends on time or order, so that a seed gives one result.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.muscle import Muscle
from optimize.search.design_space import Vector
from optimize.search.evaluations import Evaluations, Stop
from optimize.search.local_search import LinearShape, LocalSearch
from optimize.search.objective import Objective, Poses
from optimize.search.search_state import FurtherStarts, SearchState, add_starts, load_state, save_state

INTERRUPTED = "interrupted; the same command goes on from here"
NOTHING_NEW = "ended: no search promises a further gain, and there are no further starts"
AGREE = 3  # searches from different starts that end as near as the best one does, itself included
ALIKE = 0.01  # of the best value, by which such ends may differ
IDLE = 3  # restarts that came no nearer than NO_GAIN of the best value: a further one is not worth its time
NO_GAIN = 0.005
Questions = tuple[LocalSearch, list[Vector]]  # what a search wants evaluated
AT_ONCE = 8  # designs that take a simulator no longer than one: so many trials a round, shared by the searches


def search(
    evaluations: Evaluations, *, further: FurtherStarts | None = None, floor: Callable[[Poses], float] | None = None
) -> str:
    """Run restarts over the stages of `evaluations`, whose `best` is the result whatever ends it; why it ended, as a
    sentence.

    The first restart takes the starts of `evaluations`. `further` gives those of later ones; without it there is one.
    Only searches from starts that owe nothing to the best can agree with it. floor: m, what points of a shape itself
    would have as value. The same search on the same history goes on after the last round that was
    finished, and ends where it would have ended.
    """
    try:
        at = load_state(evaluations, further)
        if reason := evaluations.ended():
            return reason
        if evaluations.history.load() is None:
            save_state(evaluations, at)  # so that an end within the screening is kept too
        while not at.reason:
            _run_restart(evaluations, at, floor)
            if at.independent:
                at.ends += [s.value for s in at.searches]
            at.reason = _reason_to_end(evaluations, at, floor)
            if not at.reason and not _begin(evaluations, at, further):
                at.reason = NOTHING_NEW
            save_state(evaluations, at)
        return at.reason
    except Stop as stop:
        evaluations.set_down(str(stop))
        return str(stop)
    except KeyboardInterrupt:
        evaluations.set_down()
        return INTERRUPTED


def has_converged(evaluations: Evaluations) -> bool:
    """Return whether the search has ended by itself, by no limit and no interrupt."""
    return bool((evaluations.history.load() or {}).get("reason"))


def evaluations_to_converge(evaluations: Evaluations) -> int | None:
    """Return about how many more a search that has not converged needs: as many as its restarts took, until AGREE of
    them are done, and at least one more. None before the first is done: then nothing says it."""
    state = evaluations.history.load() or {}
    done, restarts = evaluations.history.evaluations, len(state.get("bests", []))
    return round(max(AGREE * done / restarts - done, done / restarts)) if restarts else None


def _reason_to_end(evaluations: Evaluations, at: SearchState, floor: Callable[[Poses], float] | None) -> str:
    """Return why the search ends after a restart; empty where it does not."""
    best = evaluations.best
    if best is None:
        return ""
    if _at_floor(evaluations, at, floor):
        return "at the floor: points of this very shape, as many and as noisy, are no nearer"
    if sum(end <= (1 + ALIKE) * best.value for end in at.ends) >= AGREE:
        return f"converged: {AGREE} searches from different starts end within {ALIKE:.0%} of the best"
    if len(at.bests) >= IDLE and best.value > (1 - NO_GAIN) * at.bests[-IDLE][2]:
        return f"nothing gained: {IDLE} rounds of restarts came no nearer by {NO_GAIN:.1%}"
    return ""


def _at_floor(evaluations: Evaluations, at: SearchState, floor: Callable[[Poses], float] | None) -> bool:
    """Return whether the nearest of the searches under way is as near as its own points would be."""
    if floor is None:
        return False
    nearest = min(at.searches, key=lambda s: s.value)
    if nearest.shape is None:  # after a checkpoint
        [(_, nearest.shape)] = evaluations.evaluate(at.stage, [(nearest.start, nearest.x)])
    return nearest.value <= (1 + ALIKE) * floor(nearest.shape)


def _run_restart(evaluations: Evaluations, at: SearchState, floor: Callable[[Poses], float] | None) -> None:
    """Run a restart from where it stands through all stages; no round follows one that has come to the floor on the
    last."""
    for number in range(at.stage, len(evaluations.stages)):
        if number > at.stage or not at.searches:
            at.searches = _enter(evaluations, number, at.searches or screened(evaluations, at.first))
            at.stage = number
            save_state(evaluations, at)
        while (going := [s for s in at.searches if not s.done]) and evaluations.may_begin(number):
            before = min(s.value for s in at.searches)
            _round(evaluations, number, going)
            save_state(evaluations, at)
            gained = min(s.value for s in at.searches) < before
            if gained and number == len(evaluations.stages) - 1 and _at_floor(evaluations, at, floor):
                return


def _begin(evaluations: Evaluations, at: SearchState, further: FurtherStarts | None) -> bool:
    """Return the next restart, if it has starts."""
    best = evaluations.best
    if further is None or best is None:
        return False
    at.bests.append(best.as_row())
    at.stage, at.searches = 0, []
    evaluations.restart_began = evaluations.elapsed
    add_starts(evaluations, at, further)
    return len(evaluations.starts) > at.first


def searches_from(evaluations: Evaluations, number: int, first: int) -> list[LocalSearch]:
    """Return a search from every start from number `first` on, valued on the model of a stage."""
    numbers = range(first, len(evaluations.starts))
    spaces = [evaluations.space(i, number) for i in numbers]
    xs = [mine.encode(*space.decode(x)) for mine, (space, x) in zip(spaces, evaluations.starts[first:], strict=True)]
    values = evaluations.evaluate(number, list(zip(numbers, xs, strict=True)))
    return [
        LocalSearch(i, space, x, value, shape=shape)
        for i, space, x, (value, shape) in zip(numbers, spaces, xs, values, strict=True)
    ]


def screened(evaluations: Evaluations, first: int) -> list[LocalSearch]:
    """Return the searches from start number `first` on. Of several poses there is one from each layout, whose poses
    take the pressures that come nearest to their targets, of all that were valued on that layout: a pose's shape
    depends on its own pressures alone."""
    searches, objective = searches_from(evaluations, 0, first), evaluations.objective_of(0)
    if len(objective.targets) == 1:
        return searches
    layouts: dict[tuple[Muscle, ...], list[LocalSearch]] = {}
    for local in searches:
        layouts.setdefault(local.space.decode(local.x)[0].muscles, []).append(local)
    return [_with_nearest(objective, alike) for alike in layouts.values()]


def _with_nearest(objective: Objective, alike: Sequence[LocalSearch]) -> LocalSearch:
    """Return the best of searches from one layout, with the nearest poses of all of them where that is a gain."""
    best = min(alike, key=lambda s: s.value)
    kept = [(s.shape, s) for s in alike if s.shape is not None and s.space.keeps(s.x, s.shape)]
    if not kept or not best.space.vary_pressures:
        return best
    shapes = [shape for shape, _ in kept]
    pressures_of = [s.space.decode(s.x)[1] for _, s in kept]
    places = objective.nearest(shapes)
    design, _ = best.space.decode(best.x)
    pressures = np.array([pressures_of[k][pose] for k, pose in places])
    shape = np.array([shapes[k][pose] for k, pose in places])
    value = objective.value(shape)
    if not value < best.value:
        return best
    return replace(best, x=best.space.encode(design, pressures), value=value, shape=shape)


def _moved(evaluations: Evaluations, number: int, searches: Sequence[LocalSearch]) -> list[LocalSearch]:
    """Return searches that go on from where they stand on the model of a stage, but for those that diverge there."""
    spaces = [evaluations.space(s.start, number) for s in searches]
    xs = [space.encode(*s.space.decode(s.x)) for space, s in zip(spaces, searches, strict=True)]
    values = evaluations.evaluate(number, [(s.start, x) for s, x in zip(searches, xs, strict=True)])
    return [
        local.enter(space, x, value, shape)
        for local, space, x, (value, shape) in zip(searches, spaces, xs, values, strict=True)
        if np.all(np.isfinite(shape))
    ]


def _enter(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> list[LocalSearch]:
    """Return the best go on in the stage's space, valued by its forward model.

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
    moved = _moved(evaluations, number, kept)
    if not moved:
        raise Stop("every design diverged")
    for local in moved:
        local.done = stage.rounds == 0
    return moved


def _round(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> None:
    _find_slopes(evaluations, number, [s for s in searches if s.model is None])
    trials, wanted = [], []
    stage, known = evaluations.stages[number], evaluations.jacobians(number) is not None
    objective = evaluations.objective_of(number)
    many = AT_ONCE // len(searches) if known else 0
    for local in searches:
        evaluations.require_time()
        xs = local.trials(objective, many, even_targets=evaluations.even_targets)
        trials.append(xs)
        ahead = xs and local.rounds < stage.rounds - 1 and not known and stage.slopes is None
        wanted.append((local, xs + (local.differences(xs[0]) if ahead else [])))
    for local, xs, values in zip(searches, trials, _evaluate_all(evaluations, number, wanted), strict=True):
        local.accept(objective, xs, values[: len(xs)], [shape for _, shape in values[len(xs) :]])
        local.done = local.done or local.rounds >= stage.rounds


def run_rounds(
    evaluations: Evaluations, number: int, searches: Sequence[LocalSearch], rounds: int, *, until: float = 0.0
) -> list[LocalSearch]:
    """Return searches that go on from where they stand on the model of a stage, side by side, for up to so many rounds
    each or until they come to `until` m. What diverges there is left out."""
    moved = _moved(evaluations, number, searches)
    for _ in range(rounds):
        if not (going := [s for s in moved if not s.done and s.value > until]):
            break
        _round(evaluations, number, going)
    return moved


def _find_slopes(evaluations: Evaluations, number: int, searches: list[LocalSearch]) -> None:
    bare = [(s, [s.x]) for s in searches if s.shape is None]
    for (local, _), [(_, shape)] in zip(bare, _evaluate_all(evaluations, number, bare), strict=True):
        local.shape = shape
    if evaluations.jacobians(number) is not None:
        slopes = evaluations.slopes(number, [(s.start, s.x) for s in searches])
        for local, slope in zip(searches, slopes, strict=True):
            assert local.shape is not None
            local.model = LinearShape(local.x, local.shape, slope.by_variable)
    else:
        cheap = evaluations.stages[number].slopes
        wanted = [(s, s.lacks(known=cheap is None)) for s in searches]
        for local, values in zip(searches, _evaluate_all(evaluations, number, wanted, cheap), strict=True):
            local.linearise([shape for _, shape in values])
    taught = [(s, s.learned) for s in searches if s.learned]  # after a checkpoint
    for (local, _), values in zip(taught, _evaluate_all(evaluations, number, taught), strict=True):
        local.learn([shape for _, shape in values])


def _evaluate_all(
    evaluations: Evaluations, number: int, wanted: Sequence[Questions], cheap: ForwardModel | None = None
) -> list[list[tuple[float, Poses]]]:
    """Return what each search wants evaluated, all in common batches; on the stage's model, or on `cheap`."""
    results = iter(evaluations.evaluate(number, [(local.start, x) for local, xs in wanted for x in xs], cheap))
    return [[next(results) for _ in xs] for _, xs in wanted]

"""The search for what is missing: refit, rank, fit the best in full, add it, and look at what it leaves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fabdesign.forward import ForwardModel
from studies.tracing.black_box import ceiling_squares
from studies.tracing.data import folds_of
from studies.tracing.dictionary import Dictionary, dictionary, entries_of
from studies.tracing.fit import LITTLE, Bench, State, descend, loss
from studies.tracing.full_fit import Finalist, Ranked, Say, Task, finalist_of, fitted, in_full, without
from studies.tracing.grid import Grid, on_grid
from studies.tracing.ranking import (
    ALIKE,
    Candidate,
    Grams,
    Ranking,
    Scored,
    alike,
    cross_validate,
    excess_of,
    excess_over,
    gain_interval,
    grams_of,
    rank,
    stand_ins,
)
from studies.tracing.stages import Stages
from studies.tracing.together import all_at_once
from studies.tracing.vector import Added, Array, Vector
from studies.tracing.verdict import GROSS

FINALISTS = 2  # that are fitted in full
CLOSE = 0.25  # of the excess: a third one is, where it gains that much less than the first at most
MOST = 3  # effects added
STRONG = 0.5  # of the excess, that a candidate must take to be fitted by itself before all are at once
WORTH = 0.15  # of an excess, that a further effect must take
CLOSES = 0.75  # of the excess of the very trials fitted, that effects fitted together must close, for no null is drawn
_ITERATIONS, _EARLY = 20, 2


@dataclass(frozen=True, eq=False)
class Round:
    """A state, the candidates ranked there, the best fitted in full, and the one that was added."""

    state: State
    grams: Grams
    ranking: Ranking
    box: float  # m of excess that the black box leaves of held-out trials
    box_interval90: tuple[float, float]  # of its gain over the residual of all trials fitted
    finalists: tuple[Finalist, ...]
    chosen: Finalist | None
    indistinguishable: tuple[str, ...]  # from what was chosen
    stand_ins: tuple[str, ...]  # that would do as well as one of the state's effects, to first order


@dataclass(frozen=True, eq=False)
class Search:
    bench: Bench
    folds: list[int]
    floor: float  # m RMS of the noise in the residuals, and of the grid's error
    grid: Grid
    rounds: tuple[Round, ...]  # the last one added nothing

    @property
    def before(self) -> State:
        return self.rounds[0].state

    @property
    def after(self) -> State:
        return self.rounds[-1].state


def search(
    bench: Bench,
    stages: Stages,
    noise: float,
    *,
    tolerance: float,
    finer: ForwardModel | None = None,
    start: Array | None = None,
    types: list[str],
    channels: int,
    known: Sequence[str] = (),
    seed: int = 0,
    say: Say = lambda line: None,
) -> Search:
    """From the declared parameters refitted to up to MOST effects, one at a time. noise: m RMS, of the sensor. finer:
    the grid that takes over where `bench`'s own is too coarse. known: effects that the forward model has already."""
    vector = Vector()
    x = vector.centre() if start is None else start

    def told(line: str) -> None:
        say(f"declared parameters: {line}")

    fit = partial(descend, bench, vector, x, iterations=_ITERATIONS, early=_EARLY, progress=told)
    state = fitted(bench, stages, "refit", vector, fit)
    again = partial(descend, iterations=_ITERATIONS, progress=told)
    bench, state, grid = on_grid(bench, stages, state, finer, tolerance=tolerance, refit=again, say=say)
    task = Task(bench, stages, folds_of(bench.samples), grid.floor(noise), types, channels, known, say)
    rounds: list[Round] = []
    while True:
        done = _round(task, state, tuple(rounds), tolerance, seed)
        rounds.append(done)
        if done.chosen is None or len(rounds) > MOST:
            return Search(bench, task.folds, task.floor, grid, tuple(rounds))
        state = done.chosen.state


def _round(
    task: Task, state: State, before: tuple[Round, ...], tolerance: float, seed: int, together: State | None = None
) -> Round:
    """together: the fit with all effects at once, where the round is done again from a better state without any."""
    number, again = len(before), "" if together is None else "_again"
    task.say(f"round {number + 1}: {1e3 * state.rms:.3f} mm RMS without a further effect")
    found = _dictionary(task, state, f"{number}{again}") if _asked(task, state, before, tolerance) else _nothing(state)
    grams = grams_of(task.bench, state, found.columns, task.folds)
    task.say(f"round {number + 1}: ranking {len(found.effects)} candidates")
    ranking = rank(grams, found, task.floor, seed=seed)
    box = _scored_by_trial(grams, ceiling_squares(task.bench, state, task.folds))
    interval = gain_interval(grams, _as_it_is(grams), box, task.floor, np.random.default_rng(seed))
    same = tuple(dict.fromkeys(e for part in state.vector.parts() for e in stand_ins(grams, part, found.variants)))
    nothing = Round(state, grams, ranking, excess_of(grams, box, task.floor), interval, (), None, (), same)
    if ranking.excess <= tolerance or number >= MOST:
        return nothing
    at = Ranked(number, f"{number}{again}", state, grams, ranking)
    certain = [c for c in ranking.candidates if ranking.certain(c)]
    worth = [c for c in certain if c.gain > WORTH * ranking.excess]
    to_fit = _to_fit(grams, worth, ranking.excess)
    first = [c for c in to_fit if number > 0 or c.gain > STRONG * ranking.excess]
    finalists = [in_full(task, at, c, k) for k, c in enumerate(first)]
    left = min(in_sample_excess(task, s) for s in (state, *(f.state for f in finalists)))
    if number == 0 and left > tolerance:
        enough = min(max((1 - CLOSES) * left, GROSS * tolerance), 0.5 * left)
        if together is None:
            together = all_at_once(task, at, float(np.hypot(enough, task.floor)))
            plain = without(task, at, together)
            if loss(task.bench, state) - loss(task.bench, plain) > LITTLE:  # the refit had stopped short
                return _round(task, plain, before, tolerance, seed, together)
        if together.vector.added and in_sample_excess(task, together) < enough:
            finalists = [finalist_of(task, at, together, together=True)]
        elif not finalists:
            finalists = [in_full(task, at, c, k) for k, c in enumerate(to_fit)]
    finalists.sort(key=lambda f: f.held_out)
    if not finalists or finalists[0].gain <= WORTH * ranking.excess or finalists[0].interval90[0] <= 0:
        return replace(nothing, finalists=tuple(finalists))
    best = finalists[0]
    names = () if best.together else _indistinguishable(grams, ranking, best, finalists, task.floor, seed)
    return replace(nothing, finalists=tuple(finalists), chosen=best, indistinguishable=names)


def _asked(task: Task, state: State, before: Sequence[Round], tolerance: float) -> bool:
    """Whether the dictionary is: always at first; later for what is left, and for what several effects that were found
    together cannot be told from."""
    last = before[-1].chosen if before else None
    if last is None or last.together:
        return True
    grams = grams_of(task.bench, state, _nothing(state).columns, task.folds)
    return excess_of(grams, cross_validate(grams, None), task.floor) > tolerance


def _nothing(state: State) -> Dictionary:
    return Dictionary((), (), np.zeros((len(state.found.residual), 0)))


def in_sample_excess(task: Task, state: State) -> float:
    """m, over the noise, of the trials that were fitted."""
    return float(excess_over(state.mean_square, task.floor))


def _to_fit(grams: Grams, worth: Sequence[Candidate], excess: float) -> list[Candidate]:
    """The best that are not the same answer to first order: two, and a third where it comes close."""
    chosen: list[Candidate] = []
    for candidate in worth:
        same = chosen and max(map(abs, alike(grams, candidate.best, [c.best for c in chosen]))) > ALIKE
        close = not chosen or chosen[0].gain - candidate.gain < CLOSE * excess
        if not same and (len(chosen) < FINALISTS or (len(chosen) == FINALISTS and close)):
            chosen.append(candidate)
    return chosen


def _indistinguishable(
    grams: Grams, ranking: Ranking, best: Finalist, finalists: Sequence[Finalist], floor: float, seed: int
) -> tuple[str, ...]:
    """Candidates, certain or fitted in full, that take the same as the best, or from which it is not better for
    certain."""
    rng = np.random.default_rng(seed)
    full = {f.name: f.scored for f in finalists}
    own = next(c for c in ranking.candidates if c.effect == best.name)
    others = [c for c in ranking.candidates if c is not own and (ranking.certain(c) or c.effect in full)]
    cosines = alike(grams, own.best, [c.best for c in others])
    names = []
    for candidate, cosine in zip(others, cosines, strict=True):
        rival, mine = (full[candidate.effect], best.scored) if candidate.effect in full else (candidate.best, own.best)
        close = gain_interval(grams, rival, mine, floor, rng)[0] <= 0
        if (cosine > ALIKE and ranking.certain(candidate)) or close:
            names.append(candidate.effect)
    return tuple(names)


def _dictionary(task: Task, state: State, label: str) -> Dictionary:
    kept: list[Dictionary] = []

    def compute() -> dict[str, Array]:
        kept.append(dictionary(task.bench, state, types=task.types, channels=task.channels, known=task.known))
        return {"columns": kept[0].columns.astype(np.float32)}

    columns = task.stages.of(f"dictionary_{label}", compute)["columns"].astype(float)
    if kept:
        return replace(kept[0], columns=columns)
    entries, variants = entries_of(task.channels, [*task.known, *(added.name for added in state.vector.added)])
    if columns.shape[1] > len(entries):
        decoys = [replace(v, columns=tuple(len(entries) + c for c in v.columns), decoy=True) for v in variants]
        variants = (*variants, *decoys)
    return Dictionary(entries, variants, columns)


def _scored_by_trial(grams: Grams, squares: Array) -> Scored:
    """Sums by trial, given to a trial's first unit."""
    own = np.zeros(len(grams.points))
    for k, trial in enumerate(grams.trial):
        if k == 0 or grams.trial[k - 1] != trial:
            own[k] = squares[trial]
    return Scored(None, own, np.zeros(0))


def _as_it_is(grams: Grams) -> Scored:
    """The residual itself, fitted to all trials: what the black box takes from."""
    return Scored(None, grams.gram[:, -1, -1], np.zeros(0))


def added_effects(state: State) -> list[tuple[Added, slice]]:
    """The effects of a state, and where their parameters are."""
    return list(zip(state.vector.added, state.vector.parts(), strict=True))

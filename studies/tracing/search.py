"""The search for what is missing: refit, rank, fit the best in full, add it, and look at what it leaves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fabdesign.forward import ForwardModel
from studies.tracing.black_box import ceiling_squares
from studies.tracing.data import folds_of
from studies.tracing.descent import descend
from studies.tracing.dictionary import Dictionary, dictionary, entries_of
from studies.tracing.finalists import WORTH, Better, Tried, finalists_of
from studies.tracing.fit import Bench, State
from studies.tracing.full_fit import Finalist, Ranked, Say, Task, fitted
from studies.tracing.grid import Grid, on_grid
from studies.tracing.ranking import (
    ALIKE,
    Grams,
    Ranking,
    Scored,
    alike,
    cross_validate,
    excess_of,
    gain_interval,
    grams_of,
    rank,
    stand_ins,
)
from studies.tracing.stages import Stages
from studies.tracing.vector import Added, Array, Vector

MOST = 3  # effects added
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
        done = _round(task, state, tuple(rounds), tolerance, seed, Tried())
        rounds.append(done)
        if done.chosen is None or len(rounds) > MOST:
            return Search(bench, task.folds, task.floor, grid, tuple(rounds))
        state = done.chosen.state


def _round(task: Task, state: State, before: tuple[Round, ...], tolerance: float, seed: int, tried: Tried) -> Round:
    number = len(before)
    task.say(f"round {number + 1}: {1e3 * state.rms:.3f} mm RMS without a further effect")
    label = f"{number}{tried.label}"
    found = _dictionary(task, state, label) if _asked(task, state, before, tolerance) else _nothing(state)
    grams = grams_of(task.bench, state, found.columns, task.folds)
    task.say(f"round {number + 1}: ranking {len(found.effects)} candidates")
    ranking = rank(grams, found, task.floor, seed=seed)
    box = _scored_by_trial(grams, ceiling_squares(task.bench, state, task.folds))
    interval = gain_interval(grams, _as_it_is(grams), box, task.floor, np.random.default_rng(seed))
    same = tuple(dict.fromkeys(e for part in state.vector.parts() for e in stand_ins(grams, part, found.variants)))
    nothing = Round(state, grams, ranking, excess_of(grams, box, task.floor), interval, (), None, (), same)
    if ranking.excess <= tolerance or number >= MOST:
        return nothing
    at = Ranked(number, label, state, grams, ranking)
    explaining = finalists_of(task, at, tolerance, tried)
    if isinstance(explaining, Better):  # the refit had stopped short
        return _round(task, explaining.state, before, tolerance, seed, explaining.tried)
    finalists = sorted(explaining, key=lambda f: f.held_out)
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

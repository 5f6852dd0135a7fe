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
from studies.tracing.full_fit import FAR, Finalist, Ranked, Say, Task, finalist_of, fitted, in_full, without
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
from studies.tracing.second_look import beyond_first_order
from studies.tracing.stages import Stages
from studies.tracing.together import all_at_once
from studies.tracing.vector import FACTORS, Added, Array, Vector
from studies.tracing.verdict import GROSS

FINALISTS = 2  # that are fitted in full
CLOSE = 0.25  # of the excess: a third one is, where it gains that much less than the first at most
MOST = 3  # effects added
STRONG = 0.5  # of the excess, that a candidate must take to be fitted by itself before all are at once
WORTH = 0.15  # of an excess, that a further effect must take
CLOSES = 0.5  # of the excess of the very trials fitted, that an effect must close whose gain no null was drawn for
LEFT = 0.25  # of what single ones leave, that all at once may leave at most, where it is much
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


@dataclass(frozen=True, eq=False)
class _Tried:
    """What the first round has fitted beyond its ranking, where it is done again from a better state without any."""

    second_look: tuple[Finalist, ...] | None = None
    together: State | None = None

    @property
    def label(self) -> str:
        return "_again" * ((self.second_look is not None) + (self.together is not None))


def _round(
    task: Task, state: State, before: tuple[Round, ...], tolerance: float, seed: int, tried: _Tried = _Tried()
) -> Round:
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
    found_in_full = _in_full(task, at, tolerance, tried)
    if isinstance(found_in_full, _Better):  # the refit had stopped short
        return _round(task, found_in_full.state, before, tolerance, seed, found_in_full.tried)
    finalists = sorted(found_in_full, key=lambda f: f.held_out)
    if not finalists or finalists[0].gain <= WORTH * ranking.excess or finalists[0].interval90[0] <= 0:
        return replace(nothing, finalists=tuple(finalists))
    best = finalists[0]
    names = () if best.together else _indistinguishable(grams, ranking, best, finalists, task.floor, seed)
    return replace(nothing, finalists=tuple(finalists), chosen=best, indistinguishable=names)


@dataclass(frozen=True, eq=False)
class _Better:
    """A state of the round's own model that leaves less than the round's."""

    state: State
    tried: _Tried


def _in_full(task: Task, at: Ranked, tolerance: float, tried: _Tried) -> list[Finalist] | _Better:
    """What explains a round's residuals, fitted in full: the best of the ranking; at first, where these leave more than
    the tolerance of the very trials fitted, what a second look finds; where that leaves much, all effects at once."""
    ranking, state = at.ranking, at.state
    worth = [c for c in ranking.candidates if ranking.certain(c) and c.gain > WORTH * ranking.excess]
    to_fit = _to_fit(at.grams, worth, ranking.excess)
    if at.number > 0:
        return [in_full(task, at, c, k) for k, c in enumerate(to_fit)]
    strong = [c for c in to_fit if c.gain > STRONG * ranking.excess]
    finalists = [in_full(task, at, c, k) for k, c in enumerate(strong)]
    excess = in_sample_excess(task, state)

    def closing(some: Sequence[Finalist]) -> list[Finalist]:
        return [f for f in some if in_sample_excess(task, f.state) < (1 - CLOSES) * excess]

    astray = not worth or bool(np.abs(state.x[:FACTORS]).max() >= FAR)
    if tried.second_look is None and astray and excess > tolerance and not closing(finalists):
        looked = tuple(beyond_first_order(task, at))
        tried = replace(tried, second_look=looked)
        if looked:
            plain = without(task, at, min(looked, key=lambda f: f.held_out).state, "without")
            if loss(task.bench, state) - loss(task.bench, plain) > LITTLE:
                return _Better(plain, tried)
    there = {f.effects for f in finalists}
    looked = tuple(finalist_of(task, at, f.state) for f in tried.second_look or () if f.effects not in there)
    finalists += closing(looked)
    left = min([excess, *(in_sample_excess(task, f.state) for f in finalists)])
    if left > GROSS * tolerance:
        enough = min(max(LEFT * left, GROSS * tolerance), (1 - CLOSES) * left)
        if tried.together is None:
            tried = replace(tried, together=all_at_once(task, at, float(np.hypot(enough, task.floor))))
            assert tried.together is not None
            plain = without(task, at, tried.together, "plain")
            if loss(task.bench, state) - loss(task.bench, plain) > LITTLE:
                return _Better(plain, tried)
        if tried.together.vector.added and in_sample_excess(task, tried.together) < enough:
            return [finalist_of(task, at, tried.together, together=True)]
    return finalists or [in_full(task, at, c, k) for k, c in enumerate(to_fit)]


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

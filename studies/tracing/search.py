"""The search for what is missing: refit, rank, fit the best in full, add it, and look at what it leaves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from studies.tracing.black_box import ceiling_squares
from studies.tracing.data import folds_of
from studies.tracing.dictionary import Dictionary, added_of, dictionary, entries_of, starts_of
from studies.tracing.fit import Bench, State, descend, loss, normal
from studies.tracing.ranking import (
    ALIKE,
    Candidate,
    Grams,
    Ranking,
    Scored,
    alike,
    cross_validate,
    excess_of,
    gain_interval,
    grams_of,
    held_out,
    rank,
)
from studies.tracing.stages import Stages
from studies.tracing.vector import Added, Array, Vector

FINALISTS = 2  # that are fitted in full
CLOSE = 0.25  # of the excess: a third one is, where it gains that much less than the first at most
MOST = 3  # effects added
WORTH = 0.15  # of an excess, that a further effect must take
FAR = 2.0  # prior standard deviations: a parameter farther off may stand for an effect that is not there
_ITERATIONS, _EARLY, _SHORT, _FINAL = 6, 2, 3, 9
_STARTS = 0.5, 1.0, 2.0  # times where the linear fit puts an effect's strengths
_FAR_STARTS = 1.0, 3.0, 9.0  # the same where declared parameters had taken its part

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Finalist:
    """A candidate fitted in full inside the simulator. gain and its interval, m of excess, are against the same start's
    fit without it."""

    effect: str
    state: State
    scored: Scored
    held_out: float
    gain: float
    interval90: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Round:
    """A state, the candidates ranked there, the best fitted in full, and the one that was added."""

    state: State
    grams: Grams
    ranking: Ranking
    box: float  # m of excess that the black box leaves of held-out trials
    box_interval90: tuple[float, float]  # of its gain
    finalists: tuple[Finalist, ...]
    chosen: Finalist | None
    indistinguishable: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Search:
    bench: Bench
    folds: list[int]
    floor: float  # m RMS of the noise in the residuals
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
    floor: float,
    *,
    tolerance: float,
    start: Array | None = None,
    types: list[str],
    channels: int,
    known: Sequence[str] = (),
    seed: int = 0,
    say: Say = lambda line: None,
) -> Search:
    """From the declared parameters refitted to up to MOST effects, one at a time. known: effects that the forward model
    has already."""
    folds = folds_of(bench.samples)
    vector = Vector()
    x = vector.centre() if start is None else start
    state = _fitted(
        bench, stages, "refit", vector,
        lambda: descend(
            bench, vector, x, iterations=_ITERATIONS, early=_EARLY,
            progress=lambda line: say(f"declared parameters: {line}"),
        ),
    )  # fmt: skip
    rounds: list[Round] = []
    while True:
        done = _round(bench, stages, state, folds, floor, tolerance, len(rounds), types, channels, known, seed, say)
        rounds.append(done)
        if done.chosen is None or len(rounds) > MOST:
            return Search(bench, folds, floor, tuple(rounds))
        state = done.chosen.state


def _round(
    bench: Bench,
    stages: Stages,
    state: State,
    folds: list[int],
    floor: float,
    tolerance: float,
    number: int,
    types: list[str],
    channels: int,
    known: Sequence[str],
    seed: int,
    say: Say,
) -> Round:
    say(f"round {number + 1}: differences of the dictionary at {1e3 * state.rms:.3f} mm RMS")
    found = _dictionary(bench, stages, state, number, types, channels, known)
    grams = grams_of(bench, state, found.columns, folds)
    say(f"round {number + 1}: ranking {len(found.effects)} candidates")
    ranking = rank(grams, found, floor, seed=seed)
    squares = ceiling_squares(bench, state, folds)
    box = _scored_by_trial(grams, squares)
    interval = gain_interval(grams, ranking.none, box, floor, np.random.default_rng(seed))
    nothing = Round(state, grams, ranking, excess_of(grams, box, floor), interval, (), None, ())
    certain = [c for c in ranking.candidates if ranking.certain(c)]
    worth = [c for c in certain if c.gain > WORTH * ranking.excess]
    if ranking.excess <= tolerance or not worth or number >= MOST:
        return nothing
    finalists = []
    for k, candidate in enumerate(_to_fit(grams, worth, ranking.excess)):
        finalists.append(
            _in_full(bench, stages, state, folds, floor, candidate, f"{number}_{k}", types, grams, ranking, say)
        )
    finalists.sort(key=lambda f: f.held_out)
    best = finalists[0]
    if best.gain <= WORTH * ranking.excess or best.interval90[0] <= 0:
        return replace(nothing, finalists=tuple(finalists))
    names = _indistinguishable(grams, ranking, best, finalists, floor, seed)
    return replace(nothing, finalists=tuple(finalists), chosen=best, indistinguishable=names)


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
    """Certain candidates that take the same as the best, or from which it is not better for certain."""
    rng = np.random.default_rng(seed)
    own = next(c for c in ranking.candidates if c.effect == best.effect)
    others = [c for c in ranking.candidates if c.effect != best.effect and ranking.certain(c)]
    cosines = alike(grams, own.best, [c.best for c in others])
    full = {f.effect: f.scored for f in finalists}
    names = []
    for candidate, cosine in zip(others, cosines, strict=True):
        rival, mine = (full[candidate.effect], best.scored) if candidate.effect in full else (candidate.best, own.best)
        close = gain_interval(grams, rival, mine, floor, rng)[0] <= 0
        if cosine > ALIKE or close:
            names.append(candidate.effect)
    return tuple(names)


def _dictionary(
    bench: Bench, stages: Stages, state: State, number: int, types: list[str], channels: int, known: Sequence[str]
) -> Dictionary:
    kept: list[Dictionary] = []

    def compute() -> dict[str, Array]:
        kept.append(dictionary(bench, state, types=types, channels=channels, known=known))
        return {"columns": kept[0].columns.astype(np.float32)}

    columns = stages.of(f"dictionary_{number}", compute)["columns"].astype(float)
    if kept:
        return replace(kept[0], columns=columns)
    entries, variants = entries_of(channels, [*known, *(added.name for added in state.vector.added)])
    if columns.shape[1] > len(entries):
        decoys = [replace(v, columns=tuple(len(entries) + c for c in v.columns), decoy=True) for v in variants]
        variants = (*variants, *decoys)
    return Dictionary(entries, variants, columns)


def _in_full(
    bench: Bench,
    stages: Stages,
    state: State,
    folds: list[int],
    floor: float,
    candidate: Candidate,
    stage: str,
    types: list[str],
    grams: Grams,
    ranking: Ranking,
    say: Say,
) -> Finalist:
    assert candidate.best.variant is not None
    added, begin = added_of(candidate.best.variant, candidate.best.coefficients.tolist(), types)
    vector = state.vector.with_effect(added)

    def compute() -> State:
        def fit(base: Array, iterations: int, lengths: Sequence[float] = _STARTS) -> State:
            start = _best_start(bench, state, base, vector, starts_of(added, begin, lengths))
            return descend(
                bench, vector, start.x, iterations=iterations, slopes=start.jacobian,
                progress=lambda line: say(f"{candidate.effect} inside the simulator: {line}"),
            )  # fmt: skip

        if np.abs(state.x).max() < FAR:
            return fit(state.x, _FINAL)
        near = np.where(np.abs(state.x) < FAR, state.x, 0.0)  # they may have gone there for want of the effect
        both = [fit(state.x, _SHORT), fit(near, _SHORT, _FAR_STARTS)]
        best = min(both, key=lambda found: loss(bench, found))
        return descend(
            bench, vector, best.x, iterations=_FINAL - _SHORT, slopes=best.jacobian,
            progress=lambda line: say(f"{candidate.effect} inside the simulator, on: {line}"),
        )  # fmt: skip

    fitted = _fitted(bench, stages, f"full_{stage}_{candidate.effect}", vector, compute)
    own = grams_of(bench, fitted, np.zeros((len(fitted.found.residual), 0)), folds)
    scored = cross_validate(own, None)
    rng = np.random.default_rng(0)
    return Finalist(
        candidate.effect,
        fitted,
        scored,
        held_out(own, scored),
        ranking.excess - excess_of(own, scored, floor),
        gain_interval(grams, ranking.none, scored, floor, rng),
    )


def _best_start(bench: Bench, state: State, base: Array, vector: Vector, starts: Sequence[Array]) -> State:
    """Of places of an effect's parameters beside `base`, the one that leaves least; with slopes. Where `base` is the
    state's own, once its parameters have moved to first order."""
    tried = bench.states(vector, [np.concatenate([base, start]) for start in starts])
    if base is not state.x:
        return bench.with_slopes(min(tried, key=lambda other: loss(bench, other)))
    assert state.jacobian is not None
    known = np.pad(state.jacobian, ((0, 0), (0, len(starts[0]))))
    count = len(state.x)

    def left(other: State) -> float:
        other = replace(other, jacobian=known)
        gradient, hessian = normal(bench, other)
        gradient, hessian = gradient[:count], hessian[:count, :count]
        step = np.linalg.solve(hessian, gradient)
        predicted = other.residual - other.slopes[:, :count] @ step
        return float(np.square(predicted[other.kept]).mean()) if other.kept.any() else np.inf

    best = min(tried, key=left)
    return bench.with_slopes(replace(best, jacobian=known), known=count)


def _fitted(bench: Bench, stages: Stages, stage: str, vector: Vector, compute: Callable[[], State]) -> State:
    """A fit, or the one that is kept, at its place."""
    fresh: list[State] = []

    def arrays() -> dict[str, Array]:
        fresh.append(compute())
        assert fresh[0].jacobian is not None
        return {"x": fresh[0].x, "jacobian": fresh[0].jacobian}

    kept = stages.of(stage, arrays)
    return fresh[0] if fresh else replace(bench.states(vector, [kept["x"]])[0], jacobian=kept["jacobian"])


def _scored_by_trial(grams: Grams, squares: Array) -> Scored:
    """Sums by trial, given to a trial's first unit."""
    own = np.zeros(len(grams.points))
    for k, trial in enumerate(grams.trial):
        if k == 0 or grams.trial[k - 1] != trial:
            own[k] = squares[trial]
    return Scored(None, own, np.zeros(0))


def added_effects(state: State) -> list[tuple[Added, slice]]:
    """The effects of a state, and where their parameters are."""
    return list(zip(state.vector.added, state.vector.parts(), strict=True))

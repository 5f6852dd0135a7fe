"""A candidate fitted in full inside the simulator, together with the declared parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from studies.tracing.descent import descend
from studies.tracing.dictionary import added_of, starts_of
from studies.tracing.fit import Bench, State, expected, loss, widened
from studies.tracing.ranking import (
    Candidate,
    Grams,
    Ranking,
    Scored,
    cross_validate,
    excess_of,
    gain_interval,
    grams_of,
    held_out,
)
from studies.tracing.stages import Stages
from studies.tracing.vector import Added, Array, Vector

FAR = 2.0  # prior standard deviations: a parameter farther off may stand for an effect that is not there
SHORT, FINAL = 3, 20  # iterations of a fit from one of several starts, and in all
STARTS = 0.5, 1.0, 2.0  # times where the linear fit puts an effect's strengths
FAR_STARTS = 1.0, 3.0, 9.0  # the same where declared parameters had taken its part

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """What does not change in a trace. floor: m RMS of the noise in the residuals, and of the grid's error.
    known: effects that the forward model has already."""

    bench: Bench
    stages: Stages
    folds: list[int]
    floor: float
    types: list[str]
    channels: int
    known: Sequence[str]
    say: Say


@dataclass(frozen=True, eq=False)
class Ranked:
    """A state that was fitted, and the candidates ranked there by differences."""

    number: int  # of the round
    label: str  # of its stages
    state: State
    grams: Grams
    ranking: Ranking


@dataclass(frozen=True, eq=False)
class Finalist:
    """A candidate fitted in full inside the simulator, or several together. gain and its interval, m of excess, are
    against the same start's fit without it."""

    effects: tuple[str, ...]  # added to the round's state
    state: State
    scored: Scored
    held_out: float
    gain: float
    interval90: tuple[float, float]
    together: bool = False  # found where all effects were fitted at once

    @property
    def name(self) -> str:
        return " + ".join(self.effects)


def in_full(task: Task, at: Ranked, candidate: Candidate, place: int) -> Finalist:
    """The candidate of this place in the ranking, from where the linear fit puts it."""
    x = at.state.x
    added, begin, vector = entering(task, at, candidate)

    def compute() -> State:
        if np.abs(x).max() < FAR:
            return fit_from(task, at, x, vector, starts_of(added, begin, STARTS), FINAL)
        near = np.where(np.abs(x) < FAR, x, 0.0)  # they may have gone there for want of the effect
        both = [
            fit_from(task, at, x, vector, starts_of(added, begin, STARTS), SHORT),
            fit_from(task, at, near, vector, starts_of(added, begin, FAR_STARTS), SHORT),
        ]
        return fit_on(task, candidate.effect, min(both, key=lambda found: loss(task.bench, found)))

    stage = f"full_{at.label}_{place}_{candidate.effect}"
    return finalist_of(task, at, fitted(task.bench, task.stages, stage, vector, compute))


def entering(task: Task, at: Ranked, candidate: Candidate) -> tuple[Added, Array, Vector]:
    """The candidate as it enters a fit, where its parameters start, and the vector with it."""
    assert candidate.best.variant is not None
    added, begin = added_of(candidate.best.variant, candidate.best.coefficients.tolist(), task.types)
    return added, begin, at.state.vector.with_effect(added)


def fit_from(task: Task, at: Ranked, base: Array, vector: Vector, starts: Sequence[Array], iterations: int) -> State:
    """From the best of the last effect's `starts`, the other parameters at `base`."""
    start = _best_start(task.bench, at.state, base, vector, starts)
    say = told(task, vector.added[-1].name)
    return descend(task.bench, vector, start.x, iterations=iterations, slopes=start.jacobian, progress=say)


def without(task: Task, at: Ranked, found: State, stage: str) -> State:
    """The round's own model fitted from where the fit with more effects came to, for a fair comparison: what an effect
    seems to explain may be a better minimum without it."""
    vector, bench = at.state.vector, task.bench
    fit = partial(descend, bench, vector, found.x[: vector.size], iterations=FINAL, progress=told(task, "without,"))
    return fitted(bench, task.stages, f"{stage}_{at.label}", vector, fit)


def fit_on(task: Task, effect: str, state: State) -> State:
    """The fit of a state, to its end."""
    return descend(
        task.bench,
        state.vector,
        state.x,
        iterations=FINAL - SHORT,
        slopes=state.jacobian,
        progress=told(task, f"{effect}, on"),
    )


def told(task: Task, effect: str) -> Callable[[str], None]:
    return lambda line: task.say(f"{effect} inside the simulator: {line}")


def finalist_of(task: Task, at: Ranked, found: State, *, together: bool = False) -> Finalist:
    own = grams_of(task.bench, found, np.zeros((len(found.found.residual), 0)), task.folds)
    scored = cross_validate(own, None)
    return Finalist(
        tuple(added.name for added in found.vector.added[len(at.state.vector.added) :]),
        found,
        scored,
        held_out(own, scored),
        at.ranking.excess - excess_of(own, scored, task.floor),
        gain_interval(at.grams, at.ranking.none, scored, task.floor, np.random.default_rng(0)),
        together,
    )


def _best_start(bench: Bench, state: State, base: Array, vector: Vector, starts: Sequence[Array]) -> State:
    """Of places of an effect's parameters beside `base`, the one that leaves least; with slopes. Where `base` is the
    state's own, once its parameters have moved to first order."""
    tried = bench.states(vector, [np.concatenate([base, start]) for start in starts])
    if base is not state.x:
        return bench.with_slopes(min(tried, key=lambda other: loss(bench, other)))
    best = min(tried, key=lambda other: expected(bench, state, other))
    return bench.with_slopes(widened(state, best), known=len(state.x))


def fitted(bench: Bench, stages: Stages, stage: str, vector: Vector, compute: Callable[[], State]) -> State:
    """A fit, or the one that is kept, at its place."""
    fresh: list[State] = []

    def arrays() -> dict[str, Array]:
        fresh.append(compute())
        assert fresh[0].jacobian is not None
        return {"x": fresh[0].x, "jacobian": fresh[0].jacobian}

    kept = stages.of(stage, arrays)
    return fresh[0] if fresh else replace(bench.states(vector, [kept["x"]])[0], jacobian=kept["jacobian"])

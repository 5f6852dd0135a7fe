"""Levenberg-Marquardt in a fit's unknowns, with the data sheet as prior and honest covariances."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fabdesign.forward import ForwardModel
from studies.calibration.clouds import Array, Match, Sample, cut, frames_of
from studies.calibration.normal import BLOCK, FAR, Normal, directions, loss, scatter, step_to_minimum
from studies.calibration.parameters import DECLARED, FitVector
from studies.calibration.state import Linearisation, Problem

_STEP = 0.03  # of a logarithm, in the first finite differences
_ITERATIONS = 10
_CONVERGED = 0.01  # of a logarithm
_CLOSE = 1.0  # standard deviation along a step as a whole: it is the last, and still taken, where it gains little
_LITTLE = 0.02  # of the residuals' RMS
_NEAR = 0.03  # of a logarithm: steps under it are left to the next horizon
_LENGTHS = (1.0, 2.0, 0.5)  # of a step, simulated at once while that is no dearer than one
_AT_ONCE = 16  # motions that take a machine of two cores no longer than one
_DEARER = 4.0  # times, a motion on 61 points a side than on 41
_DAMPING = 0.3  # Levenberg-Marquardt's, after a step that made it worse


Progress = Callable[[str, float], None]  # what is done, and about what share of it all


@dataclass(frozen=True, eq=False)
class Fit:
    """The minimum and what is known about it. Vectors and matrices are in the order of `vector`, of x."""

    vector: FitVector
    x: Array  # (p,)
    covariance: Array  # (p, p)
    information: Array  # (p, p) of the data alone, tempered
    sensitivity: Array  # (p, p) m^2: mean square change of the residuals, weighted by frame, is v^T sensitivity v
    scale: float  # m, robust standard deviation of the residuals
    before: float  # m, RMS of the residuals capped at 10 mm, at the data sheet
    after: float  # m, the same at the minimum
    by_trial: Array  # (samples,) m, and of each trial; NaN where its motion was lost from the start
    outlying: float  # share of frames that the model misses by far, or has lost
    lost: tuple[tuple[str, float], ...]  # trials whose motion diverged, and from when on [s] they were left out
    iterations: int
    converged: bool
    without_effects: "Fit | None" = None  # that it began from


def fit(
    samples: Sequence[Sample],
    forward: ForwardModel,
    *,
    slopes: ForwardModel | None = None,
    vector: FitVector = DECLARED,
    progress: Progress = lambda line, share: None,
) -> Fit:
    """Most probable unknowns given the samples. Each iteration simulates motions and a difference for each unknown.

    The horizon grows: the first half second alone, then the first second, and so on. Cloth that buckles late goes one
    way or another at factors a hair apart; what came before leads to factors near enough, and has fewer false minima.
    `slopes`, a cheaper engine, makes all differences, and the motions too until the last horizon. Differences are
    always made where the factors are: those of another place seem to converge percents off.
    `progress` is told what is done, and about what share.

    All points of a block of 0.5 s share the model's error, so their likelihood is tempered: raised to the power that
    makes its curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011), and at least so
    far that a block counts as MODES observations: an error of the model that all trials share scatters no scores. The
    covariance is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where
    nothing is left because every motion diverges.
    """
    weight = np.diag(1 / vector.prior**2)
    slopes = forward if slopes is None else slopes
    x, along, iterations = vector.start, np.diag(_STEP * vector.scale), 0
    *early, last = horizons(samples)
    costs = np.array([*early, last * (1 if slopes == forward else _DEARER)])
    *ends, _ = np.cumsum(costs) / costs.sum()
    for horizon, told in zip(early, parts(progress, *ends), strict=False):
        problem = Problem([cut(sample, horizon) for sample in samples], slopes, slopes, vector)
        evaluation = problem.evaluate([x])[0]
        state = problem.linearise(evaluation, problem.changes(evaluation, along))
        state, more, _ = _descend(problem, state, weight, f"to {horizon:g} s, ", told, near=True)
        _, normal = step_to_minimum(problem.samples, state, weight, 0.0, vector)
        x, along, iterations = state.x, directions(normal, vector), iterations + more
    problem = Problem(samples, forward, slopes, vector)
    evaluation, sheet = problem.evaluate([x, np.zeros(len(x))])
    state = problem.linearise(evaluation, problem.changes(evaluation, along))
    state, more, converged = _descend(problem, state, weight, f"to {last:g} s, ", parts(progress, *ends)[-1])
    _, normal = step_to_minimum(samples, state, weight, 0.0, vector)
    return Fit(
        vector=vector,
        x=state.x,
        covariance=_covariance(normal, weight),
        information=normal.information,
        sensitivity=normal.sensitivity,
        scale=normal.scale,
        before=_capped(sheet.found.residual),
        after=_capped(state.found.residual),
        by_trial=np.array([_capped(state.found.residual[state.found.sample == s]) for s in range(len(samples))]),
        outlying=_share_outlying(state.found),
        lost=_lost(samples, state.found),
        iterations=iterations + more,
        converged=converged,
    )


def parts(progress: Progress, *ends: float) -> list[Progress]:
    """Of work in parts one after another, what each tells its own share: `ends` are the shares of it all at which the
    parts but the last end."""

    def part(begin: float, end: float) -> Progress:
        return lambda line, share: progress(line, float(begin + share * (end - begin)))

    return [part(*pair) for pair in pairwise((0.0, *ends, 1.0))]


def horizons(samples: Sequence[Sample]) -> list[float]:
    """s after rest, one a descent: 0.5, 1.0 and so on, of which each holds frames that the one before does not."""
    blocks = {max(1, int(np.ceil(time / BLOCK - 1e-6))) for sample in samples for time in sample.times}
    return [BLOCK * k for k in sorted(blocks)]


def _descend(
    problem: Problem,
    state: Linearisation,
    weight: Array,
    named: str,
    progress: Progress,
    *,
    near: bool = False,
) -> tuple[Linearisation, int, bool]:
    """From `state` until a step is slight, or with `near` no longer large: where that led, how many iterations, and
    whether it converged."""
    slight = _NEAR if near else _CONVERGED
    lengths = (1.0,) if near else _LENGTHS[: max(1, _AT_ONCE // len(problem.samples))]
    damping, before = 0.0, np.zeros(len(state.x))
    for iteration in range(1, _ITERATIONS + 1):
        step, normal = step_to_minimum(problem.samples, state, weight, damping, problem.vector)
        line = f"{named}iteration {iteration}: {1e3 * _capped(state.found.residual):.3f} mm RMS"
        progress(line, iteration / (iteration + 2))
        covariance = _covariance(normal, weight)
        own = np.sqrt(np.diag(covariance))
        if (step / own) @ (before / own) < 0:  # it takes the last one back: noise of the differences, or a kink
            step = step / 2
        distance = np.sqrt(step @ np.linalg.solve(covariance, step))
        evaluations = problem.evaluate([problem.vector.inside(state.x + length * step) for length in lengths])
        worse = [loss(state, evaluation, normal, weight) for evaluation in evaluations]
        best = int(np.argmin(worse))
        before = evaluations[best].x - state.x
        gained = 1 - _capped(evaluations[best].found.residual) / _capped(state.found.residual)
        small = bool(
            (distance < _CLOSE and gained < _LITTLE) or np.abs(step / problem.vector.scale).max() < slight
        )  # for new differences to be worth it
        if worse[best] < 0:
            changes = state.changes if small else problem.changes(evaluations[best], directions(normal, problem.vector))
            state, damping = problem.linearise(evaluations[best], changes), damping / 10
        else:
            damping = max(10 * damping, _DAMPING)
        if small:
            return state, iteration, True
    return state, _ITERATIONS, False


def _covariance(normal: Normal, weight: Array) -> Array:
    """(p, p), the sandwich; of a likelihood whose observations are capped, its own curvature."""
    bread = np.linalg.inv(normal.information + weight)
    if normal.capped:
        return np.asarray(bread)
    meat = normal.tempering**2 * scatter(normal.scores, normal.information, weight) + weight
    return np.asarray(bread @ meat @ bread)


def _capped(residual: Array) -> float:
    """m, RMS of what is not lost."""
    kept = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(np.square(np.clip(kept, -0.010, 0.010))))) if len(kept) else float("nan")


def _share_outlying(found: Match) -> float:
    """Share of frames whose median residual is over FAR times the usual one, or lost."""
    size = np.where(np.isfinite(found.residual), np.abs(found.residual), np.inf)
    medians = np.array([np.median(size[points]) for points in frames_of(found)[1]])
    return float(np.mean(medians > FAR * np.median(medians)))


def _lost(samples: Sequence[Sample], found: Match) -> tuple[tuple[str, float], ...]:
    bad = np.isnan(found.residual)
    first = {int(s): float(samples[s].times[found.frame[bad & (found.sample == s)].min()]) for s in found.sample[bad]}
    return tuple((samples[s].trial.name, time) for s, time in sorted(first.items()))

"""Levenberg-Marquardt in the logarithms of the factors, with a data-sheet prior and honest covariances."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fabdesign.forward import PARAMETERS, ForwardModel
from studies.calibrate_branches import ASTRAY, better_branch, misfit, share_astray, thinned
from studies.calibrate_clouds import Array, Match, Sample, cut
from studies.calibrate_normal import BLOCK, PRIOR, Normal, directions, loss, scatter, step_to_minimum
from studies.calibrate_state import Look, State, motions_at

_STEP = 0.03  # of a logarithm, in the first finite differences
_ITERATIONS = 10
_CONVERGED = 0.01  # of a logarithm
_SLIGHT = 0.25  # of a factor's own standard deviation, a step under which is none: the interval is 3 % wider for it
_CLOSE = 1.0  # own standard deviation along the step as a whole: the last step, which is still taken
_NEAR = 0.03  # of a logarithm: steps under it are left to the next horizon
_LENGTHS = (1.0, 2.0, 0.5)  # of a step, simulated at once while that is no dearer than one
_AT_ONCE = 16  # motions that take a machine of two cores no longer than one
_DAMPING = 0.3  # Levenberg-Marquardt's, after a step that made it worse
_BRANCHES = 3  # other branches taken at most, fewer with more than four trials and none from seven on: for the time


@dataclass(frozen=True, eq=False)
class Fit:
    """The minimum and what is known about it. Vectors and matrices are in the order of PARAMETERS, logarithmic."""

    x: Array  # (7,) logarithms of the factors
    covariance: Array  # (7, 7)
    information: Array  # (7, 7) of the data alone, tempered
    sensitivity: Array  # (7, 7) m^2: mean square change of the residuals, weighted by frame, is v^T sensitivity v
    scale: float  # m, robust standard deviation of the residuals
    before: float  # m, RMS of the residuals capped at 10 mm, at the data sheet
    after: float  # m, the same at the minimum
    by_trial: Array  # (samples,) m, and of each trial; NaN where its motion was lost from the start
    astray: float  # share of frames that the model misses by far, or has lost
    lost: tuple[tuple[str, float], ...]  # trials whose motion diverged, and from when on [s] they were left out
    iterations: int
    converged: bool


def fit(
    samples: Sequence[Sample],
    forward: ForwardModel,
    *,
    slopes: ForwardModel | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> Fit:
    """Most probable factors given the samples. Each iteration simulates motions and seven differences.

    The horizon grows: the first half second alone, then the first second, and so on. Cloth that buckles late goes one
    way or another at factors a hair apart; what came before leads to factors near enough, and has fewer false minima.
    `slopes`, a cheaper engine, makes all differences, and the motions too until the last horizon. Differences are
    always made where the factors are: those of another place seem to converge percents off. Where frames are left that
    the model buckles another way, other branches are tried (studies/calibrate_branches.py).

    All points of a block of 0.5 s share the model's error, so their likelihood is tempered: raised to the power that
    makes its curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011). The covariance
    is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where nothing is
    left because every motion diverges.
    """
    weight = np.diag([1 / PRIOR[name] ** 2 for name in PARAMETERS])
    slopes = forward if slopes is None else slopes
    x, along, iterations = np.zeros(len(PARAMETERS)), _STEP * np.eye(len(PARAMETERS)), 0
    *early, last = horizons(samples)
    for horizon in early:
        look = Look([cut(sample, horizon) for sample in samples], slopes, slopes)
        begin = look.state(look.places([x])[0], along=along)
        state, more, _ = _descend(look, begin, weight, f"to {horizon:g} s, ", progress, near=True)
        _, normal = step_to_minimum(look.samples, state, weight, 0.0)
        x, along, iterations = state.x, directions(normal), iterations + more
    look = Look(samples, forward, slopes)
    place, sheet = look.places([x, np.zeros(len(PARAMETERS))])
    state, more, converged = _descend(look, look.state(place, along=along), weight, f"to {last:g} s, ", progress)
    iterations += more
    state, more, converged = _other_branches(look, state, weight, converged, progress)
    iterations += more
    _, normal = step_to_minimum(samples, state, weight, 0.0)
    return Fit(
        x=state.x,
        covariance=_covariance(normal, weight),
        information=normal.information,
        sensitivity=normal.sensitivity,
        scale=normal.scale,
        before=_capped(sheet.found.residual),
        after=_capped(state.found.residual),
        by_trial=np.array([_capped(state.found.residual[state.found.sample == s]) for s in range(len(samples))]),
        astray=share_astray(state.found),
        lost=_lost(samples, state.found),
        iterations=iterations,
        converged=converged,
    )


def horizons(samples: Sequence[Sample]) -> list[float]:
    """s after rest, one a descent: 0.5, 1.0 and so on, the last to hold every frame."""
    count = max(1, int(np.ceil(max(sample.times[-1] for sample in samples) / BLOCK - 1e-6)))
    return [BLOCK * (k + 1) for k in range(count)]


def _descend(
    look: Look,
    state: State,
    weight: Array,
    named: str,
    progress: Callable[[str], None],
    *,
    near: bool = False,
) -> tuple[State, int, bool]:
    """From `state` until a step is slight, or with `near` no longer large: where that led, how many iterations, and
    whether it converged."""
    close, slight = (_NEAR, 1.0) if near else (_CONVERGED, _SLIGHT)
    lengths = (1.0,) if near else _LENGTHS[: max(1, _AT_ONCE // len(look.samples))]
    damping, before = 0.0, np.zeros(len(state.x))
    for iteration in range(1, _ITERATIONS + 1):
        step, normal = step_to_minimum(look.samples, state, weight, damping)
        progress(f"{named}iteration {iteration}: {1e3 * _capped(state.found.residual):.3f} mm RMS")
        covariance = _covariance(normal, weight)
        own = np.sqrt(np.diag(covariance))
        if (step / own) @ (before / own) < 0:  # it takes the last one back: noise of the differences, or a kink
            step = step / 2
        # for new differences; it may still lead to another branch
        distance = np.sqrt(step @ np.linalg.solve(covariance, step))
        small = bool(distance < _CLOSE or (np.abs(step) < np.maximum(close, slight * own)).all())
        places = look.places([state.x + length * step for length in lengths])
        worse = [loss(state, place, normal, weight) for place in places]
        best = int(np.argmin(worse))
        before = places[best].x - state.x
        if worse[best] < 0:
            how = {"changes": state.changes} if small else {"along": directions(normal)}
            state, damping = look.state(places[best], **how), damping / 10
        else:
            damping = max(10 * damping, _DAMPING)
        if small:
            return state, iteration, True
    return state, _ITERATIONS, False


def _other_branches(
    look: Look, state: State, weight: Array, converged: bool, progress: Callable[[str], None]
) -> tuple[State, int, bool]:
    """From branch to branch while frames go astray and another one leaves less; how many iterations that took."""
    rng, iterations = np.random.default_rng(0), 0
    few = thinned(look.samples)
    for _ in range(min(_BRANCHES, max(0, 20 // len(few) - 2))):
        if share_astray(state.found) < ASTRAY:
            break
        _, normal = step_to_minimum(look.samples, state, weight, 0.0)
        spread = np.linalg.cholesky(np.linalg.inv(normal.information + weight))
        other = better_branch(few, partial(motions_at, few, look.forward), state.x, spread, rng)
        if other is None:
            break
        progress("another branch")
        start = look.state(look.places([other])[0], along=directions(normal))
        end, more, ended = _descend(look, start, weight, "", progress)
        iterations += more
        left = [misfit(s.found) for s in (state, start, end)]
        if min(left) == left[0]:
            break
        state, converged = (end, ended) if left[2] <= left[1] else (start, False)
    return state, iterations, converged


def _covariance(normal: Normal, weight: Array) -> Array:
    """(7, 7), the sandwich."""
    bread = np.linalg.inv(normal.information + weight)
    meat = normal.tempering**2 * scatter(normal.scores, normal.information, weight) + weight
    return np.asarray(bread @ meat @ bread)


def _capped(residual: Array) -> float:
    """m, RMS of what is not lost."""
    kept = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(np.square(np.clip(kept, -0.010, 0.010))))) if len(kept) else float("nan")


def _lost(samples: Sequence[Sample], found: Match) -> tuple[tuple[str, float], ...]:
    bad = np.isnan(found.residual)
    first = {int(s): float(samples[s].times[found.frame[bad & (found.sample == s)].min()]) for s in found.sample[bad]}
    return tuple((samples[s].trial.name, time) for s, time in sorted(first.items()))

"""Levenberg-Marquardt in the logarithms of the factors, with a data-sheet prior and honest covariances."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fabdesign.forward import PARAMETERS, ForwardModel
from studies.calibrate_branches import ASTRAY, better_branch, misfit, share_astray, thinned
from studies.calibrate_clouds import Array, Match, Sample
from studies.calibrate_normal import PRIOR, Normal, directions, loss, scatter, step_to_minimum
from studies.calibrate_state import State, correction_of, motions_at, state_at

_STEP = 0.03  # of a logarithm, in the first finite differences
_ITERATIONS = 10
_CONVERGED = 0.01  # of a logarithm
_SLIGHT = 0.25  # of a factor's own standard deviation, a step under which is none: the interval is 3 % wider for it
_NEAR = 0.05  # of a logarithm: steps under it are left to the fine engine
_FINE_ITERATIONS = 5
_DAMPING = 0.3  # Levenberg-Marquardt's, after a step that made it worse
_BRANCHES = 3  # other branches taken at most, fewer with more than four trials and none from seven on: for the time


@dataclass(frozen=True, eq=False)
class Fit:
    """The minimum and what is known about it. Vectors and matrices are in the order of PARAMETERS, logarithmic."""

    x: Array  # (7,) logarithms of the factors
    covariance: Array  # (7, 7)
    information: Array  # (7, 7) of the data alone, tempered
    sensitivity: Array  # (7, 7) m^2: mean square change of the residuals is v^T sensitivity v
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
    coarse: ForwardModel,
    fine: ForwardModel | None = None,
    *,
    slopes: ForwardModel | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> Fit:
    """Most probable factors given the samples. Each iteration simulates motions and seven differences.

    With `fine`, `coarse` makes the first iterations, its motions corrected by what both are apart at the data sheet.
    Cloth that buckles multiplies small differences, and that correction, true at the data sheet, is then centimetres
    off elsewhere; so the last iterations are by `fine` alone. Its differences may come from `slopes`, a cheaper engine,
    but always from where the factors are: those of another place seem to converge percents off. Where frames are left
    that the model buckles another way, other branches are tried (studies/calibrate_branches.py).

    All points of a block of 0.5 s share the model's error, so their likelihood is tempered: raised to the power that
    makes its curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011). The covariance
    is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where nothing is
    left because every motion diverges.
    """
    weight = np.diag([1 / PRIOR[name] ** 2 for name in PARAMETERS])
    start = np.zeros(len(PARAMETERS))
    correction = correction_of(samples, fine, coarse) if fine is not None else None
    look = partial(state_at, samples, coarse, correction=correction)
    state = look(start, along=_STEP * np.eye(len(start)))
    first = state.found
    near = _CONVERGED if fine is None else _NEAR
    state, iterations, converged = _descend(samples, state, look, weight, near, _ITERATIONS, progress)
    last = coarse if fine is None else fine
    if fine is not None:
        _, normal = step_to_minimum(samples, state, weight, 0.0)
        look = partial(state_at, samples, fine, slopes=slopes)
        state = look(state.x, along=directions(normal))
        state, more, converged = _descend(
            samples, state, look, weight, _CONVERGED, _FINE_ITERATIONS, lambda line: progress(f"fine {line}")
        )
        iterations += more
    state, more, converged = _other_branches(
        samples, last, state, partial(state_at, samples, last, slopes=slopes), weight, converged, progress
    )
    iterations += more
    _, normal = step_to_minimum(samples, state, weight, 0.0)
    return Fit(
        x=state.x,
        covariance=_covariance(normal, weight),
        information=normal.information,
        sensitivity=normal.sensitivity,
        scale=normal.scale,
        before=_capped(first.residual),
        after=_capped(state.found.residual),
        by_trial=np.array([_capped(state.found.residual[state.found.sample == s]) for s in range(len(samples))]),
        astray=share_astray(state.found),
        lost=_lost(samples, state.found),
        iterations=iterations,
        converged=converged,
    )


def _descend(
    samples: Sequence[Sample],
    state: State,
    look: Callable[..., State],
    weight: Array,
    close: float,
    most: int,
    progress: Callable[[str], None],
) -> tuple[State, int, bool]:
    """From `state` until a step is under `close` or slight, or `most` iterations: where that led, how many iterations,
    and whether it converged."""
    damping, before = 0.0, np.zeros(len(state.x))
    for iteration in range(1, most + 1):
        step, normal = step_to_minimum(samples, state, weight, damping)
        progress(f"iteration {iteration}: {1e3 * _capped(state.found.residual):.3f} mm RMS")
        own = np.sqrt(np.diag(_covariance(normal, weight)))
        if (step / own) @ (before / own) < 0:  # it takes the last one back: noise of the differences, or a kink
            step = step / 2
        before = step
        # for new differences; it may still lead to another branch
        small = bool((np.abs(step) < np.maximum(close, _SLIGHT * own)).all())
        how = {"changes": state.changes} if small else {"along": directions(normal)}
        candidate = look(state.x + step, **how)
        if loss(state, candidate, normal, weight) < 0:
            state, damping = candidate, damping / 10
        else:
            damping = max(10 * damping, _DAMPING)
        if small:
            return state, iteration, True
    return state, most, False


def _other_branches(
    samples: Sequence[Sample],
    forward: ForwardModel,
    state: State,
    look: Callable[..., State],
    weight: Array,
    converged: bool,
    progress: Callable[[str], None],
) -> tuple[State, int, bool]:
    """From branch to branch while frames go astray and another one leaves less; how many iterations that took."""
    rng, iterations = np.random.default_rng(0), 0
    few = thinned(samples)
    for _ in range(min(_BRANCHES, max(0, 20 // len(samples) - 2))):
        if share_astray(state.found) < ASTRAY:
            break
        _, normal = step_to_minimum(samples, state, weight, 0.0)
        spread = np.linalg.cholesky(np.linalg.inv(normal.information + weight))
        other = better_branch(few, partial(motions_at, few, forward), state.x, spread, rng)
        if other is None:
            break
        progress("another branch")
        start = look(other, along=directions(normal))
        end, more, ended = _descend(samples, start, look, weight, _CONVERGED, _FINE_ITERATIONS, progress)
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

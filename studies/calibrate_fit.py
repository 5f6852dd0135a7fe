"""Levenberg-Marquardt in the logarithms of the factors, with a data-sheet prior and honest covariances."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import SimulationError
from fabdesign.forward import PARAMETERS, Case, ForwardModel
from studies.calibrate_clouds import Array, Match, Motion, Sample, derivatives, match

# Standard deviations of the logarithms: data sheets are good to tens of percent, their damping to 30 %.
PRIOR = {name: 0.15 for name in PARAMETERS} | {"damping": 0.30}
HUBER = 1.345  # of the scale: 95 % efficient on normal noise (Huber 1981)
BLOCK = 0.5  # s: residuals of one trial within it count as one observation, about half a swing of the cloth
_STEP = 0.03  # of a logarithm, in finite differences
_LARGEST = 0.4  # of a logarithm, in one iteration
_JACOBIANS = 2  # at the data sheet and after the first step; later steps are too small to change them
_ITERATIONS = 6
_CONVERGED = 0.004  # of a logarithm
_DAMPING = (0.0, 0.3)  # Levenberg-Marquardt's, tried side by side; times 10 after a failure
_SMALLEST_SCALE = 1e-6  # m, for clouds without noise


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
    lost: tuple[tuple[str, float], ...]  # trials whose motion diverged, and from when on [s] they were left out
    motions: int  # simulated
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class _State:
    x: Array
    found: Match
    motions: list[Motion]


@dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations at a state."""

    gradient: Array  # (7,)
    hessian: Array  # (7, 7) of the data
    scores: Array  # (clusters, 7)
    tempering: float
    scale: float
    sensitivity: Array


def fit(
    samples: Sequence[Sample],
    fine: ForwardModel,
    coarse: ForwardModel,
    *,
    prior: Mapping[str, float] = PRIOR,
    progress: Callable[[str], None] = lambda line: None,
) -> Fit:
    """Most probable factors given the samples. `fine` gives the residuals, `coarse` their derivatives.

    All points of a block of 0.5 s share the model's error, so their likelihood is tempered: raised to the power that
    makes its curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011). The covariance
    is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where nothing is
    left because every motion diverges.
    """
    weight = np.diag([1 / prior[name] ** 2 for name in PARAMETERS])
    state = _states(samples, fine, [np.zeros(len(PARAMETERS))])[0]
    runs, first, converged, iteration = len(samples), state.found, False, 0
    changes: list[Motion] = []
    damping = 1.0
    for iteration in range(1, _ITERATIONS + 1):
        if iteration <= _JACOBIANS:
            changes = _changes(samples, coarse, state.x)
            runs += len(samples) * (1 + len(PARAMETERS))
        normal = _normal(samples, state.found, derivatives(state.found, changes), weight)
        steps = [_step(normal, weight, state.x, damping * d) for d in _DAMPING]
        candidates = _states(samples, fine, [state.x + step for step in steps])
        runs += len(steps) * len(samples)
        losses = [_loss(samples, state, other, normal, weight) for other in candidates]
        best = int(np.argmin(losses))
        progress(f"iteration {iteration}: {1e3 * _capped(state.found.residual):.3f} mm RMS")
        largest = float(np.abs(steps[best]).max())
        if losses[best] < 0:
            state = candidates[best]
            damping = max(damping / 3, 1e-2)
        else:
            damping *= 10
        if largest < _CONVERGED or (losses[best] >= 0 and largest < 5 * _CONVERGED):
            converged = True
            break
    normal = _normal(samples, state.found, derivatives(state.found, changes), weight)
    information = normal.tempering * normal.hessian
    bread = np.linalg.inv(information + weight)
    meat = normal.tempering**2 * _scatter(normal.scores, information, weight) + weight
    return Fit(
        x=state.x,
        covariance=bread @ meat @ bread,
        information=information,
        sensitivity=normal.sensitivity,
        scale=normal.scale,
        before=_capped(first.residual),
        after=_capped(state.found.residual),
        lost=_lost(samples, state.found),
        motions=runs,
        iterations=iteration,
        converged=converged,
    )


def _factors(x: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(PARAMETERS, np.exp(x), strict=True)}


def _states(samples: Sequence[Sample], forward: ForwardModel, xs: Sequence[Array]) -> list[_State]:
    motions = _motions(samples, forward, xs)
    return [_State(x, match(samples, found), found) for x, found in zip(xs, motions, strict=True)]


def _motions(samples: Sequence[Sample], forward: ForwardModel, xs: Sequence[Array]) -> list[list[Motion]]:
    """Of every x, a motion a sample; all in one batch."""
    cases = [Case(s.trial.design, s.trial.program, _factors(x)) for x in xs for s in samples]
    motions = forward.motions(cases, [s.times for _ in xs for s in samples])
    return [list(motions[k : k + len(samples)]) for k in range(0, len(motions), len(samples))]


def _changes(samples: Sequence[Sample], coarse: ForwardModel, x: Array) -> list[Motion]:
    """(7, F, 2 n, 3) m per unit logarithm, a sample: forward differences, all in one batch."""
    base, *moved = _motions(samples, coarse, [x, *(x + _STEP * e for e in np.eye(len(x)))])
    return [np.stack([(other[s] - base[s]) / _STEP for other in moved]) for s in range(len(samples))]


def _normal(samples: Sequence[Sample], found: Match, jacobian: Array, weight: Array) -> _Normal:
    sound = np.isfinite(found.residual) & np.isfinite(jacobian).all(axis=1)
    if not sound.any():
        raise SimulationError("every motion of the trials to fit diverged")
    r, j = found.residual[sound], jacobian[sound]
    scale = _scale(r)
    w = _weights(found, sound, scale) / scale**2
    cluster = _clusters(samples, found)[sound]
    _, cluster = np.unique(cluster, return_inverse=True)
    scores = np.zeros((cluster.max() + 1, len(weight)))
    np.add.at(scores, cluster, j * (w * r)[:, None])
    hessian = (j * w[:, None]).T @ j
    inverse = np.linalg.inv(hessian + weight)
    # weights above one would trust points more than their number allows
    tempering = min(1.0, float(np.trace(inverse @ hessian) / np.trace(inverse @ _scatter(scores, hessian, weight))))
    return _Normal(scores.sum(axis=0), hessian, scores, tempering, scale, j.T @ j / len(j))


def _scatter(scores: Array, information: Array, weight: Array) -> Array:
    """(7, 7) variance of the sum of the clusters' scores about their mean, for the parameters fitted."""
    fitted = float(np.trace(np.linalg.solve(information + weight, information)))
    centred = scores - scores.mean(axis=0)
    count = len(scores)
    return np.asarray(centred.T @ centred * count / max(count - fitted, 1.0))


def _scale(residual: Array) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), _SMALLEST_SCALE)


def _weights(found: Match, sound: NDArray[np.bool_], scale: float) -> Array:
    """Huber's, of points by their own residual and of frames by their median one: a cloth that the model buckles to
    the other side must not decide."""
    size = np.abs(found.residual[sound])
    _, frame = np.unique(found.sample[sound] * 100_000 + found.frame[sound], return_inverse=True)
    order = np.argsort(frame, kind="stable")
    medians = np.array([np.median(part) for part in np.split(size[order], np.flatnonzero(np.diff(frame[order])) + 1)])
    relative = medians / np.median(medians)
    frames = np.minimum(1.0, 2.0 / np.maximum(relative, 1e-9))
    return np.asarray(frames[frame] * np.minimum(1.0, HUBER * scale / np.maximum(size, 1e-12)))


def _clusters(samples: Sequence[Sample], found: Match) -> NDArray[np.intp]:
    """Trial and block of time of each point."""
    result = np.empty(len(found.sample), dtype=np.intp)
    for s, sample in enumerate(samples):
        rows = found.sample == s
        result[rows] = s * 10_000 + (sample.times[found.frame[rows]] / BLOCK - 1e-6).astype(int)
    return result


def _step(normal: _Normal, weight: Array, x: Array, damping: float) -> Array:
    information = normal.tempering * normal.hessian
    gradient = normal.tempering * normal.gradient + weight @ x
    step = -np.linalg.solve(information + weight + damping * np.diag(np.diag(information)), gradient)
    return np.asarray(step * min(1.0, _LARGEST / max(float(np.abs(step).max()), 1e-12)))


def _loss(samples: Sequence[Sample], old: _State, new: _State, normal: _Normal, weight: Array) -> float:
    """How much worse `new` is than `old`, over the points that both have; infinite where `new` loses over a tenth."""
    both = np.isfinite(old.found.residual) & np.isfinite(new.found.residual)
    if both.sum() < 0.9 * np.isfinite(old.found.residual).sum():
        return float("inf")
    w = _weights(old.found, both, normal.scale) / np.minimum(
        1.0, HUBER * normal.scale / np.maximum(np.abs(old.found.residual[both]), 1e-12)
    )  # of frames alone
    rho = [_huber(state.found.residual[both] / normal.scale) for state in (new, old)]
    data = normal.tempering * float((w * (rho[0] - rho[1])).sum())
    return data + 0.5 * float(new.x @ weight @ new.x - old.x @ weight @ old.x)


def _huber(t: Array) -> Array:
    size = np.abs(t)
    return np.where(size <= HUBER, 0.5 * t * t, HUBER * (size - 0.5 * HUBER))


def _capped(residual: Array) -> float:
    """m, RMS of what is not lost."""
    return float(np.sqrt(np.nanmean(np.square(np.clip(residual, -0.010, 0.010)))))


def _lost(samples: Sequence[Sample], found: Match) -> tuple[tuple[str, float], ...]:
    bad = np.isnan(found.residual)
    first = {int(s): float(samples[s].times[found.frame[bad & (found.sample == s)].min()]) for s in found.sample[bad]}
    return tuple((samples[s].trial.name, time) for s, time in sorted(first.items()))

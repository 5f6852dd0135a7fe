"""Levenberg-Marquardt in the logarithms of the factors, with a data-sheet prior and honest covariances."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import SimulationError
from fabdesign.forward import PARAMETERS, Case, ForwardModel
from studies.calibrate_branches import ASTRAY, better_branch, misfit, share_astray, thinned
from studies.calibrate_clouds import Array, Match, Motion, Sample, derivatives, match

# Standard deviations of the logarithms: data sheets are good to tens of percent, their damping to 30 %.
PRIOR = dict.fromkeys(PARAMETERS, 0.15) | {"damping": 0.30}
HUBER = 1.345  # of the scale: 95 % efficient on normal noise (Huber 1981)
BLOCK = 0.5  # s: residuals of one trial within it count as one observation, about half a swing of the cloth
_STEP = 0.03  # of a logarithm, in the first finite differences
_CHANGE = 0.2e-3  # m, RMS of the residuals' change that later ones aim at: ten times the noise of two motions
_SHORTEST, _LONGEST = 0.1, 1.5  # of such a difference, in standard deviations of the prior
_LARGEST = 0.4  # of a logarithm, in one iteration
_ITERATIONS = 10
_REWEIGHTED = 6  # times, in one iteration
_CONVERGED = 0.01  # of a logarithm
_NEAR = 0.05  # of a logarithm: steps under it are left to the fine engine
_FINE_ITERATIONS = 5  # cheap: without new differences
_DAMPING = 0.3  # Levenberg-Marquardt's, after a step that made it worse
_LINEAR = 0.005  # m: frames that the prior moves by more count less
_BRANCHES = 3  # other branches taken at most
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
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class _State:
    x: Array
    changes: list[Motion]  # (7, F, 2 n, 3) m a sample, of the vertices
    found: Match
    jacobian: Array  # (N, 7) m


@dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations at a state."""

    gradient: Array  # (7,)
    hessian: Array  # (7, 7) of the data
    scores: Array  # (clusters, 7)
    tempering: float
    scale: float
    sensitivity: Array
    frames: Array  # (N,) weight of each point's frame; 0 where it is not used


def fit(
    samples: Sequence[Sample],
    coarse: ForwardModel,
    fine: ForwardModel | None = None,
    *,
    prior: Mapping[str, float] = PRIOR,
    progress: Callable[[str], None] = lambda line: None,
) -> Fit:
    """Most probable factors given the samples. Each iteration of `coarse` simulates motions and seven differences.

    With `fine`, `coarse` makes the first iterations, its motions corrected by what both are apart at the data sheet.
    Cloth that buckles multiplies small differences, and that correction, true at the data sheet, is then centimetres
    off elsewhere; so the last iterations are by `fine` alone, with the differences of their first: they lead not
    much farther than a difference's own step. Where frames are left that the model buckles another way, other branches
    are tried (studies/calibrate_branches.py).

    All points of a block of 0.5 s share the model's error, so their likelihood is tempered: raised to the power that
    makes its curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011). The covariance
    is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where nothing is
    left because every motion diverges.
    """
    weight = np.diag([1 / prior[name] ** 2 for name in PARAMETERS])
    start = np.zeros(len(PARAMETERS))
    correction = _correction(samples, fine, coarse) if fine is not None else None
    look = partial(_state, samples, coarse, correction=correction)
    state = look(start, _STEP * np.eye(len(start)))
    first = state.found
    near = _CONVERGED if fine is None else _NEAR
    state, iterations, converged = _descend(samples, state, look, weight, near, _ITERATIONS, progress)
    if fine is not None:
        _, normal = _step(samples, state, weight, 0.0)
        state = _state(samples, fine, state.x, _directions(normal))
        look = partial(_state, samples, fine, changes=state.changes)
        state, more, converged = _descend(
            samples, state, look, weight, _CONVERGED, _FINE_ITERATIONS, lambda line: progress(f"fine {line}")
        )
        iterations += more
    last = coarse if fine is None else fine
    state, more, converged = _other_branches(samples, last, state, weight, converged, progress)
    iterations += more
    _, normal = _step(samples, state, weight, 0.0)
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
        iterations=iterations,
        converged=converged,
    )


def _descend(
    samples: Sequence[Sample],
    state: _State,
    look: Callable[..., _State],
    weight: Array,
    close: float,
    most: int,
    progress: Callable[[str], None],
) -> tuple[_State, int, bool]:
    """From `state` until a step is under `close`, or `most` iterations: where that led, how many, and which of both."""
    damping = 0.0
    for iteration in range(1, most + 1):
        step, normal = _step(samples, state, weight, damping)
        progress(f"iteration {iteration}: {1e3 * _capped(state.found.residual):.3f} mm RMS")
        if float(np.abs(step).max()) < close:  # too small for new differences, not for another branch
            candidate = look(state.x + step, _directions(normal), changes=state.changes)
            return candidate if _loss(state, candidate, normal, weight) < 0 else state, iteration, True
        candidate = look(state.x + step, _directions(normal))
        if _loss(state, candidate, normal, weight) < 0:
            state, damping = candidate, damping / 10
        else:
            damping = max(10 * damping, _DAMPING)
    return state, most, False


def _other_branches(
    samples: Sequence[Sample],
    forward: ForwardModel,
    state: _State,
    weight: Array,
    converged: bool,
    progress: Callable[[str], None],
) -> tuple[_State, int, bool]:
    """From branch to branch while frames go astray and another one leaves less; how many iterations that took."""
    rng, iterations = np.random.default_rng(0), 0
    few = thinned(samples)
    for _ in range(_BRANCHES):
        if share_astray(state.found) < ASTRAY:
            break
        _, normal = _step(samples, state, weight, 0.0)
        spread = np.linalg.cholesky(np.linalg.inv(normal.tempering * normal.hessian + weight))
        other = better_branch(few, partial(_motions, few, forward), state.x, spread, rng)
        if other is None:
            break
        progress("another branch")
        start = _state(samples, forward, other, _directions(normal))
        look = partial(_state, samples, forward, changes=start.changes)
        end, more, ended = _descend(samples, start, look, weight, _CONVERGED, _FINE_ITERATIONS, progress)
        iterations += more
        left = [misfit(s.found) for s in (state, start, end)]
        if min(left) == left[0]:
            break
        state, converged = (end, ended) if left[2] <= left[1] else (start, False)
    return state, iterations, converged


def _factors(x: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(PARAMETERS, np.exp(x), strict=True)}


def _state(
    samples: Sequence[Sample],
    forward: ForwardModel,
    x: Array,
    directions: Array,
    *,
    correction: list[Motion] | None = None,
    changes: list[Motion] | None = None,
) -> _State:
    """Motions at x and, by forward differences along the rows of `directions` (7, 7) in the same batch, their changes
    by each factor, where those are not given."""
    others = [x + d for d in directions] if changes is None else []
    base, *moved = _motions(samples, forward, [x, *others])
    if changes is None:
        along = [np.stack([other[s] - base[s] for other in moved]) for s in range(len(samples))]
        changes = [np.tensordot(np.linalg.inv(directions), difference, axes=1) for difference in along]
    if correction is not None:
        base = [motion + extra for motion, extra in zip(base, correction, strict=True)]
    found = match(samples, base)
    return _State(x, changes, found, derivatives(found, changes))


def _directions(normal: _Normal) -> Array:
    """(7, 7), a row each: combinations of factors that change the residuals independently, and by as much each.

    Where all factors nearly cancel, the differences of single ones drown in the noise and the curvature of each; as one
    difference, long enough, that combination stands out.
    """
    prior = np.array([PRIOR[name] for name in PARAMETERS])
    squares, vectors = np.linalg.eigh(normal.sensitivity * np.outer(prior, prior))
    length = np.clip(_CHANGE / np.sqrt(np.maximum(squares, 1e-30)), _SHORTEST, _LONGEST)
    return np.asarray((vectors * length * prior[:, None]).T)


def _correction(samples: Sequence[Sample], fine: ForwardModel, coarse: ForwardModel) -> list[Motion]:
    """(F, 2 n, 3) m a sample, fine less coarse; nothing where either is lost."""
    start = np.zeros(len(PARAMETERS))
    pairs = zip(*(_motions(samples, forward, [start])[0] for forward in (fine, coarse)), strict=True)
    return [np.nan_to_num(one - other, nan=0.0) for one, other in pairs]


def _motions(samples: Sequence[Sample], forward: ForwardModel, xs: Sequence[Array]) -> list[list[Motion]]:
    """Of every x, a motion a sample; all in one batch."""
    cases = [Case(s.trial.design, s.trial.program, _factors(x)) for x in xs for s in samples]
    motions = forward.motions(cases, [s.times for _ in xs for s in samples])
    return [list(motions[k : k + len(samples)]) for k in range(0, len(motions), len(samples))]


def _normal(samples: Sequence[Sample], state: _State, weight: Array, step: Array) -> _Normal:
    """Weights, scores and tempering are those of the residuals that `step` is expected to leave."""
    found, jacobian = state.found, state.jacobian
    sound = np.isfinite(found.residual) & np.isfinite(jacobian).all(axis=1)
    if not sound.any():
        raise SimulationError("every motion of the trials to fit diverged")
    r, j = found.residual[sound], jacobian[sound]
    left = r + j @ step
    scale = _scale(left)
    frames = _frame_weights(found, sound, left, j)
    w = frames * np.minimum(1.0, HUBER * scale / np.maximum(np.abs(left), 1e-12)) / scale**2
    cluster = _clusters(samples, found)[sound]
    _, cluster = np.unique(cluster, return_inverse=True)
    scores = np.zeros((cluster.max() + 1, len(weight)))
    np.add.at(scores, cluster, j * (w * left)[:, None])
    hessian = (j * w[:, None]).T @ j
    inverse = np.linalg.inv(hessian + weight)
    everywhere = np.zeros(len(sound))
    everywhere[sound] = frames
    # weights above one would trust points more than their number allows
    tempering = min(1.0, float(np.trace(inverse @ hessian) / np.trace(inverse @ _scatter(scores, hessian, weight))))
    return _Normal(j.T @ (w * r), hessian, scores, tempering, scale, j.T @ j / len(j), everywhere)


def _scatter(scores: Array, information: Array, weight: Array) -> Array:
    """(7, 7) variance of the sum of the clusters' scores about their mean, for the parameters fitted."""
    fitted = float(np.trace(np.linalg.solve(information + weight, information)))
    centred = scores - scores.mean(axis=0)
    count = len(scores)
    return np.asarray(centred.T @ centred * count / max(count - fitted, 1.0))


def _scale(residual: Array) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), _SMALLEST_SCALE)


def _frame_weights(found: Match, sound: NDArray[np.bool_], residual: Array, jacobian: Array) -> Array:
    """Of each point, by its frame: less where the median residual is over twice the usual one, and where the prior
    moves the surface by more than can be linearised, as where the cloth is about to buckle to one side or the other."""
    _, frame = np.unique(found.sample[sound] * 100_000 + found.frame[sound], return_inverse=True)
    order = np.argsort(frame, kind="stable")
    borders = np.flatnonzero(np.diff(frame[order])) + 1
    medians = np.array([np.median(part) for part in np.split(np.abs(residual)[order], borders)])
    far = medians / (2.0 * max(float(np.median(medians)), _SMALLEST_SCALE))
    moved = np.square(jacobian * [PRIOR[name] for name in PARAMETERS]).sum(axis=1)
    unsure = np.sqrt(np.array([part.mean() for part in np.split(moved[order], borders)])) / _LINEAR
    return np.asarray(np.square(1 / np.maximum(1.0, np.maximum(far, unsure)))[frame])


def _clusters(samples: Sequence[Sample], found: Match) -> NDArray[np.intp]:
    """Trial and block of time of each point."""
    result = np.empty(len(found.sample), dtype=np.intp)
    for s, sample in enumerate(samples):
        rows = found.sample == s
        result[rows] = s * 10_000 + (sample.times[found.frame[rows]] / BLOCK - 1e-6).astype(int)
    return result


def _step(samples: Sequence[Sample], state: _State, weight: Array, damping: float) -> tuple[Array, _Normal]:
    """The step to the minimum of the linearised residuals, reweighted until it stands; and its normal equations."""
    step: Array = np.zeros(len(weight))
    for _ in range(_REWEIGHTED):
        normal = _normal(samples, state, weight, step)
        information = normal.tempering * normal.hessian
        gradient = normal.tempering * normal.gradient + weight @ state.x
        step = np.asarray(-np.linalg.solve(information + weight + damping * np.diag(np.diag(information)), gradient))
        step = step * min(1.0, _LARGEST / max(float(np.abs(step).max()), 1e-12))
    return step, normal


def _loss(old: _State, new: _State, normal: _Normal, weight: Array) -> float:
    """How much worse `new` is than `old`, over the points that both have; infinite where `new` loses over a tenth."""
    both = np.isfinite(old.found.residual) & np.isfinite(new.found.residual)
    if both.sum() < 0.9 * np.isfinite(old.found.residual).sum():
        return float("inf")
    rho = [_huber(state.found.residual[both] / normal.scale) for state in (new, old)]
    data = normal.tempering * float((normal.frames[both] * (rho[0] - rho[1])).sum())
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

"""The linearised problem at a state: residuals reweighted for strays and lost frames, tempered, with the data sheet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import SimulationError
from studies.calibration.clouds import Array, Match, Sample, frames_of
from studies.calibration.parameters import DECLARED, FitVector
from studies.calibration.state import Evaluation, Linearisation

HUBER = 1.345  # of the scale: 95 % efficient on normal noise (Huber 1981)
BLOCK = 0.5  # s: residuals of one trial within it count as one observation, about half a swing of the cloth
MODES = 10  # observations that the points of such a block count as at most: about the shapes a model's error takes
FAR = 2.0  # times the usual median residual: an outlying frame, which counts less
_CHANGE = 0.2e-3  # m, RMS of the residuals' change that later differences aim at: ten times the noise of two motions
_SHORTEST, _LONGEST = 0.1, 1.5  # of such a difference, in standard deviations of the prior
_LARGEST = 0.4  # of a logarithm, in one iteration
_REWEIGHTED = 6  # times, in one iteration
_LINEAR = 0.005  # m: frames that the prior moves by more count less
_SMALLEST_SCALE = 1e-6  # m, for clouds without noise


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations at a state."""

    gradient: Array  # (p,)
    hessian: Array  # (p, p) of the data
    scores: Array  # (clusters, p)
    tempering: float
    capped: bool  # the tempering is that by MODES
    scale: float
    sensitivity: Array
    frames: Array  # (N,) weight of each point's frame; 0 where it is not used

    @property
    def information(self) -> Array:
        """(p, p) of the data alone, tempered."""
        return self.tempering * self.hessian


def step_to_minimum(
    samples: Sequence[Sample], state: Linearisation, weight: Array, damping: float, vector: FitVector = DECLARED
) -> tuple[Array, Normal]:
    """The step to the minimum of the linearised residuals, reweighted until it stands; and its normal equations. An
    unknown at its limit stays there where the step would lead beyond."""
    step: Array = np.zeros(len(weight))
    for _ in range(_REWEIGHTED):
        normal = normal_equations(samples, state, weight, step, vector)
        gradient = normal.tempering * normal.gradient + weight @ state.x
        damped = normal.information + weight + damping * np.diag(np.diag(normal.information))
        step = _bounded_step(damped, gradient, state.x, vector)
        step = step * min(1.0, _LARGEST / max(float(np.abs(step / vector.scale).max()), 1e-12))
    return step, normal


def _bounded_step(hessian: Array, gradient: Array, x: Array, vector: FitVector) -> Array:
    """Newton's step, with the unknowns held that are at a limit and would leave it."""
    step: Array = np.zeros(len(x))
    free = np.ones(len(x), dtype=bool)
    low, high = vector.limits
    while free.any():
        step = np.zeros(len(x))
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        leaves = free & (((x <= low) & (step < 0)) | ((x >= high) & (step > 0)))
        if not leaves.any():
            break
        free &= ~leaves
    return step


def directions(normal: Normal, vector: FitVector = DECLARED) -> Array:
    """(p, p), a row each: combinations of unknowns that change the residuals independently, and by as much each.

    Where all factors nearly cancel, the differences of single ones drown in the noise and the curvature of each; as one
    difference, long enough, that combination stands out.
    """
    prior = vector.prior
    squares, vectors = np.linalg.eigh(normal.sensitivity * np.outer(prior, prior))
    length = np.clip(_CHANGE / np.sqrt(np.maximum(squares, 1e-30)), _SHORTEST, _LONGEST)
    return np.asarray((vectors * length * prior[:, None]).T)


def normal_equations(
    samples: Sequence[Sample], state: Linearisation, weight: Array, step: Array, vector: FitVector = DECLARED
) -> Normal:
    """Weights, scores and tempering are those of the residuals that `step` is expected to leave."""
    found, jacobian = state.found, state.jacobian
    sound = np.isfinite(found.residual) & np.isfinite(jacobian).all(axis=1)
    if not sound.any():
        raise SimulationError("every motion of the trials to fit diverged")
    r, j = found.residual[sound], jacobian[sound]
    left = r + j @ step
    scale = _scale(left)
    frames = _frame_weights(found, sound, left, j, vector.prior)
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
    seen, scattered = (float(np.trace(inverse @ m)) for m in (hessian, scatter(scores, hessian, weight)))
    tempering = min(1.0, seen / scattered) if scattered > 0 else 1.0  # 0: no point says anything
    most = MODES * len(scores) / max(float(frames.sum()), 1e-12)
    capped = most < tempering
    tempering = min(tempering, most)
    sensitivity = (j * frames[:, None]).T @ j / frames.sum()
    return Normal(j.T @ (w * r), hessian, scores, tempering, capped, scale, sensitivity, everywhere)


def scatter(scores: Array, information: Array, weight: Array) -> Array:
    """(p, p) variance of the sum of the clusters' scores about their mean, for the parameters fitted."""
    fitted = float(np.trace(np.linalg.solve(information + weight, information)))
    centred = scores - scores.mean(axis=0)
    count = len(scores)
    return np.asarray(centred.T @ centred * count / max(count - fitted, 1.0))


def loss(old: Evaluation, new: Evaluation, normal: Normal, weight: Array) -> float:
    """How much worse `new` is than `old`, over the points that both have; infinite where `new` loses over a tenth."""
    both = np.isfinite(old.found.residual) & np.isfinite(new.found.residual)
    if both.sum() < 0.9 * np.isfinite(old.found.residual).sum():
        return float("inf")
    rho = [_huber(evaluation.found.residual[both] / normal.scale) for evaluation in (new, old)]
    data = normal.tempering * float((normal.frames[both] * (rho[0] - rho[1])).sum())
    return data + 0.5 * float(new.x @ weight @ new.x - old.x @ weight @ old.x)


def _huber(t: Array) -> Array:
    size = np.abs(t)
    return np.where(size <= HUBER, 0.5 * t * t, HUBER * (size - 0.5 * HUBER))


def _scale(residual: Array) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), _SMALLEST_SCALE)


def _frame_weights(found: Match, sound: NDArray[np.bool_], residual: Array, jacobian: Array, prior: Array) -> Array:
    """Of each point, by its frame: less where the median residual is over FAR times the usual one, and where the
    prior moves the surface by more than can be linearised, as where the cloth is about to buckle to one side or the
    other."""
    frame, groups = frames_of(found, sound)
    size = np.abs(residual)
    medians = np.array([np.median(size[points]) for points in groups])
    far = medians / (FAR * max(float(np.median(medians)), _SMALLEST_SCALE))
    moved = np.square(jacobian * prior).sum(axis=1)
    unsure = np.sqrt(np.array([moved[points].mean() for points in groups])) / _LINEAR
    return np.asarray(np.square(1 / np.maximum(1.0, np.maximum(far, unsure)))[frame])


def _clusters(samples: Sequence[Sample], found: Match) -> NDArray[np.intp]:
    """Trial and block of time of each point."""
    result = np.empty(len(found.sample), dtype=np.intp)
    for s, sample in enumerate(samples):
        rows = found.sample == s
        result[rows] = s * 10_000 + (sample.times[found.frame[rows]] / BLOCK - 1e-6).astype(int)
    return result

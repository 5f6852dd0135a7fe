"""The linearised problem at a state: residuals reweighted for strays, whitened, tempered, with priors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from fabdesign.errors import SimulationError
from fabdesign.nouns.array import Array, Indices
from optimize.fit.misfit import FAR, Loss, Misfit, frames_of, groups_of
from optimize.fit.parameters import DECLARED, FitVector
from optimize.fit.problem import Evaluation, InputErrors, Linearisation

MODES = 10  # observations that the points of such a block count as at most: about the shapes a model's error takes
BENT = 2.0  # times what is not proportional in errors of the inputs, for those that were not tried
_CHANGE = 0.2e-3  # m, RMS of the residuals' change that later differences aim at: ten times the noise of two motions
_SHORTEST, _LONGEST = 0.1, 1.5  # of such a difference, in standard deviations of the prior
LARGEST = 0.4  # of a logarithm, in one iteration
_REWEIGHTED = 6  # times, in one iteration


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations at a state."""

    gradient: Array  # (p,)
    hessian: Array  # (p, p) of the data
    scores: Array  # (clusters, p)
    tempering: float
    capped: bool  # MODES tempers the weights, and the scores ask for no more
    scale: float
    sensitivity: Array
    frames: Array  # (N,) weight of each point by its frame, and by MODES; 0 where it is not used
    counts: Array  # (N,) how much of what a point says errors of the inputs leave, 0 to 1
    weights: Array  # (N,) 1/m^2 of each point; 0 where it is not used

    @property
    def information(self) -> Array:
        """Return the information (p, p) of the data alone, tempered."""
        return self.tempering * self.hessian


def step_to_minimum(
    state: Linearisation,
    vector: FitVector,
    inputs: InputErrors | None = None,
    *,
    damping: float = 0.0,
    far: float = FAR,
) -> tuple[Array, Normal]:
    """Return the step to the minimum of the linearised residuals, reweighted until it stands, and its normal equations.
    An unknown at its limit stays there where the step would lead beyond."""
    step, weight = np.zeros(len(state.x)), vector.precision
    for _ in range(_REWEIGHTED):
        normal = normal_equations(state, step, vector, inputs, far)
        gradient = normal.tempering * normal.gradient + weight @ state.x
        damped = normal.information + weight + damping * np.diag(np.diag(normal.information))
        last, step = step, bounded_step(damped, gradient, state.x, vector)
        step = step * min(1.0, LARGEST / max(float(np.abs(step / vector.scale).max(initial=0.0)), 1e-12))
        if np.abs((step - last) / vector.scale).max(initial=0.0) < 1e-4:
            break
    return step, normal


def bounded_step(hessian: Array, gradient: Array, x: Array, vector: FitVector) -> Array:
    """Return the step to the quadratic model's least value within the limits: a step that is cut at one of them
    afterwards leaves the other unknowns where they are no good."""
    step = np.asarray(-np.linalg.solve(hessian, gradient), dtype=np.float64)
    low, high = vector.limits
    if (x + step >= low).all() and (x + step <= high).all():
        return step
    root = np.linalg.cholesky(hessian)
    target = -solve_triangular(root, gradient, lower=True)
    return np.asarray(lsq_linear(root.T, target, bounds=(np.minimum(low - x, 0.0), np.maximum(high - x, 0.0))).x)


def directions(normal: Normal, vector: FitVector = DECLARED) -> Array:
    """Return (p, p), a row each: combinations of the factors that change the residuals independently, and by as much
    each; and effects' unknowns one by one, as long.

    Where all factors nearly cancel, the differences of single ones drown in the noise and the curvature of each; as one
    difference, long enough, that combination stands out. An effect that moves by itself leaves the others' jumps of
    pressure where they were, so that motions share their time steps, and one of sensing alone needs no motion.
    """
    prior = vector.prior
    rows = np.zeros((len(prior), len(prior)))
    factors = vector.are_factors
    for group in (np.flatnonzero(factors), *np.flatnonzero(~factors)[:, None]):
        block = np.ix_(group, group)
        squares, vectors = np.linalg.eigh(normal.sensitivity[block] * np.outer(prior[group], prior[group]))
        length = np.clip(_CHANGE / np.sqrt(np.maximum(squares, 1e-30)), _SHORTEST, _LONGEST)
        rows[block] = (vectors * length * prior[group, None]).T
    return rows


def normal_equations(
    state: Linearisation, step: Array, vector: FitVector, inputs: InputErrors | None = None, far: float = FAR
) -> Normal:
    """Return the normal equations, weighted and tempered by the residuals that `step` is expected to leave.

    inputs: an error of theirs may have any value in every block: it is marginalised, which whitens the block by
    sigma^2 + U U^T (Woodbury), sigma that of as many observations as MODES allows; what it does that is not
    proportional counts as noise. Where small errors of the inputs move the cloth far, little is left.
    far: times the usual median residual over which a frame counts less.
    """
    misfit, jacobian, weight = state.misfit, state.jacobian, vector.precision
    inputs = inputs or _exact(len(jacobian))
    known = misfit.residual, jacobian, inputs.columns, inputs.bent
    sound = np.all([np.isfinite(np.atleast_2d(part.T)).all(axis=0) for part in known], axis=0)
    if not sound.any():
        raise SimulationError("every motion of the trials to fit diverged")
    r, j, u, bent = (part[sound] for part in known)
    _, cluster = np.unique(misfit.block[sound], return_inverse=True)
    residual = r + j @ step
    scale = misfit.loss.scale(residual)
    sharp = 1 / (1 + np.square(BENT * bent / scale))
    residual, _ = _cleaned(residual, u, sharp, cluster, scale, misfit.loss)
    scale = misfit.loss.scale(residual[sharp > 0.5]) if (sharp > 0.5).any() else scale
    sharp = 1 / (1 + np.square(BENT * bent / scale))
    frames = sharp * _frame_weights(misfit, sound, residual * np.sqrt(sharp), max(far, misfit.loss.far))
    most = MODES * (cluster.max() + 1) / max(float(frames.sum()), 1e-12)
    frames = frames * min(1.0, most)  # before errors of the inputs take their part, which bounds what is left by itself
    w = frames * misfit.loss.share(residual * np.sqrt(sharp), scale) / scale**2
    white = j - _explained(j, u, w, cluster)[0]
    scores = np.zeros((cluster.max() + 1, len(weight)))
    np.add.at(scores, cluster, white * (w * (r + j @ step))[:, None])
    hessian = (white * w[:, None]).T @ j
    hessian = 0.5 * (hessian + hessian.T)
    inverse = np.linalg.inv(hessian + weight)
    seen, scattered = (float(np.trace(inverse @ m)) for m in (hessian, scatter(scores, hessian, weight)))
    # weights above one would trust too much; far off, blocks that disagree are what is not fitted yet
    tempering = min(1.0, seen / scattered) if scattered > 0 and np.isfinite(far) else 1.0
    return Normal(
        gradient=white.T @ (w * r),
        hessian=hessian,
        scores=scores,
        tempering=tempering,
        capped=most < 1 and tempering == 1,
        scale=scale,
        sensitivity=(j * frames[:, None]).T @ j / frames.sum(),
        frames=_everywhere(frames, sound),
        counts=_everywhere(sharp * _share(j, white, w, cluster, vector.prior) if u.size else sharp, sound),
        weights=_everywhere(w, sound),
    )


def _exact(count: int) -> InputErrors:
    """Return the errors of inputs that have none, on so many rows."""
    return InputErrors(np.zeros((count, 0)), np.zeros(count))


def _everywhere(values: Array, sound: NDArray[np.bool_]) -> Array:
    """Return the values (n,) of sound points, and zero for others, (N,)."""
    out = np.zeros(len(sound))
    out[sound] = values
    return out


def _explained(table: Array, u: Array, w: Array, cluster: Indices) -> tuple[Array, Array]:
    """Return what errors of the inputs (N, k) explain of the columns of `table` (N, p) in each cluster, (N, p), and
    (p,) the sums of these errors' squares, in standard deviations."""
    out, paid = np.zeros_like(table), np.zeros(table.shape[1])
    for rows in groups_of(cluster) if u.size else ():  # exact inputs explain nothing
        inputs, weighted = u[rows], u[rows] * w[rows, None]
        errors = np.linalg.solve(np.eye(inputs.shape[1]) + weighted.T @ inputs, weighted.T @ table[rows])
        out[rows] = inputs @ errors
        paid += np.square(errors).sum(axis=0)
    return out, paid


def whitened(columns: Array, block: Indices, normal: Normal, inputs: InputErrors | None) -> Array:
    """Return columns of changes of the residuals less what errors of the inputs can explain of them, (N, k) m."""
    if inputs is None:
        return columns
    used = np.flatnonzero(normal.weights > 0)
    _, cluster = np.unique(block[used], return_inverse=True)
    out = columns.copy()
    out[used] -= _explained(columns[used], inputs.columns[used], normal.weights[used], cluster)[0]
    return out


def _cleaned(
    residual: Array, u: Array, sharp: Array, cluster: Indices, scale: float, counted: Loss
) -> tuple[Array, float]:
    """Return the residual less what errors of the inputs explain of it, (N,) m, and the sum of these errors' squares,
    in standard deviations."""
    bounded = sharp * counted.share(residual, scale) / scale**2
    explained, paid = _explained(residual[:, None], u, bounded, cluster)
    return residual - explained[:, 0], float(paid[0])


def _share(j: Array, white: Array, w: Array, cluster: Indices, prior: Array) -> Array:
    """Return the share of each cluster's information, prior deviations alike, that errors of the inputs leave, (N,)."""
    out = np.ones(len(j))
    raw, kept = ((a * j * prior**2).sum(axis=1) * w for a in (j, white))
    for rows in groups_of(cluster):
        out[rows] = np.clip(kept[rows].sum() / max(raw[rows].sum(), 1e-30), 0.0, 1.0)
    return out


def scatter(scores: Array, information: Array, weight: Array) -> Array:
    """Return the variance (p, p) of the sum of the clusters' scores about their mean, for the parameters fitted."""
    fitted = float(np.trace(np.linalg.solve(information + weight, information)))
    centred = scores - scores.mean(axis=0)
    count = len(scores)
    return np.asarray(centred.T @ centred * count / max(count - fitted, 1.0))


def loss(
    old: Evaluation, new: Evaluation, normal: Normal, vector: FitVector, inputs: InputErrors | None = None
) -> float:
    """Return how much worse `new` is than `old` over the points of both; infinite where `new` loses over a tenth."""
    there = np.isfinite(old.misfit.residual) & (normal.frames > 0)
    both = there & np.isfinite(new.misfit.residual)
    if both.sum() < 0.9 * there.sum():
        return float("inf")
    _, cluster = np.unique(old.misfit.block[both], return_inverse=True)
    frames, scale, u = normal.frames[both], normal.scale, (inputs or _exact(len(both))).columns[both]

    def size(misfit: Misfit) -> float:
        """Return the -log likelihood with the errors of the inputs that make it least."""
        residual, paid = _cleaned(misfit.residual[both], u, frames, cluster, scale, misfit.loss)
        return float((frames * misfit.loss.of(residual / scale)).sum()) + 0.5 * paid

    prior = 0.5 * float(new.x @ vector.precision @ new.x - old.x @ vector.precision @ old.x)
    return normal.tempering * (size(new.misfit) - size(old.misfit)) + prior


def _frame_weights(misfit: Misfit, sound: NDArray[np.bool_], residual: Array, most: float) -> Array:
    """Return the weight of each point by its frame, less where the median residual is over `most` times the usual."""
    frame, groups = frames_of(misfit, sound)
    size = np.abs(residual)
    medians = np.array([np.median(size[points]) for points in groups])
    far = medians / (most * max(float(np.median(medians)), misfit.loss.smallest))
    return np.asarray(np.square(1 / np.maximum(1.0, far))[frame])

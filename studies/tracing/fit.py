"""Gauss-Newton on the heights of measured points over the model's surface, without weights.

Calibration gives less weight to frames that it misses, which is how an effect would hide. Here every judged point
counts alike but for strays. Points of one frame share the model's error: each half second of a trial counts as MODES
observations, whose deviation is fitted along (the loss is n/2 log of the mean square).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from fabdesign.errors import SimulationError
from fabdesign.forward import ForwardModel
from studies.calibration.clouds import Match, Motion, Sample, cut, derivatives, frames_of, match
from studies.calibration.normal import BLOCK, MODES
from studies.tracing.vector import Array, Vector

STRAY = 5.0  # times the frame's robust deviation
LARGEST = 0.020  # m: a residual farther off counts as this far, and says nothing of where to go
STEP = 0.4  # prior standard deviations, of a difference: far over the noise of two motions
REACH = 2.5  # prior standard deviations that a parameter moves at most in one iteration
LENGTHS = (1.0, 0.5, 0.2)  # of a step, tried at once
SLIGHT = 0.05  # prior standard deviations: a step under it is the last
LITTLE = 2.0  # of log likelihood: a step that gains less is the last, too
CREEP = 0.02  # of the residuals' RMS: and one that gains less, as in calibration
EARLY = 0.5, 1.0  # s: the first iterations look no further, so that swings are followed into their right turn
LOST = 0.02  # share of the points without a motion, from which on a place counts for nothing
_AT_ONCE = 128  # motions in memory


@dataclass(frozen=True, eq=False)
class State:
    """A place of the vector, and the residuals there."""

    vector: Vector
    x: Array  # (size,)
    motions: list[Motion]  # (F, 2 n, 3) m a sample
    found: Match
    kept: NDArray[np.bool_]  # (N,) no stray, and the motion is there
    jacobian: Array | None = None  # (N, size) m

    @property
    def residual(self) -> Array:
        """(N,) m, cut at LARGEST, zero where not kept."""
        return np.where(self.kept, np.clip(np.nan_to_num(self.found.residual), -LARGEST, LARGEST), 0.0)

    @property
    def mean_square(self) -> float:
        return float(np.square(self.residual[self.kept]).mean())

    @property
    def rms(self) -> float:
        """m, over the points kept."""
        return float(np.sqrt(self.mean_square))

    @property
    def slopes(self) -> Array:
        """(N, size) m, zero where a point is not kept or too far off to say where to go."""
        assert self.jacobian is not None
        return rows_kept(self, self.jacobian)


def rows_kept(state: State, columns: Array) -> Array:
    """(N, k) columns of changes, zero where a point says nothing."""
    usable = state.kept & (np.abs(np.nan_to_num(state.found.residual)) < LARGEST) & np.isfinite(columns).all(axis=1)
    return np.where(usable[:, None], columns, 0.0)


@dataclass(frozen=True, eq=False)
class Bench:
    """The samples and the forward model that makes motions of them."""

    samples: Sequence[Sample]
    forward: ForwardModel

    @property
    def observations(self) -> float:
        """How many independent ones the points are taken for."""
        return float(sum(MODES * len({int(t / BLOCK) for t in sample.times}) for sample in self.samples))

    def states(self, vector: Vector, xs: Sequence[Array]) -> list[State]:
        """All in one batch."""
        xs = [vector.within(x) for x in xs]
        count = len(self.samples)
        motions = self.forward.motions(
            [vector.case(s.trial, x) for x in xs for s in self.samples], [s.times for _ in xs for s in self.samples]
        )
        states = []
        for k, x in enumerate(xs):
            own = list(motions[k * count : (k + 1) * count])
            found = match(self.samples, own)
            states.append(State(vector, x, own, found, _kept(found)))
        return states

    def with_slopes(self, state: State, *, known: int = 0) -> State:
        """The state with its Jacobian; its first `known` columns are those that it has."""
        steps = np.full(len(state.x), STEP)
        up = np.array([state.vector.within(state.x + d)[k] for k, d in enumerate(np.diag(steps))])
        steps = np.where(up - state.x > 0.5 * STEP, up - state.x, -STEP)  # at an upper bound, downwards
        moved = [[state.vector.case(s.trial, state.x + step) for s in self.samples] for step in np.diag(steps)[known:]]
        fresh = self.differences(state, moved) / steps[known:]
        if known:
            assert state.jacobian is not None
            fresh = np.concatenate([state.jacobian[:, :known], fresh], axis=1)
        return replace(state, jacobian=fresh)

    def differences(self, state: State, cases: Sequence[Sequence], *, trials_ahead: int = 0) -> Array:
        """(N, k) m: changes of the residuals from the state's motions to those of k times `cases`, a case a sample.

        trials_ahead: give every sample the change of the one so many further on, for columns that must not fit."""
        return self.columns(state, cases, (trials_ahead,))[0]

    def columns(self, state: State, cases: Sequence[Sequence], ahead: Sequence[int]) -> list[Array]:
        """`differences` for each of `ahead` at once."""
        count = len(self.samples)
        at_once = max(1, _AT_ONCE // count)
        out = [np.empty((len(state.found.residual), len(cases))) for _ in ahead]
        for first in range(0, len(cases), at_once):
            some = cases[first : first + at_once]
            motions = self.forward.motions(
                [case for row in some for case in row], [s.times for _ in some for s in self.samples]
            )
            changes = [
                np.stack([motions[k * count + s] - state.motions[s] for k in range(len(some))]) for s in range(count)
            ]
            for result, shift in zip(out, ahead, strict=True):
                shifted = [_fitting(changes[(s + shift) % count], changes[s]) for s in range(count)]
                result[:, first : first + len(some)] = derivatives(state.found, shifted)
        return out


def _fitting(change: Motion, own: Motion) -> Motion:
    """Another trial's change, where it has as many frames; else nothing."""
    return change if change.shape == own.shape else np.zeros_like(own)


def _kept(found: Match) -> NDArray[np.bool_]:
    """No strays: points much farther off than the others of their frame."""
    size = np.abs(found.residual)
    kept = np.isfinite(size)
    for points in frames_of(found)[1]:
        own = size[points]
        if np.isfinite(own).all():
            kept[points] = own <= STRAY * max(1.4826 * float(np.median(own)), 1e-4)
    return kept


def normal(bench: Bench, state: State, mean_square: float | None = None) -> tuple[Array, Array]:
    """Gradient (size,) and Hessian (size, size) of the loss."""
    slopes, precision = state.slopes, state.vector.precision
    share = bench.observations / (state.kept.sum() * (mean_square or state.mean_square))
    return share * slopes.T @ state.residual + precision * state.x, share * slopes.T @ slopes + np.diag(precision)


def expected(bench: Bench, base: State, other: State) -> float:
    """m^2, the mean square of the residuals at `other`, a place of more parameters beside `base`, once those of `base`
    have moved to first order, by its slopes; infinite where no point is kept."""
    if not other.kept.any():
        return float("inf")
    count = len(base.x)
    moved = widened(base, other)
    gradient, hessian = normal(bench, moved)
    step = np.linalg.solve(hessian[:count, :count], gradient[:count])
    left = moved.residual - moved.slopes[:, :count] @ step
    return float(np.square(left[moved.kept]).mean())


def widened(base: State, other: State) -> State:
    """`other` with the Jacobian of `base`, and zeros for the parameters that only it has."""
    assert base.jacobian is not None
    return replace(other, jacobian=np.pad(base.jacobian, ((0, 0), (0, len(other.x) - len(base.x)))))


def loss(bench: Bench, state: State) -> float:
    """n/2 log of the mean square, and the prior; infinite where a motion is lost."""
    if np.isnan(state.found.residual).mean() > LOST:
        return float("inf")
    prior = 0.5 * float(state.vector.precision @ np.square(state.x))
    return 0.5 * bench.observations * float(np.log(max(state.mean_square, 1e-12))) + prior


def little(bench: Bench) -> float:
    """Of log likelihood, what is no gain worth a step or a new round."""
    return max(LITTLE, CREEP * bench.observations)


def descend(
    bench: Bench,
    vector: Vector,
    x: Array,
    *,
    iterations: int,
    early: int = 0,
    slopes: Array | None = None,
    exact: bool = True,
    progress: Callable[[str], None] = lambda line: None,
) -> State:
    """From `x`, `early` iterations to each of the horizons EARLY, then up to `iterations` on all: the state with its
    Jacobian.

    slopes: (N, size) m, the Jacobian at `x` or near it. exact: by differences at the state itself, not what became of
    the last one on the way there. Raises SimulationError where the motions are lost from the start."""
    for horizon in EARLY if early else ():
        first = replace(bench, samples=[cut(sample, horizon) for sample in bench.samples])
        x = _descend(first, vector, x, early, None, False, f"to {horizon:g} s, ", progress).x
    found = _descend(bench, vector, x, iterations, slopes, exact, "", progress)
    return found if found.jacobian is not None else bench.with_slopes(found)


def _descend(
    bench: Bench,
    vector: Vector,
    x: Array,
    iterations: int,
    slopes: Array | None,
    exact_at_the_end: bool,
    named: str,
    progress: Callable[[str], None],
) -> State:
    """Between two Jacobians by differences stands Broyden's update (1965): a step costs its own motions alone. Without
    `exact_at_the_end` the state's is one of either, or none."""
    state = bench.states(vector, [x])[0]
    if not state.kept.any():
        raise SimulationError("every motion of the trials to trace diverged")
    state, exact, damping = replace(state, jacobian=slopes), False, 0.0
    least = little(bench)
    for iteration in range(1, iterations + 1):
        if state.jacobian is None:
            state, exact = bench.with_slopes(state), True
        progress(f"{named}iteration {iteration}: {1e3 * state.rms:.3f} mm RMS")
        gradient, hessian = normal(bench, state)
        step = bounded_step(vector, state.x, gradient, hessian + damping * np.diag(np.diag(hessian)))
        step *= min(1.0, REACH / max(float(np.abs(step).max()), 1e-12))
        tried = bench.states(vector, [state.x + length * step for length in LENGTHS])
        best = min(tried, key=lambda other: loss(bench, other))
        moved = float(np.abs(best.x - state.x).max())
        gained = loss(bench, state) - loss(bench, best)
        if gained > 0:
            last = moved < SLIGHT or gained < least
            done = last and exact
            slopes = None if last and (exact_at_the_end or not done) else _updated(state, best)
            state, exact, damping = replace(best, jacobian=slopes), False, damping / 10
            if done:
                break
        elif not exact:
            state = replace(state, jacobian=None)
        elif damping >= 1.0 or moved < SLIGHT:
            break
        else:
            damping = max(10 * damping, 0.1)
    return bench.with_slopes(state) if exact_at_the_end and not exact else state


def bounded_step(vector: Vector, x: Array, gradient: Array, hessian: Array) -> Array:
    """To the quadratic model's least value within the vector's bounds: a step that is cut at one of them afterwards
    leaves the other parameters where they are no good."""
    step = np.asarray(-np.linalg.solve(hessian, gradient), dtype=np.float64)
    low, high = vector.bounds
    if (x + step >= low).all() and (x + step <= high).all():
        return step
    root = np.linalg.cholesky(hessian)
    target = -solve_triangular(root, gradient, lower=True)
    return np.asarray(lsq_linear(root.T, target, bounds=(np.minimum(low - x, 0.0), np.maximum(high - x, 0.0))).x)


def _updated(state: State, other: State) -> Array:
    """The Jacobian at another state, by what the residuals did on the way."""
    step = other.x - state.x
    assert state.jacobian is not None
    missed = other.found.residual - state.found.residual - state.jacobian @ step
    usable = state.kept & other.kept & np.isfinite(missed)
    return np.asarray(state.jacobian + np.outer(np.where(usable, missed, 0.0), step / (step @ step)))

"""Heights of measured points over the model's surface, without weights: how likely a place is, and where to go.

Calibration gives less weight to frames that it misses, which is how an effect would hide. Here every judged point
counts alike but for strays. Points of one frame share the model's error: each half second of a trial counts as MODES
observations, whose deviation is fitted along (the loss is n/2 log of the mean square).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import ForwardModel
from studies.calibration.clouds import Match, Motion, Sample, derivatives, frames_of, match
from studies.calibration.normal import BLOCK, MODES
from studies.tracing.vector import Array, Vector

STRAY = 5.0  # times the frame's robust deviation
LARGEST = 0.020  # m: a residual farther off counts as this far, and says nothing of where to go
STEP = 0.4  # prior standard deviations, of a difference: far over the noise of two motions
LITTLE = 2.0  # of log likelihood: a step that gains less is the last, too
CREEP = 0.02  # of the residuals' RMS: and one that gains less, as in calibration
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

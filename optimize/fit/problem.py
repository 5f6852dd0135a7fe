"""Problems of a fit: the residuals of a forward model at some unknowns, and how they change with each unknown."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isqrt

import numpy as np

from fabdesign.geometry.shape import Sheet, sheets_of
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.forward import Case, ForwardModel, Term
from fabdesign.nouns.trial import Accuracy, Trial
from fabdesign.runtime.fingerprint import sha256
from optimize.fit.clouds import Match, Sample, derivatives, match, nodes_of
from optimize.fit.misfit import ROWS, Misfit, frames_of
from optimize.fit.parameters import DECLARED, FitVector

AT_ONCE = 192  # motions in memory


@dataclass(frozen=True, eq=False)
class InputErrors:
    """Changes of the residuals by errors of the inputs at a state. columns: (N, k) m, by a standard deviation of each
    input. bent: (N,) m RMS of the point's frame, what errors to either side do that is not proportional: where they
    lead to another shape, that is all there is."""

    columns: Array
    bent: Array


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The residuals at the unknowns x (p,), and the model's motions or shapes, one a sample; none of a bench."""

    x: Array
    misfit: Misfit
    sheets: Sequence[Sheet]


@dataclass(frozen=True, eq=False)
class Linearisation(Evaluation):
    """An evaluation with the residuals' Jacobian (N, p) m."""

    jacobian: Array

    def after(self, step: Array) -> Evaluation:
        """Return what a step (p,) leads to where the residuals are linear."""
        misfit = replace(self.misfit, residual=self.misfit.residual + self.jacobian @ step)
        return Evaluation(self.x + step, misfit, self.sheets)


def fingerprint(vector: FitVector, samples: Sequence[Sample]) -> str:
    """Return a short hash of the unknowns and the trials of a fit, by which it is kept: which there are may hang on a
    rounding, or on what a fit before says of a trial."""
    trials = [(sample.trial.name, sample.trial.design_name, sample.trial.order) for sample in samples]
    return sha256(repr((vector.names, trials)))[:8]


class Problem:
    """Residuals at some unknowns, columns by them, their priors, and how good the inputs are: all that a fit asks for.
    Motions, frames in balance and records of a bench are problems beside one another."""

    samples: Sequence[Sample]
    vector: FitVector
    expected: float = np.inf  # m RMS that a right model leaves at most; infinite where that is not known

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        """Return the residuals at each of the unknowns, all in one batch."""
        raise NotImplementedError

    def changes(self, evaluation: Evaluation, rows: Array) -> Array:
        """Return the change (N, k) of each residual by k steps (k, p) of the unknowns."""
        raise NotImplementedError

    def input_errors(self, evaluation: Evaluation) -> InputErrors | None:
        """Return what errors of the inputs do; None where they are exact."""
        return None

    @property
    def idle(self) -> Array:
        """Return (k, p) unit directions of the unknowns, at right angles, along which nothing changes."""
        return np.zeros((0, len(self.vector.parameters)))

    def moving(self, rows: Array) -> Array:
        """Return (..., p) steps, or slopes, less what of them is along the idle directions."""
        return np.asarray(rows - (rows @ self.idle.T) @ self.idle)

    def linearise(
        self, evaluation: Evaluation, along: Array, old: Array | None = None, fresh: Indices | None = None
    ) -> Linearisation:
        """Return the evaluation with its Jacobian by differences along the rows of `along` (p, p), within limits.
        fresh: the columns made; others stay as in `old` (N, p), and no row of `along` mixes both. Priors alone decide
        how far to go along an idle direction, not the noise of differences."""
        chosen = np.arange(len(along)) if fresh is None else fresh
        rows = self.vector.steps(evaluation.x, along)[chosen]
        columns = self.changes(evaluation, rows) @ np.linalg.inv(rows[:, chosen]).T
        jacobian = np.empty((len(columns), len(along))) if old is None else old.copy()
        jacobian[:, chosen] = columns
        return self.with_jacobian(evaluation, self.moving(jacobian))

    def with_jacobian(self, evaluation: Evaluation, jacobian: Array) -> Linearisation:
        return Linearisation(evaluation.x, evaluation.misfit, evaluation.sheets, jacobian)


@dataclass(frozen=True, eq=False)
class BenchProblem(Problem):
    """Records of a bench, whose forward is their specimen's law. residuals(x): (N,) in the output's unit, law less
    measured; record, block: (N,) of each row, and which rows share the law's error."""

    residuals: Callable[[Array], Array]
    record: Indices
    block: Indices
    vector: FitVector
    samples: Sequence[Sample] = ()

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        """Return the law's residuals at each of the unknowns."""
        frame = np.zeros(len(self.record), dtype=np.intp)
        return [Evaluation(x, Misfit(self.residuals(x), self.record, frame, self.block, loss=ROWS), ()) for x in xs]

    def changes(self, evaluation: Evaluation, rows: Array) -> Array:
        moved = [self.residuals(evaluation.x + row) - evaluation.misfit.residual for row in rows]
        return np.array(moved).reshape(len(rows), -1).T


@dataclass(frozen=True, eq=False)
class FitProblem(Problem):
    """Motions: the samples, the unknowns, and the engines that make motions and differences of them, `slopes` often a
    cheaper one. accuracy: of the inputs; None: they are exact."""

    samples: Sequence[Sample]
    forward: ForwardModel
    slopes: ForwardModel
    vector: FitVector = DECLARED
    accuracy: Accuracy | None = None
    expected: float = np.inf

    @cached_property
    def idle(self) -> Array:
        """Return a factor up, and every choice of an effect that adds up to it down as much."""
        channels = max(sample.trial.design.channels for sample in self.samples)
        return self.vector.idle(channels)

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        """Return the residuals at each of the unknowns, all in one batch."""
        count = len(self.samples)
        cases = [self.vector.case(s.trial, x) for x in xs for s in self.samples]
        motions = sheets_of(self.forward)(cases, len(xs) * self._times)
        parts = [motions[k : k + count] for k in range(0, len(motions), count)]
        return [
            Evaluation(x, match(self.samples, [sheet.points for sheet in part]), part)
            for x, part in zip(xs, parts, strict=True)
        ]

    def changes(self, evaluation: Evaluation, rows: Array) -> Array:
        others = [[self.vector.case(s.trial, evaluation.x + row) for s in self.samples] for row in rows]
        return self.differences(evaluation, others)

    def differences(self, evaluation: Evaluation, others: Sequence[Sequence[Case]]) -> Array:
        """Return the change of each residual, (N, k) m, from the evaluation's motions to k times a case a sample, by
        how the mid-surface moves."""
        base, match, count, parts = evaluation.sheets, evaluation.misfit, len(self.samples), []
        assert isinstance(match, Match)
        face = isqrt(base[0].points.shape[1] // 2)
        if self.slopes != self.forward:
            others = [[self.vector.case(s.trial, evaluation.x) for s in self.samples], *others]
            base = ()
        at_once = max(2, AT_ONCE // count)  # the place itself and a column
        for first in range(0, len(others), at_once):
            some = others[first : first + at_once]
            moved = sheets_of(self.slopes)([case for row in some for case in row], len(some) * self._times)
            if not base:
                base, moved = moved[:count], moved[count:]
            changes = [
                np.array([other.middle - sheet.middle for other in moved[s::count]]) for s, sheet in enumerate(base)
            ]
            parts.append(derivatives(match, nodes_of(match, base[0].middle.shape[1], face), changes))
        return np.concatenate(parts, axis=1)

    def input_errors(self, evaluation: Evaluation) -> InputErrors | None:
        """Return them by a motion for each channel and each axis of the tilt, and two sides of two patterns of signs of
        all inputs together, which say what is not proportional."""
        if self.accuracy is None:
            return None
        count = max(s.trial.program.pressure.shape[1] for s in self.samples) + 2
        one, other = np.random.default_rng(0).choice([-1.0, 1.0], (2, count))
        rows = np.concatenate([np.eye(count), [one, -one, other, -other]])
        changed = self.differences(
            evaluation, [[self._off(s.trial, evaluation.x, row) for s in self.samples] for row in rows]
        )
        ends = changed[:, count:].reshape(len(changed), 2, 2)
        bent = np.sqrt(np.square(0.5 * ends.sum(axis=2)).mean(axis=1))
        frame, groups = frames_of(evaluation.misfit)
        by_frame = np.array([np.sqrt(np.square(bent[points]).mean()) for points in groups])
        return InputErrors(changed[:, :count], by_frame[frame])

    def _off(self, trial: Trial, x: Array, deviations: Array) -> Case:
        """Return a case off by deviations (channels + 2,), in standard ones: of pressures, then tilt about x and z."""
        assert self.accuracy is not None
        case = self.vector.case(trial, x)
        pressure = case.program.pressure
        changed = pressure * (1 + self.accuracy.pressure * deviations[: pressure.shape[1]])
        program = replace(case.program, pressure=changed)
        if not deviations[-2:].any():
            return replace(case, program=program)
        about_x, about_z = (self.accuracy.tilt * deviations[-2:]).tolist()
        level = Term("frame_tilt", {"about_x": about_x, "about_z": about_z})
        return replace(case, program=program, effects=(*case.effects, level))

    @property
    def _times(self) -> list[Array]:
        """Return the times of each sample, s."""
        return [sample.times for sample in self.samples]


def widened(jacobian: Array, at: Indices | Sequence[int], count: int) -> Array:
    """Return a Jacobian (N, count) m with columns (N, k) at their places `at` (k,), NaN for those still to make."""
    wide = np.full((len(jacobian), count), np.nan)
    wide[:, at] = jacobian
    return wide

"""What is measured beside what a forward says at some unknowns, and how that changes with each unknown."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isqrt
from typing import ClassVar

import numpy as np

from fabdesign.geometry.sheet import Sheet, sheets_of
from fabdesign.nouns.forward import Case, ForwardModel
from optimize.fit.clouds import Array, Indices, Match, Motion, Sample, derivatives, match, nodes_of
from optimize.fit.parameters import DECLARED, FitVector

_AT_ONCE = 192  # motions in memory


@dataclass(frozen=True, eq=False)
class Evaluation:
    x: Array  # (p,) the unknowns
    sheets: Sequence[Sheet]  # a sample; none of a bench
    found: Match


@dataclass(frozen=True, eq=False)
class Linearisation(Evaluation):
    jacobian: Array  # (N, p) m


class Problem:
    """What a descent asks of trials and of a bench alike."""

    samples: Sequence[Sample]
    vector: FitVector
    lengths: ClassVar[tuple[float, ...]] = (1.0, 0.5, 2.0, 0.25)  # of a step, tried at once: lanes that are empty else

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        """All in one batch."""
        raise NotImplementedError

    def changes(self, evaluation: Evaluation, rows: Array) -> Array:
        """(N, k): of each residual by k steps (k, p) of the unknowns."""
        raise NotImplementedError

    @property
    def idle(self) -> Array:
        """(k, p) unit directions of the unknowns, at right angles, along which nothing changes."""
        return np.zeros((0, len(self.vector.parameters)))

    def moving(self, rows: Array) -> Array:
        """(..., p) steps, or slopes, less what of them is along the idle directions."""
        return np.asarray(rows - (rows @ self.idle.T) @ self.idle)

    def linearise(
        self, evaluation: Evaluation, along: Array, old: Array | None = None, fresh: Indices | None = None
    ) -> Linearisation:
        """With the Jacobian by differences along the rows of `along` (p, p), within limits. fresh: the columns that are
        made; the others stay as in `old` (N, p), and no row of `along` mixes both. Their noise would tell how far to go
        along an idle direction; priors alone do."""
        chosen = np.arange(len(along)) if fresh is None else fresh
        rows = self.vector.steps(evaluation.x, along)[chosen]
        columns = self.changes(evaluation, rows) @ np.linalg.inv(rows[:, chosen]).T
        jacobian = np.empty((len(columns), len(along))) if old is None else old.copy()
        jacobian[:, chosen] = columns
        return self.with_jacobian(evaluation, self.moving(jacobian))

    def with_jacobian(self, evaluation: Evaluation, jacobian: Array) -> Linearisation:
        return Linearisation(evaluation.x, evaluation.sheets, evaluation.found, jacobian)


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
        return [Evaluation(x, (), Match.of_rows(self.residuals(x), self.record, self.block)) for x in xs]

    def changes(self, evaluation: Evaluation, rows: Array) -> Array:
        moved = [self.residuals(evaluation.x + row) - evaluation.found.residual for row in rows]
        return np.array(moved).reshape(len(rows), -1).T


@dataclass(frozen=True, eq=False)
class FitProblem(Problem):
    """The samples, the unknowns, and the engines that make motions and differences of them."""

    samples: Sequence[Sample]
    forward: ForwardModel
    slopes: ForwardModel
    vector: FitVector = DECLARED

    @cached_property
    def idle(self) -> Array:
        """A factor up, and every choice of an effect that adds up to it down as much."""
        channels = max(sample.trial.design.channels for sample in self.samples)
        return self.vector.idle(channels)

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        """All in one batch."""
        count = len(self.samples)
        cases = [self.vector.case(s.trial, x) for x in xs for s in self.samples]
        motions = sheets_of(self.forward)(cases, len(xs) * self._times)
        parts = [motions[k : k + count] for k in range(0, len(motions), count)]
        return [
            Evaluation(x, own, match(self.samples, [sheet.points for sheet in own]))
            for x, own in zip(xs, parts, strict=True)
        ]

    def changes(self, evaluation: Evaluation, rows: Array) -> Array:
        others = [[self.vector.case(s.trial, evaluation.x + row) for s in self.samples] for row in rows]
        return self.differences(evaluation, others)

    def differences(self, evaluation: Evaluation, others: Sequence[Sequence[Case]]) -> Array:
        """(N, k) m: change of each residual from the evaluation's motions to those of k times a case a sample."""
        parts = [columns(evaluation, moved) for moved in self.displacements(evaluation, others)]
        return np.concatenate(parts, axis=1)

    def displacements(self, evaluation: Evaluation, others: Sequence[Sequence[Case]]) -> Iterator[list[Motion]]:
        """Some of the k after others: (some, F, n, n, 3) m a sample, what the mid-surface does from the evaluation's
        motions to those of k times a case a sample."""
        if self.slopes == self.forward:
            base = evaluation.sheets
        else:
            cases = [self.vector.case(s.trial, evaluation.x) for s in self.samples]
            base = sheets_of(self.slopes)(cases, self._times)
        at_once = max(1, _AT_ONCE // len(self.samples))
        for first in range(0, len(others), at_once):
            some = others[first : first + at_once]
            moved = sheets_of(self.slopes)([case for row in some for case in row], len(some) * self._times)
            yield [
                np.stack([moved[k * len(base) + s].middle - sheet.middle for k in range(len(some))])
                for s, sheet in enumerate(base)
            ]

    @property
    def _times(self) -> list[Array]:
        """s, of each sample."""
        return [sample.times for sample in self.samples]


def widened(jacobian: Array, at: Indices | Sequence[int], count: int) -> Array:
    """(N, count) m: the columns of a Jacobian (N, k) at their places `at` (k,), NaN for those still to make."""
    wide = np.full((len(jacobian), count), np.nan)
    wide[:, at] = jacobian
    return wide


def columns(evaluation: Evaluation, changes: Sequence[Motion]) -> Array:
    """(N, k) m: change of each residual by changes (k, F, n, n, 3) m of the mid-surface, a sample each."""
    face = isqrt(evaluation.sheets[0].points.shape[1] // 2)
    return derivatives(evaluation.found, nodes_of(evaluation.found, changes[0].shape[2], face), changes)

"""Motions at some factors beside the measured points, and how they change with each factor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.forward import ForwardModel
from studies.calibration.clouds import Array, Match, Motion, Sample, derivatives, match
from studies.calibration.parameters import DECLARED, FitVector


@dataclass(frozen=True, eq=False)
class Evaluation:
    x: Array  # (p,) the unknowns
    motions: list[Motion]  # (F, 2 n, 3) m a sample
    found: Match


@dataclass(frozen=True, eq=False)
class Linearisation(Evaluation):
    changes: list[Motion]  # (p, F, 2 n, 3) m a sample, of the vertices by each unknown
    jacobian: Array  # (N, p) m


@dataclass(frozen=True, eq=False)
class Problem:
    """The samples, and the engines that make motions and differences of them."""

    samples: Sequence[Sample]
    forward: ForwardModel
    slopes: ForwardModel
    vector: FitVector = DECLARED

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        """All in one batch."""
        motions = self._motions(self.forward, xs)
        return [Evaluation(x, each, match(self.samples, each)) for x, each in zip(xs, motions, strict=True)]

    def changes(self, evaluation: Evaluation, along: Array) -> list[Motion]:
        """(p, F, 2 n, 3) m a sample, by each unknown: differences along the rows of `along` (p, p), within limits."""
        along = self.vector.steps(evaluation.x, along)
        others = [evaluation.x + row for row in along]
        if self.slopes == self.forward:
            base, moved = evaluation.motions, self._motions(self.slopes, others)
        else:
            base, *moved = self._motions(self.slopes, [evaluation.x, *others])
        differences = [np.stack([other[s] - base[s] for other in moved]) for s in range(len(self.samples))]
        return [np.tensordot(np.linalg.inv(along), difference, axes=1) for difference in differences]

    def linearise(self, evaluation: Evaluation, changes: list[Motion]) -> Linearisation:
        return Linearisation(
            evaluation.x, evaluation.motions, evaluation.found, changes, derivatives(evaluation.found, changes)
        )

    def _motions(self, forward: ForwardModel, xs: Sequence[Array]) -> list[list[Motion]]:
        """Of every x, a motion a sample; all in one batch."""
        cases = [self.vector.case(s.trial, x) for x in xs for s in self.samples]
        motions = forward.motions(cases, [s.times for _ in xs for s in self.samples])
        return [list(motions[k : k + len(self.samples)]) for k in range(0, len(motions), len(self.samples))]

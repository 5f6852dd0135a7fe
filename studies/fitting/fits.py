"""How a study fits models to what was measured: by which engines, how precisely, where fits are kept, who is told."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.nouns.forward import ForwardModel
from fabdesign.runtime.store import Checkpoint
from optimize.fit.descent import FitStart, Progress, fit, parts, silent
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitVector
from optimize.fit.policy import NEAR, Policy
from optimize.fit.problem import FitProblem
from studies.fitting.intervals import expected_rms
from studies.measured.fit_data import MeasuredData


@dataclass(frozen=True, eq=False)
class Fits:
    """How fits are made. tolerance: m of excess that a right model may leave. slopes: a cheaper engine, for first steps
    and derivatives. progress_of: the progress of the fit of a name and a vector. named: before the names of fits in the
    checkpoint. last: the policy of the last of several fits. patient: whether a joint fit begins again wherever a
    horizon leaves more than a right model, not the first alone where that is far more."""

    forward: ForwardModel
    tolerance: float
    slopes: ForwardModel | None = None
    checkpoint: Checkpoint | None = None
    progress_of: Callable[[str, FitVector], Progress] = lambda named, vector: silent
    named: str = ""
    last: Callable[[FitVector], Policy] = lambda vector: NEAR
    patient: bool = False

    @property
    def coarse(self) -> "Fits":
        """Return the same by the cheaper engine alone."""
        return replace(self, forward=self.slopes or self.forward)

    def within(self, begin: float, end: float) -> "Fits":
        """Return the same as a part of the work, by the shares of it at which it begins and ends."""
        return replace(self, progress_of=lambda named, vector: parts(self.progress_of(named, vector), begin, end)[1])

    def problem(self, data: MeasuredData, vector: FitVector, expected: float | None = None) -> FitProblem:
        """Return the motions of some data. expected: m RMS that a right model leaves at most; None: without any effect
        what the tolerance allows, while effects that begin at nothing leave much before they are found."""
        if expected is None:
            expected = np.inf if vector.terms else expected_rms(data.noise, self.tolerance)
        return FitProblem(data.samples, self.forward, self.slopes or self.forward, vector, data.weighed, expected)

    def fit(self, problem: FitProblem, start: FitStart, policy: Policy, named: str = "") -> Fit:
        """Return the fit of a name, kept or computed."""
        named = f"{self.named} {named}".strip()
        progress = self.progress_of(named, problem.vector)
        return fit(problem, start, policy, named=named, checkpoint=self.checkpoint, progress=progress)

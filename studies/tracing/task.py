"""The data and fits of a trace. Fits are kept in its folder, so that one that was killed goes on with the next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.geometry.shape import sheets_of
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.store import Checkpoint
from optimize.fit.descent import FitStart, Progress, begun
from optimize.fit.fitted import Fit, concluded, kept
from optimize.fit.parameters import FitVector
from optimize.fit.policy import END, STEP, Policy
from optimize.fit.problem import FitProblem, InputErrors
from studies.fitting.fits import Fits
from studies.measured.fit_data import MeasuredData

FAR = 0.020  # m: a point that is farther off counts as this far
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Place:
    """A vector and where in it the model is."""

    vector: FitVector
    x: Array


@dataclass(frozen=True, eq=False)
class Task:
    """The data and model of a trace. factors: where they start. known: effects that the model has and keeps as they
    are. elsewhere: trials of layouts that none of the fitted has, for their designs and pressures, not their clouds."""

    data: MeasuredData
    forward: ForwardModel
    tolerance: float  # m of excess
    factors: dict[str, float]
    known: Sequence[str]
    checkpoint: Checkpoint
    say: Say
    elsewhere: Sequence[Trial] = ()

    @property
    def floor(self) -> float:
        """Return the RMS of the noise in the residuals, m."""
        return self.data.noise.sigma

    @property
    def designs(self) -> list[Design]:
        """Return the designs of the trials fitted."""
        return [trial.design for trial in self.data.trials]

    def differs_elsewhere(self, one: Place, other: Place) -> float:
        """Return the RMS distance of two models' motions, m, on the layout of `elsewhere` where it is most, or 0."""
        times = [trial.times for trial in self.elsewhere]
        cases = [place.vector.case(trial, place.x) for place in (one, other) for trial in self.elsewhere]
        sheets = sheets_of(self.forward)(cases, [*times, *times])
        squares: dict[str, list[float]] = {}
        for trial, a, b in zip(self.elsewhere, sheets, sheets[len(times) :], strict=False):
            apart = np.linalg.norm(a.middle - b.middle, axis=-1)
            squares.setdefault(trial.design_name, []).append(float(np.square(np.fmin(apart, FAR)).mean()))
        return max((float(np.sqrt(np.mean(means))) for means in squares.values()), default=0.0)

    def matters_elsewhere(self, one: Place, other: Place) -> bool:
        """Return whether two models differ on other layouts by the tolerance."""
        return self.differs_elsewhere(one, other) >= self.tolerance

    @property
    def fits(self) -> Fits:
        """Return how its fits are made."""
        return Fits(
            self.forward, self.tolerance, checkpoint=self.checkpoint, progress_of=self._progress_of, patient=True
        )

    def _progress_of(self, named: str, vector: FitVector) -> Progress:
        begin = f"{named}, {len(vector.parameters)} unknowns: " if named else ""
        return lambda line, share: self.say(begin + line)

    def fit(self, named: str, vector: FitVector, start: FitStart, policy: Policy = END) -> Fit:
        """Fit as `optimize.fit.descent.fit` does. named: in the folder and in messages."""
        return self.fits.fit(self.problem(vector), start, policy, named)

    def input_errors(self, vector: FitVector, x: Array) -> InputErrors | None:
        """Return what errors of the inputs do to the trials fitted, at the unknowns x (p,) of a vector; None where the
        inputs are exact. Kept."""
        if self.data.weighed is None:
            return None
        problem = self.problem(vector)
        self.say("what errors of the pressures and of the frame's level do")
        return InputErrors(
            **self.checkpoint.arrays("inputs", lambda: vars(problem.input_errors(problem.evaluate([x])[0])))
        )

    def nearest(self, vector: FitVector, xs: Sequence[Array]) -> tuple[float, Array]:
        """Return the RMS of the residuals capped at 10 mm, m, and the place of `xs` where that is least."""
        best = min(self.problem(vector).evaluate(xs), key=lambda one: one.misfit.rms)
        return best.misfit.rms, best.x

    def linearised(self, named: str, vector: FitVector, start: FitStart) -> Fit:
        """Return a fit that ends where it begins, with missing columns of the Jacobian by differences."""
        x, problem = start.x, self.problem(vector)
        assert x is not None

        def there() -> Fit:
            self.say(f"{named}, {len(vector.parameters)} unknowns, to first order")
            state = begun(problem, problem.evaluate([x])[0], np.diag(STEP * vector.scale), start.jacobian)
            return concluded(problem, state, start.inputs, state.misfit.rms, 0, "converged")

        return kept(self.checkpoint, named, problem, start.inputs, there)

    def weighed(self, known: Fit, inputs: InputErrors | None) -> Fit:
        """Return a fit as it ended with `inputs` of another, so that models are compared by the same weights."""
        return concluded(self.problem(known.vector), known.state, inputs, known.before, known.iterations, known.ended)

    def problem(self, vector: FitVector) -> FitProblem:
        """Return the motions of the trials fitted."""
        return self.fits.problem(self.data, vector)

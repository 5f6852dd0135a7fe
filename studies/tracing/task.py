"""What a trace fits, and its fits, which stand in its folder: one that was killed goes on with the next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.geometry.sheet import sheets_of
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.store import Checkpoint
from optimize.fit.clouds import Array
from optimize.fit.descent import STEP, begun, fit
from optimize.fit.fitted import Fit, capped, concluded, kept
from optimize.fit.inputs import InputErrors
from optimize.fit.parameters import FitVector
from optimize.fit.problem import FitProblem
from studies.calibration.intervals import expected_rms
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
    """What is fitted. factors: where they start. known: effects that the model has and that stay as they are.
    elsewhere: trials of layouts that none of the fitted has, for their designs and pressures, not for their clouds."""

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
        """m, RMS of the noise in the residuals."""
        return self.data.noise.sigma

    @property
    def designs(self) -> list[Design]:
        """Of the trials fitted."""
        return [trial.design for trial in self.data.trials]

    def differs_elsewhere(self, one: Place, other: Place) -> float:
        """m, RMS between the motions of two models, on the layout of `elsewhere` where it is most; 0 without any."""
        times = [trial.times for trial in self.elsewhere]
        cases = [place.vector.case(trial, place.x) for place in (one, other) for trial in self.elsewhere]
        sheets = sheets_of(self.forward)(cases, [*times, *times])
        squares: dict[str, list[float]] = {}
        for trial, a, b in zip(self.elsewhere, sheets, sheets[len(times) :], strict=False):
            apart = np.linalg.norm(a.middle - b.middle, axis=-1)
            squares.setdefault(trial.design_name, []).append(float(np.square(np.fmin(apart, FAR)).mean()))
        return max((float(np.sqrt(np.mean(own))) for own in squares.values()), default=0.0)

    def matters_elsewhere(self, one: Place, other: Place) -> bool:
        """Whether two models differ on other layouts by the tolerance."""
        return self.differs_elsewhere(one, other) >= self.tolerance

    def fit(
        self,
        named: str,
        vector: FitVector,
        inputs: InputErrors | None = None,
        start: Array | None = None,
        *,
        close: float | None = None,
        near: bool = False,
        sure: bool = True,
        expected: float | None = None,
        hopeless: float = np.inf,
        jacobian: Array | None = None,
    ) -> Fit:
        """As `optimize.fit.descent.fit`. named: in the folder and in what is said. inputs: what errors of them do,
        where that is known. expected: by default, one without any effect is not refined where it leaves far more than
        a right model."""
        if expected is None:
            expected = np.inf if vector.terms else expected_rms(self.data.noise, self.tolerance)
        return self._kept(
            named,
            vector,
            inputs,
            lambda: fit(
                self.data.samples,
                self.forward,
                vector=vector,
                accuracy=inputs or self.data.weighed,
                start=start,
                close=close,
                near=near,
                sure=sure,
                jacobian=jacobian,
                expected=expected,
                hopeless=hopeless,
                progress=lambda line, share: self.say(f"{named}, {len(vector.parameters)} unknowns: {line}"),
            ),
        )

    def nearest(self, vector: FitVector, xs: Sequence[Array]) -> tuple[float, Array]:
        """m RMS of the residuals capped at 10 mm, and the place of `xs` where that is least."""
        found = self._problem(vector).evaluate(xs)
        best = min(found, key=lambda one: capped(one.found.residual))
        return capped(best.found.residual), best.x

    def linearised(
        self,
        named: str,
        vector: FitVector,
        x: Array,
        inputs: InputErrors | None,
        jacobian: Array | None = None,
    ) -> Fit:
        """A fit that ends where it begins, with a Jacobian by differences; of `jacobian` (N, p) the columns of NaN are
        made."""

        def there() -> Fit:
            self.say(f"{named}, {len(vector.parameters)} unknowns, to first order")
            problem = self._problem(vector)
            state = begun(problem, problem.evaluate([x])[0], np.diag(STEP * vector.scale), jacobian)
            return concluded(problem, state, inputs, capped(state.found.residual), 0, True)

        return self._kept(named, vector, inputs, there)

    def weighed(self, known: Fit, inputs: InputErrors | None) -> Fit:
        """A fit as it ended, with what errors of the inputs do elsewhere: models are compared by the same weights."""
        problem = self._problem(known.vector)
        return concluded(problem, known.state, inputs, known.before, known.iterations, known.converged)

    def _problem(self, vector: FitVector) -> FitProblem:
        return FitProblem(self.data.samples, self.forward, self.forward, vector)

    def _kept(self, named: str, vector: FitVector, inputs: InputErrors | None, compute: Callable[[], Fit]) -> Fit:
        return kept(self.checkpoint, named, self._problem(vector), compute, inputs)

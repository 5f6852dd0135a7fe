"""What a trace fits, and its fits, which stand in its folder: one that was killed goes on with the next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.checkpoint import Arrays, Checkpoint
from fabdesign.forward import ForwardModel
from optimize.fit.clouds import Array
from optimize.fit.descent import CLOSE, fit
from optimize.fit.fitted import Fit, concluded
from optimize.fit.inputs import InputErrors
from optimize.fit.parameters import FitVector
from optimize.fit.problem import FitProblem
from studies.measured_data import MeasuredData

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """What is fitted. start: of the factors. known: effects that the model has and that stay as they are."""

    data: MeasuredData
    forward: ForwardModel
    tolerance: float  # m of excess
    factors: dict[str, float]
    known: Sequence[str]
    scope: str | None  # of the muscles' effects
    checkpoint: Checkpoint
    say: Say

    @property
    def floor(self) -> float:
        """m, RMS of the noise in the residuals."""
        return self.data.noise.sigma

    @property
    def channels(self) -> int:
        return max(trial.design.channels for trial in self.data.trials)

    def fit(
        self,
        named: str,
        vector: FitVector,
        inputs: InputErrors | None = None,
        start: Array | None = None,
        *,
        close: float = CLOSE,
        near: bool = False,
    ) -> Fit:
        """As `optimize.fit.descent.fit`. Where it ended and its Jacobian are kept; the motions there are made again.
        named: in the folder and in what is said. inputs: what errors of them do, where that is known."""
        problem = FitProblem(self.data.samples, self.forward, self.forward, vector)
        fresh: list[Fit] = []

        def compute() -> Arrays:
            found = fit(
                self.data.samples,
                self.forward,
                vector=vector,
                accuracy=inputs or self.data.weighed,
                start=start,
                close=close,
                near=near,
                progress=lambda line, share: self.say(f"{named}, {len(vector.parameters)} unknowns: {line}"),
            )
            fresh.append(found)
            own = {} if inputs is not None or found.inputs is None else vars(found.inputs)
            told = np.array([found.before, found.iterations, found.converged], dtype=float)
            return {"x": found.x, "jacobian": found.state.jacobian, "told": told, **own}

        kept = self.checkpoint.arrays(f"fit_{_file_name(named)}", compute)
        if fresh:
            return fresh[0]
        if inputs is None and "columns" in kept:
            inputs = InputErrors(kept["columns"], kept["bent"])
        state = problem.with_jacobian(problem.evaluate([kept["x"]])[0], kept["jacobian"])
        before, iterations, converged = kept["told"].tolist()
        return concluded(problem, state, inputs, before, int(iterations), bool(converged))


def _file_name(named: str) -> str:
    return "".join(c if c.isalnum() or c == "_" else "-" for c in named)

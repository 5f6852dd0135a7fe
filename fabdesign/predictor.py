"""The one forward model: a simulator with all that a model adds, its factors, effects, corrector and sensing."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import observed, seen_at
from fabdesign.forward import Case, ForwardModel
from fabdesign.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Predictor:
    """A simulator that knows what was fitted. Implements fabdesign.forward.ForwardModel.

    A case's own factors go before the model's, its own effects act after the model's. sensing: whether what the model
    says of clocks and sensors is in the points, as in `predict`, or not, as in `simulate`.
    """

    simulator: ForwardModel
    model: Model = field(default_factory=Model)
    sensing: bool = False

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        """(T, 3362, 3) points [m] of each case at its `times` [s after rest, rising]. Raises InputError for an unknown
        effect or a bad value."""
        own = [self.case(case) for case in cases]
        if not self.sensing:
            return self.simulator.motions(own, times)
        shown = [seen_at(case.effects, np.asarray(t, dtype=float)) for case, t in zip(own, times, strict=True)]
        motions = self.simulator.motions(own, shown)
        return [observed(case.effects, points) for case, points in zip(own, motions, strict=True)]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """(3362, 3) points [m] of each case at rest, as `motions` gives them."""
        own = [self.case(case) for case in cases]
        shapes = self.simulator.equilibria(own)
        if not self.sensing:
            return shapes
        return [observed(case.effects, points) for case, points in zip(own, shapes, strict=True)]

    def case(self, case: Case) -> Case:
        """The case with what the model adds."""
        factors = {**self.model.factors, **case.factors}
        return replace(case, factors=factors, effects=(*self.model.terms, *case.effects))

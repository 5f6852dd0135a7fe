"""A simulator whose muscles' contractions and tensions are kept beside its shapes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import Case, ForwardModel


def knows_muscles(forward: ForwardModel) -> bool:
    """Whether it gives more than shapes, as `sim.Simulator` does."""
    return hasattr(forward, "run") and hasattr(forward, "rest")


class WithMuscleStates:
    """A fabdesign.forward.ForwardModel; `last`: the motions of the last call, each a `SimulatedMotion` with time (T,)
    s, contraction and tension (T, intervals) N. `simulator`: one that `knows_muscles`."""

    def __init__(self, simulator: ForwardModel) -> None:
        self._simulator: Any = simulator
        self.last: list[Any] = []

    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        self.last = self._simulator.run(cases, times)
        return [motion.points for motion in self.last]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.last = self._simulator.rest(cases)
        return [shape.points[0] for shape in self.last]

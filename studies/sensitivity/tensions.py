"""A simulator whose muscles' tensions are kept beside its shapes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.forward import Case, ForwardModel


class WithTensions:
    """A fabdesign.forward.ForwardModel; `last`: (T, intervals) N of each case of the last call.

    Raises InputError for a forward model that knows no tensions.
    """

    def __init__(self, simulator: ForwardModel) -> None:
        if not hasattr(simulator, "run") or not hasattr(simulator, "rest"):
            raise InputError(f"largest_tension: {type(simulator).__name__} knows no tensions; expected the simulator")
        self._simulator: Any = simulator
        self.last: list[NDArray[np.float32]] = []

    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        found = self._simulator.run(cases, times)
        self.last = [motion.tension for motion in found]
        return [motion.points for motion in found]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        found = self._simulator.rest(cases)
        self.last = [shape.tension for shape in found]
        return [shape.points[0] for shape in found]

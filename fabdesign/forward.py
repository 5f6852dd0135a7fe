"""The forward model: the one protocol in which simulator, corrector and search meet. Always a batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.pressure import PressureProgram

SIDE = 41  # points a side of each face
PARAMETERS = ("membrane", "shear", "bending", "areal_density", "damping", "muscle_gain", "axis_offset")
FACTORS = 0.001, 1000.0  # what a factor on a declared value may be: beyond, the declared value is another thing's


@dataclass(frozen=True)
class Case:
    """One motion to predict. `factors` multiply the declared values, by the names in PARAMETERS."""

    design: Design
    program: PressureProgram
    factors: Mapping[str, float] = field(default_factory=dict)


class ForwardModel(Protocol):
    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        """(T, 2 n, 3) points [m] of each case at its `times` [s after rest]: front face, then back face,
        each by rising v, then rising u (SIDE x SIDE a face). A diverged case holds NaN from then on."""
        ...

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """(2 n, 3) points [m] at rest under each program's last pressures."""
        ...

"""The forward model: the one protocol in which simulator, corrector and search meet. Always a batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import MUSCLE_TYPES as MUSCLE_TYPES
from fabdesign.nouns.design import Design
from fabdesign.nouns.design import Term as Term
from fabdesign.nouns.pressure import PressureProgram

SIDE = 41  # points a side of each face
PARAMETERS = ("membrane", "shear", "bending", "areal_density", "damping", "muscle_gain", "axis_offset")
OF_MUSCLES = ("muscle_gain", "axis_offset")  # those that belong to a muscle type
FACTOR_RANGE = 0.001, 1000.0  # what a factor on a declared value may be: beyond, the declared value is another thing's


@dataclass(frozen=True)
class Case:
    """One motion to predict.

    factors: on the declared values, by the names in PARAMETERS; those of muscles also as "muscle_types.NAME.PARAMETER".
    effects: in the order in which they act. order: the motion's place in the specimen's session, 0 when rested.
    """

    design: Design
    program: PressureProgram
    factors: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[Term, ...] = ()
    order: int = 0


@dataclass(frozen=True, eq=False)
class Instant:
    """A frame of a motion, of the mid-surface on the simulator's own n x n grid, and displacements from it: to a cloth
    that was seen, and by what sensors may do. time: s after rest. Arrays: (n, n, 3); of displacements (k, n, n, 3)."""

    time: float
    middle: Array  # m
    velocity: Array  # m/s
    acceleration: Array  # m/s^2
    moved: Array  # m, from this frame's mid-surface
    moved_velocity: Array  # m/s, how these change
    moved_acceleration: Array  # m/s^2


class ForwardModel(Protocol):
    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        """Return (T, 2 n, 3) points [m] of each case at its `times` [s after rest]: front face, then back face,
        each by rising v, then rising u (SIDE x SIDE a face). A diverged case holds NaN from then on."""
        ...

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """Return (2 n, 3) points [m] where each case comes to rest after its program's last pressures rose linearly
        within RISE s, with effects that remember held for HOLD s more."""
        ...


RISE = 1.0  # s
HOLD = 10.0  # s

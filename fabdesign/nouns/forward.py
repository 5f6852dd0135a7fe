"""The forward model: the one protocol in which simulator, corrector and search meet, and that of the corrector of its
motions, with the instants that it wants to see. Always a batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array, Floats
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
    pull: Array | float = 0.0  # (n, n, 3) m/s^2, of what leads the motion


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


@dataclass(frozen=True)
class Trust:
    """How far a design is from those a corrector learned from, and how far is too far. No unit."""

    distance: float
    limit: float

    @property
    def applies(self) -> bool:
        return self.distance <= self.limit


class Corrector(Protocol):
    """Corrected motions from simulated ones, in batches."""

    @property
    def ordered(self) -> bool:
        """Return whether the answer keeps the order of the points; an unordered cloud is compared by Chamfer alone."""
        ...

    @property
    def starts(self) -> float:
        """Return s after rest, from which on it corrects; before, the answer is the simulator's."""
        ...

    def history(self) -> tuple[float, ...]:
        """Return the seconds before each frame at which it wants the simulated points too (`with_history`)."""
        ...

    def correct(
        self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]], motions: Sequence[Floats]
    ) -> list[NDArray[np.float32]]:
        """Return (T, 2 n, 3) points [m] of each case at its `times` (T,) [s after rest].

        motions: (U, 2 n, 3) m, simulated, at the instants of `with_history(times, history())`. Where a design is
        beyond the limit of trust, and in frames that hold NaN, the answer is the simulator's, bit by bit.
        """
        ...

    def trust(self, design: Design) -> Trust:
        """Return how far the design is from what was learned."""
        ...


def with_history(times: NDArray[np.float64], history: Sequence[float]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return (U,) s, rising: all of `times` (T,) and those `history` seconds before, rest (0 s) where that is earlier;
    and (1 + H, T) where in them each is, the frames themselves first.

    >>> with_history(np.array([0.1, 0.2]), [0.1])[0].tolist()
    [0.0, 0.1, 0.2]
    """
    wanted = np.maximum(times - np.array([0.0, *history])[:, None], 0.0)
    # to a microsecond: 0.2 - 0.1 is not 0.1; frames stand at their own time, not at a neighbour's
    order = np.rint(wanted * 1e6).astype(np.int64)
    _, first, where = np.unique(order, return_index=True, return_inverse=True)
    return wanted.ravel()[first], where.reshape(wanted.shape)

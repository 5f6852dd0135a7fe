"""The corrector of a simulator's motions: the protocol, and the instants that it wants to see. Numpy only."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Floats
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.runtime.fingerprint import sha256


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


def central_hash(model: Model) -> str:
    """Return the SHA-256 of the central values of a model's parameters and effects; intervals and provenance do not
    count."""
    central = {
        "parameters": {name: repr(float(p.factor)) for name, p in sorted(model.parameters.items())},
        "effects": [
            [effect.name, {name: repr(float(q.value)) for name, q in sorted(effect.parameters.items())}]
            for effect in model.effects
        ],
    }
    return sha256(json.dumps(central, sort_keys=True))

"""The pressures that act in the channels, from a regulator's set points through what lies between."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.pressure import PressureProgram

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ActingPressure:
    """Piecewise constant pressures, and where something has smoothed them, means over ticks.

    program: steps of pressure, whose jumps a simulator follows with short steps. smooth: (ticks, channels) Pa, means
    over ticks of `tick` s each from t = 0 on, the last holding for ever; None where the program itself acts.
    """

    program: PressureProgram
    ticks: int
    tick: float  # s
    smooth: Array | None = None

    @cached_property
    def means(self) -> Array:
        """(ticks, channels) Pa, over every tick."""
        if self.smooth is not None:
            return self.smooth
        return self.between(np.arange(self.ticks + 1))

    def between(self, edges: NDArray[np.int_]) -> Array:
        """Return (n - 1, channels) Pa, means between ticks `edges` (n,), rising; the last tick's holds beyond the
        ticks."""
        if self.smooth is None:
            return self.program.means(np.asarray(self.tick * edges, dtype=np.float64))
        integral = np.concatenate([np.zeros((1, self.smooth.shape[1])), np.cumsum(self.smooth, axis=0)])
        inside = np.minimum(edges, self.ticks)
        total = integral[inside] + (edges - inside)[:, None] * self.smooth[-1]
        return np.asarray(np.diff(total, axis=0) / np.diff(edges)[:, None])

    def through(self, program: PressureProgram, smooth: Array | None) -> "ActingPressure":
        return replace(self, program=program, smooth=smooth)

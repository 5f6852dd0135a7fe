"""A muscle on its bench, as its quasi-static law sees a record: what effects change there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_RATE_WINDOW = 3  # rows on either side of the one whose rate is taken


@dataclass(frozen=True, eq=False)
class MuscleRecord:
    """Rows of one record: the measured tension is law(pressure, contraction - lent) - friction - what damps."""

    time: Array  # (n,) s, rising
    pressure: Array  # (n,) Pa that acts
    contraction: Array  # (n,) as measured
    lent: Array  # (n,) contraction that the law does not see
    friction: Array  # (n,) N, against contraction

    @cached_property
    def rate(self) -> Array:
        """(n,) 1/s, of contraction: slope of the line through the rows around each one, for noise makes neighbours'
        differences useless."""
        half = min(_RATE_WINDOW, (len(self.time) - 1) // 2)
        kernel = np.arange(half, -half - 1, -1.0)
        inner = np.convolve(self.contraction, kernel, "valid") / np.convolve(self.time, kernel, "valid")
        return np.pad(inner, half, mode="edge")

    @staticmethod
    def measured(time: Array, pressure: Array, contraction: Array) -> "MuscleRecord":
        """Return the record as measured, without effects."""
        return MuscleRecord(time, pressure, contraction, np.zeros(len(time)), np.zeros(len(time)))

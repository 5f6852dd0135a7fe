"""A muscle on its bench, as its quasi-static law sees a record: what effects change there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MuscleRecord:
    """Rows of one record: the measured tension is law(pressure, contraction - lent) - friction - what damps."""

    time: Array  # (n,) s, rising
    pressure: Array  # (n,) Pa that acts
    contraction: Array  # (n,) as measured
    lent: Array  # (n,) contraction that the law does not see
    friction: Array  # (n,) N, against contraction

    @staticmethod
    def measured(time: Array, pressure: Array, contraction: Array) -> "MuscleRecord":
        """Without effects."""
        return MuscleRecord(time, pressure, contraction, np.zeros(len(time)), np.zeros(len(time)))

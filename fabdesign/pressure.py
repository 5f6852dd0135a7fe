"""Pressure programs: the regulator's set points over time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PressureProgram:
    """Set points that hold from each row's time to the next row's; the last row holds for ever.

    time (R,) s, rising from 0; pressure (R, channels) Pa, gauge; duration: length of the motion in s.
    """

    time: NDArray[np.float64]
    pressure: NDArray[np.float64]
    duration: float

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, channels) Pa in force just after each of `times` [s]."""
        row = np.searchsorted(self.time, np.asarray(times) + 1e-9, side="right") - 1
        return self.pressure[np.clip(row, 0, None)]

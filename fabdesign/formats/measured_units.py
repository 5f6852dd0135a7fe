"""Measured times and pressures in another unit than the format's: too far off to be anything else."""

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.errors import InputError
from fabdesign.units import in_kpa

# s between frames. 60 Hz in milliseconds is 17 "s"; a creep test that takes a frame every 5 s still passes.
_SLOWEST = 8.0
# Pa. A regulator resolves 100 Pa and a thin muscle does nothing below some 50 kPa; 400 kPa in MPa is 0.4 "kPa".
_LEAST = 1e3
_MOST = 2e7  # Pa, fifty times what a thin McKibben muscle bears: kPa that were pascals are above it


def require_seconds(time: ArrayLike, where: str) -> None:
    """Raise InputError where frames lie so far apart that their times [s] were surely milliseconds."""
    seconds = np.atleast_1d(np.asarray(time, dtype=np.float64))
    if len(seconds) < 2:
        return
    interval = float(np.median(np.diff(seconds)))
    if interval >= _SLOWEST:
        unit = "microseconds" if interval >= 1e3 * _SLOWEST else "milliseconds"
        raise InputError(f"{where}: time has a frame every {interval:.4g} s; expected seconds (is it in {unit}?)")


def require_measured_pressures(pressure: ArrayLike, where: str) -> None:
    """Raise InputError where the largest of measured pressures [Pa] shows that they were not written in kPa."""
    largest = float(np.max(np.asarray(pressure, dtype=np.float64), initial=0.0))
    if 0 < largest <= _LEAST or largest >= _MOST:
        unit = "Pa" if largest >= _MOST else "MPa"
        raise InputError(f"{where}: the largest pressure is {in_kpa(largest):.6g} kPa; expected kPa (is it in {unit}?)")

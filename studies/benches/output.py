"""What a bench measures, row by row, and in which unit."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.bench import BenchRecord, Specimen
from studies.benches.actuator import hold_of
from studies.benches.rows import FORCES


def unit_of(specimen: Specimen) -> str:
    """N, of an actuator m."""
    return "m" if specimen == "actuator" else "N"


def measured(specimen: Specimen, record: BenchRecord) -> NDArray[np.float64]:
    """(n,) N; of an actuator (1,) m, the level held."""
    if specimen == "actuator":
        return np.array([hold_of(record).level])
    return record.columns[next(name for name in FORCES if name in record.columns)]

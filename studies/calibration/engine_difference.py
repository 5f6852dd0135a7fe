"""How far calibrated factors are off because the simulator is not the engine that made the data, nor nature.

Estimated by `benchmarks/coverage.py` on effect-free sets of the virtual rig, which is another engine. It acts on what
the data say: where they leave a factor to the data sheet, the engine has no part in it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.csv_table import decimal, read_rows
from fabdesign.forward import PARAMETERS
from studies.calibration.normal import PRIOR

Array = NDArray[np.float64]
FILE = Path(__file__).parent / "engine_difference.csv"


def engine_difference() -> Array:
    """(7,) standard deviations of the factors' logarithms, in the order of PARAMETERS; mean error included."""
    _, rows = read_rows(FILE)
    values = {name: float(decimal(text, FILE, line, name)) for line, (name, text) in rows}
    return np.array([values[name] for name in PARAMETERS])


def data_share(deviation: Array) -> Array:
    """(..., 7) share of the data in the factors found, the data sheet's being the rest; of their own standard
    deviations (..., 7), logarithmic."""
    prior = np.array([PRIOR[name] for name in PARAMETERS])
    return np.clip(1 - np.square(deviation / prior), 0.0, 1.0)

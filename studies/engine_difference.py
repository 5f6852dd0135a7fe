"""How far calibrated factors are off because the simulator is not the engine that made the data, nor nature.

Estimated by `benchmarks/coverage.py` on effect-free sets of the virtual rig, which is another engine.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.csv_table import decimal, read_rows
from fabdesign.forward import PARAMETERS

FILE = Path(__file__).parent / "data" / "engine_difference.csv"


def engine_difference() -> NDArray[np.float64]:
    """(7,) standard deviations of the factors' logarithms, in the order of PARAMETERS; mean error included."""
    _, rows = read_rows(FILE)
    values = {name: float(decimal(text, FILE, line, name)) for line, (name, text) in rows}
    return np.array([values[name] for name in PARAMETERS])

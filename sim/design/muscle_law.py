"""The muscle law of a bench table on the kernels' grid."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fabdesign.muscle import BenchTable
from fabdesign.muscle_law import law_of
from sim.kernels import fields as f


@lru_cache(maxsize=64)
def bench_grid(table: BenchTable) -> NDArray[np.float32]:
    """(pressures, contractions) N: the muscle law on the kernels' grid."""
    pressure = np.arange(f.TABLE[0])[:, None] * f.PRESSURE_STEP
    contraction = f.FIRST_CONTRACTION + np.arange(f.TABLE[1]) * f.CONTRACTION_STEP
    return law_of(table).tension(pressure, contraction[None]).astype(np.float32)

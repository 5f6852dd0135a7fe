"""How far calibrated factors are off because the simulator is not the engine that made the data, nor nature.

Estimated by `benchmarks/coverage.py` on effect-free sets of the virtual rig, which is another engine. It acts on what
the data say: where they leave a factor to the data sheet, the engine has no part in it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.csv_table import decimal, read_rows
from optimize.fit.fitted import Fit
from optimize.fit.parameters import DECLARED, FitVector

Array = NDArray[np.float64]
FILE = Path(__file__).parent / "engine_difference.csv"


def engine_difference(vector: FitVector = DECLARED) -> Array:
    """(p,) standard deviations of the unknowns, mean error included; of effects' parameters none is known: 0."""
    _, rows = read_rows(FILE)
    values = {name: float(decimal(text, FILE, line, name)) for line, (name, text) in rows}
    return np.array(
        [
            values.get(name.rpartition(".")[2], 0.0) if p.is_factor else 0.0
            for name, p in zip(vector.names, vector.parameters, strict=True)
        ]
    )


def data_share(deviation: Array, vector: FitVector = DECLARED) -> Array:
    """(..., p) share of the data in the unknowns found, the prior's being the rest; of their own standard deviations
    (..., p)."""
    return np.clip(1 - np.square(deviation / vector.prior), 0.0, 1.0)


def with_engines(fit: Fit, engines: Array | None = None) -> Array:
    """(p, p) covariance of a fit, wider by the engines' difference as far as the data, not the data sheet, decide.
    engines: (p,) standard deviations of the unknowns, by default those of the virtual rig."""
    own = engine_difference(fit.vector) if engines is None else engines
    share = data_share(np.sqrt(np.diag(fit.covariance)), fit.vector)
    return np.asarray(fit.covariance + np.diag(np.square(share * own)))

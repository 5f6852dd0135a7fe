"""90 % intervals of a predicted motion: how wide a model's `Spread` says they are, and for which model it holds."""

from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.corrector import central_hash
from fabdesign.nouns.model import Model, Spread
from fabdesign.runtime.fingerprint import sha256

Array = NDArray[np.float64]
INSIDE = 0.9
TWO_SIDED = NormalDist().inv_cdf(0.5 + INSIDE / 2)  # half-width of an interval, in standard deviations


def half_widths(spread: Spread, deviation: Array, moved: Array, design: str = "") -> Array:
    """Return half-widths [m], of any shape. deviation: m, standard deviation over models drawn from the joint
    covariance. moved: m since rest. design: its name; one that the spread does not know has the width of all
    together."""
    squares = spread.constant**2 + (spread.covariance * deviation) ** 2 + (spread.motion * moved) ** 2
    return np.asarray(spread.designs.get(design, 1.0) * np.sqrt(squares))


def spread_hash(model: Model) -> str:
    """Return the SHA-256 of all that a predicted motion and its covariance depend on: central values, covariance,
    corrector."""
    covariance = model.covariance
    joint = "" if covariance is None else repr((covariance.names, covariance.matrix.tolist()))
    return sha256(central_hash(model), joint, "" if model.corrector is None else sha256(model.corrector))


def spread_of(model: Model) -> Spread | None:
    """Return the model's; None also where the model was changed since it was calibrated."""
    return model.spread if model.spread is not None and model.spread.trained_on == spread_hash(model) else None

"""What measured data leave open of the factors, in plain words."""

import numpy as np

from fabdesign.forward import PARAMETERS
from studies.calibration.fit import Fit
from studies.calibration.normal import PRIOR

_LITTLE = 0.8  # of the prior's standard deviation left: the data say little
_ALIKE = 0.9  # correlation from which two factors are told as a pair
_WEAK = 1.0  # information in units of the prior's, under which a direction is the data sheet's
_SHARE = 0.35  # of the largest component, for a factor to be named in a combination


def ambiguities(fit: Fit, covariance: np.ndarray) -> tuple[str, ...]:
    """What these data leave open: factors that stay the data sheet's, pairs, and combinations of others.

    covariance: (7, 7) of the logarithms, whatever the intervals hold included."""
    prior = np.array([PRIOR[name] for name in PARAMETERS])
    deviation = np.sqrt(np.diag(covariance))
    little = deviation > _LITTLE * prior
    lines = [
        f"{PARAMETERS[k]}: these data say little; the data sheet decides (to {100 * deviation[k]:.0f} %)"
        for k in np.flatnonzero(little)
    ]
    correlation = covariance / np.outer(deviation, deviation)
    for i, first in enumerate(PARAMETERS):
        for j in range(i):
            if abs(correlation[i, j]) > _ALIKE:
                known = "product" if correlation[i, j] < 0 else "ratio"
                lines.append(
                    f"{PARAMETERS[j]} and {first}: told apart poorly (correlation {correlation[i, j]:+.2f}); "
                    f"their {known} is known better than either"
                )
    values, vectors = np.linalg.eigh(fit.information * np.outer(prior, prior))
    for value, vector in zip(values, vectors.T, strict=True):
        direction = vector * prior
        named = np.flatnonzero(np.abs(direction) > _SHARE * np.abs(direction).max())
        if value < _WEAK and not little[named].all():
            lines.append(_combination(fit, direction, named))
    return tuple(lines) or ("all seven factors are told apart by these data",)


def _combination(fit: Fit, direction: np.ndarray, named: np.ndarray) -> str:
    """One prior standard deviation along a direction of the logarithms that the data hardly see."""
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    moves = ", ".join(
        f"{PARAMETERS[k]} {100 * (np.exp(direction[k]) - 1):+.0f} %"
        for k in sorted(named, key=lambda k: -abs(direction[k]))
    )
    seen = 1e3 * float(np.sqrt(max(direction @ fit.sensitivity @ direction, 0.0)))
    return f"together, {moves}: moves the surface by {seen:.2f} mm RMS only; these data cannot tell"

"""Statements, in plain words, on what measured data leave open of the factors."""

import numpy as np

from fabdesign.units import in_mm
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter

_LITTLE = 0.8  # of the prior's standard deviation left: the data say little
_ALIKE = 0.9  # correlation from which two factors are named as a pair
_WEAK = 1.0  # information in units of the prior's, under which a direction is the data sheet's
_SHARE = 0.35  # of the largest component, for a factor to be named in a combination


def ambiguities(fit: Fit, covariance: np.ndarray) -> tuple[str, ...]:
    """Return what these data leave open: factors that stay the data sheet's, pairs, and combinations of others.

    covariance: (p, p) of the unknowns, whatever the intervals hold included."""
    names, prior = fit.vector.names, fit.vector.prior
    deviation = np.sqrt(np.diag(covariance))
    little = deviation > _LITTLE * prior
    lines = [
        f"{names[k]}: these data say little; its value follows the {_other(fit, k)}{_to(fit, k, deviation[k])}"
        for k in map(int, np.flatnonzero(little))
    ]
    correlation = covariance / np.outer(deviation, deviation)
    for i, first in enumerate(names):
        for j in range(i):
            if abs(correlation[i, j]) > _ALIKE:
                known = "product" if correlation[i, j] < 0 else "ratio"
                lines.append(
                    f"{names[j]} and {first}: hardly separable (correlation {correlation[i, j]:+.2f}); "
                    f"their {known} is better known than each of them"
                )
    values, vectors = np.linalg.eigh(fit.information * np.outer(prior, prior))
    for value, vector in zip(values, vectors.T, strict=True):
        direction = vector * prior
        named = np.flatnonzero(np.abs(direction) > _SHARE * np.abs(direction).max())
        if value < _WEAK and not little[named].all():
            lines.append(_combination(fit, direction, named))
    return tuple(lines) or (f"these data separate all {_COUNTS.get(len(names), len(names))} factors",)


def _combination(fit: Fit, direction: np.ndarray, named: np.ndarray) -> str:
    """Say how far one prior standard deviation along a direction that the data hardly see moves the surface."""
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    moves = ", ".join(
        _moved(fit.vector.parameters[k], direction[k]) for k in sorted(named, key=lambda k: -abs(direction[k]))
    )
    seen = in_mm(float(np.sqrt(max(direction @ fit.sensitivity @ direction, 0.0))))
    return f"changed together, {moves} move the surface by {seen:.2f} mm RMS only: these data do not determine them"


_COUNTS = {6: "six", 7: "seven"}


def _moved(parameter: FitParameter, by: float) -> str:
    if parameter.transform == "log":
        return f"{parameter.name} {100 * (np.exp(by) - 1):+.0f} %"
    return f"{parameter.name} {by:+.2g} {parameter.unit}"


def _other(fit: Fit, k: int) -> str:
    return "data sheet" if fit.vector.parameters[k].is_factor else "prior"


def _to(fit: Fit, k: int, deviation: float) -> str:
    parameter = fit.vector.parameters[k]
    if parameter.transform == "log":
        return f" (within {100 * deviation:.0f} %)"
    return f" (within {deviation:.2g} {parameter.unit})"

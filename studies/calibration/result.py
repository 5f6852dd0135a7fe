"""The result of a calibration, as `calibrate --json` prints it and in plain words: the table, what the
data leave open of the factors, and what else there is to say of the fit."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fabdesign.formats.result_tables import OfModel
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.model import Model, Parameter
from fabdesign.units import in_mm
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter
from studies.fitting.fitted_model import excess
from studies.measured.fit_data import MeasuredData
from studies.measured.used_frames import UsedFrames

_ENGINES = (
    "the intervals include the difference between this simulator and the virtual rig; a real cloth may differ by more"
)


@dataclass(frozen=True, eq=False)
class Calibration(OfModel):
    """The result of a fit to measurement sets."""

    model: Model
    fit: Fit
    correlation: np.ndarray  # (p, p), of the unknowns in the order of fit.vector
    statements: tuple[str, ...]  # what these data do not determine
    warnings: tuple[str, ...]  # why the intervals are not reliable
    skipped: tuple[str, ...]  # bad trials left out, a line each
    data: MeasuredData
    intervals: str | None = None  # how good those of motions are; None: not asked for
    json_keys: ClassVar = (
        ("parameters", lambda of: {
            name: {"factor": p.factor, "interval90": p.interval90, "believable": p.reliable}
            for name, p in of.model.parameters.items()
        }),
        "model.effects",
        ("correlation", lambda of: {
            name: dict(zip(of.fit.vector.names, row, strict=True))
            for name, row in zip(of.fit.vector.names, of.correlation, strict=True)
        }),
        "statements",
        ("believable", lambda of: not of.warnings),
        ("doubts", "warnings"),
        ("residual", lambda of: {"before": in_mm(of.fit.before), "after": in_mm(of.fit.after), "unit": "mm"}),
        ("excess", lambda of: {"after": in_mm(of.excess), "unit": "mm"}),
        ("noise", lambda of: {"sigma": in_mm(of.noise.sigma), "strays": of.noise.strays, "unit": "mm"}),
        "model.provenance.fitted", "model.provenance.held_out", "fit.outlying",
        ("lost", lambda of: [{"trial": trial, "from_s": time} for trial, time in of.fit.lost]),
        "skipped", ("input_accuracy", "data.accuracy"), "model.spread", ("**", "data.used"),
        "fit.iterations", "fit.converged", "fit.interrupted",
    )  # fmt: skip

    @property
    def used(self) -> UsedFrames:
        """Return frames that took part: not those of sensitive stretches."""
        return self.data.used

    @property
    def excess(self) -> float:
        """Return m of the residual over the noise."""
        return excess(self.fit.after, self.noise)

    @property
    def noise(self) -> SensorNoise:
        return self.data.noise


def as_text(calibration: Calibration) -> str:
    """Return the table and the statements, for people."""
    fit, noise = calibration.fit, calibration.noise
    rows = [f"  {name:<14} {p.factor:6.3f}   {_interval(p)}" for name, p in calibration.model.parameters.items()]
    lines = [
        f"factors on the declared values, for a grid of {calibration.model.points_per_side} points a side:",
        *rows,
        *(f"  {line}" for line in _effects(calibration)),
        *(f"warning: the intervals are NOT reliable: {why}" for why in calibration.warnings),
        f"residual {in_mm(fit.before):.2f} -> {in_mm(fit.after):.2f} mm RMS; sensor noise {in_mm(noise.sigma):.2f} mm, "
        f"{100 * noise.strays:.1f} % strays; {fit.iterations} iterations",
        f"assumed accuracy of the inputs: {100 * calibration.data.accuracy.pressure:g} % of each pressure, "
        f"{calibration.data.accuracy.tilt:g} degrees of level ([accuracy] in set.toml)",
        *calibration.statements,
    ]
    if calibration.intervals is not None:
        lines.append(calibration.intervals)
    if calibration.used.stretches:
        lines.append(calibration.used.in_words)
    if not (fit.converged or fit.interrupted):
        lines.append("not converged: the last step was still large")
    if calibration.warnings and not fit.interrupted:
        lines.append("a likely cause: an effect that the model lacks, or a cloth that snaps (then try a finer --grid)")
    elif not fit.interrupted:
        lines.append(_ENGINES)
    lines += [f"{trial}: the motion diverged; left out from {time:.2f} s on" for trial, time in fit.lost]
    return "\n".join([*lines, *(f"skipped: {line}" for line in calibration.skipped)])


def _effects(calibration: Calibration) -> list[str]:
    lines = []
    for effect in calibration.model.effects:
        for name, q in effect.parameters.items():
            low, high = q.interval90 or (q.value, q.value)
            interval = f"90 % {low:.4g} to {high:.4g}" if q.interval90 else "held"
            lines.append(f"{effect.name}.{name}: {q.value:.4g} {q.unit}   {interval}")
    return lines


def _interval(parameter: Parameter) -> str:
    if parameter.interval90 is None:
        return "interval unknown"
    low, high = parameter.interval90
    return f"90 % {low:.3f} to {high:.3f}" + ("" if parameter.reliable else ", not reliable")


_LITTLE = 0.8  # of the prior's standard deviation left: the data say little
_ALIKE = 0.9  # correlation from which two factors are named as a pair
_SHARE = 0.35  # of the largest component, for a factor to be named in a combination


def ambiguities(fit: Fit, covariance: np.ndarray) -> tuple[str, ...]:
    """Return what these data leave open: factors that stay the data sheet's, pairs, and combinations of others.

    covariance: (p, p) of the unknowns, whatever the intervals hold included."""
    names, prior = fit.vector.names, fit.vector.prior
    deviation = np.sqrt(np.diag(covariance))
    little = deviation > _LITTLE * prior
    lines = [
        f"{names[k]}: these data say little; its value follows the {_prior_of(fit.vector.parameters[k], deviation[k])}"
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
    values, vectors = np.linalg.eigh(fit.normal.information * np.outer(prior, prior))
    for value, vector in zip(values, vectors.T, strict=True):
        direction = vector * prior
        named = np.flatnonzero(np.abs(direction) > _SHARE * np.abs(direction).max())
        if value < 1 and not little[named].all():  # less than the prior's: that direction is the data sheet's
            lines.append(_combination(fit, direction, named))
    return tuple(lines) or (f"these data separate all {_COUNTS.get(len(names), len(names))} factors",)


def _combination(fit: Fit, direction: np.ndarray, named: np.ndarray) -> str:
    """Say how far one prior standard deviation along a direction that the data hardly see moves the surface."""
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    moves = ", ".join(
        _moved(fit.vector.parameters[k], direction[k]) for k in sorted(named, key=lambda k: -abs(direction[k]))
    )
    seen = in_mm(float(np.sqrt(max(direction @ fit.normal.sensitivity @ direction, 0.0))))
    return f"changed together, {moves} move the surface by {seen:.2f} mm RMS only: these data do not determine them"


_COUNTS = {6: "six", 7: "seven"}


def _moved(parameter: FitParameter, by: float) -> str:
    if parameter.transform == "log":
        return f"{parameter.name} {100 * (np.exp(by) - 1):+.0f} %"
    return f"{parameter.name} {by:+.2g} {parameter.unit}"


def _prior_of(parameter: FitParameter, deviation: float) -> str:
    """Return what decides of an unknown that the data say little of, and within which standard deviation."""
    within = f"{100 * deviation:.0f} %" if parameter.transform == "log" else f"{deviation:.2g} {parameter.unit}"
    return f"{'data sheet' if parameter.is_factor else 'prior'} (within {within})"

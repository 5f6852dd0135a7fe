"""A calibration in plain words: the table, and what else there is to say of the fit."""

from fabdesign.nouns.model import Parameter
from fabdesign.units import in_mm
from studies.calibration.result import Calibration

_ENGINES = (
    "the intervals include the difference between this simulator and the virtual rig; a real cloth may differ by more"
)


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
            said = f"90 % {low:.4g} to {high:.4g}" if q.interval90 else "held"
            lines.append(f"{effect.name}.{name}: {q.value:.4g} {q.unit}   {said}")
    return lines


def _interval(parameter: Parameter) -> str:
    if parameter.interval90 is None:
        return "interval unknown"
    low, high = parameter.interval90
    return f"90 % {low:.3f} to {high:.3f}" + ("" if parameter.reliable else ", not reliable")

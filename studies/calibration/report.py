"""A calibration in plain words: the table, and what else there is to say of the fit."""

from studies.calibration.calibrate import Calibration

_ASTRAY = 0.03  # share of frames astray from which on it is said


def as_text(calibration: Calibration) -> str:
    """The table and the statements, for people."""
    fit, noise = calibration.fit, calibration.noise
    rows = [
        f"  {name:<14} {p.factor:6.3f}   90 % {p.interval90[0]:.3f} to {p.interval90[1]:.3f}"
        for name, p in calibration.model.parameters.items()
    ]
    lines = [
        f"factors on the declared values, for a grid of {calibration.model.points_per_side} points a side:",
        *rows,
        f"residual {1e3 * fit.before:.2f} -> {1e3 * fit.after:.2f} mm RMS; sensor noise {1e3 * noise.sigma:.2f} mm, "
        f"{100 * noise.strays:.1f} % strays; {fit.iterations} iterations",
        *calibration.statements,
    ]
    if not fit.converged:
        lines.append("not converged: the last step was still large")
    if fit.astray >= _ASTRAY:
        lines.append(
            f"{fit.astray:.0%} of the frames fitted are far off: an effect that the model lacks, or cloth that snaps, "
            "which a finer --grid follows"
        )
    lines.append(
        "the intervals hold the difference between this engine and the virtual rig's; a real cloth may differ by more"
    )
    lines += [f"{trial}: the motion diverged; left out from {time:.2f} s on" for trial, time in fit.lost]
    return "\n".join([*lines, *(f"skipped: {line}" for line in calibration.skipped)])

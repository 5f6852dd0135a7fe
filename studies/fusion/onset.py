"""When the pressure's log begins on the cameras' axis: a step of pressure sets the cloth in motion.

After a step from rest the cloth comes as 1 - exp(-(t / T)^1.5), whose start and T all cameras share: a mass comes with
t^2, what drag holds with t, and a sheet has modes of both. What the supply and the muscles take to answer is in it: an
effect of the model (`dead_time`), not of a clock.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from fabdesign.clouds.recording import Recording
from fabdesign.errors import note
from fabdesign.files.pressure_file import steps_of
from fabdesign.nouns.array import Array
from studies.fusion.joint import TimedViews
from studies.fusion.moving import StampedView, best_lag, change

FADES = 0.15  # s, time constant of the motion after a step, for the coarse place
GRID = 0.004  # s
CLEAR = 0.004  # m of displacement that shows how the cloth moves
BEFORE = 0.04  # s: a view so long before a step shows the cloth without it
LEAST = 100  # points
SOON = 0.08  # s after a step
SLOW = 0.03  # m/s: a cloth faster than that before a step says nothing of its instant
POWER = 1.5
NOISE, SHAPE = 3e-4, 0.05  # m, and of the way: how far a cloth comes otherwise than that
RESOLUTION = 5e-4  # s: no step says it better


class PressureBegin(NamedTuple):
    """The common time [s] of the pressure's 0, how well it is known, and by how many steps."""

    offset: float
    uncertain: float
    steps: int


def pressure_begin(recording: Recording, timed: TimedViews) -> PressureBegin:
    """Return when a recording's program begins: as it says, else by its steps; else with the first image, with a
    note."""
    begins, steps = float(timed.times[0][0]), steps_of(recording.program)
    if recording.log.shift is not None:
        return PressureBegin(begins + recording.log.shift, 0.0, 0)
    if not steps:
        note(
            f"recording {recording.name}: the pressures have no step; their 0 is taken to be the first image's instant"
        )
        return PressureBegin(begins, 0.0, 0)
    coarse = _coarse(steps, timed)
    onsets = []
    for step, _ in steps:
        cameras = zip(timed.views, timed.times, timed.speeds, strict=True)
        curves = [_curve(*camera, coarse + step) for camera in cameras]
        start = _start([curve for curve in curves if len(curve) > 1], coarse + step)
        if start is not None:
            onsets.append((start[0] - step, start[1]))
    if not onsets:
        return PressureBegin(coarse, 0.02, 0)
    instants, deviations = np.array(onsets).T
    weights = deviations**-2.0
    middle = float(weights @ instants / weights.sum())
    return PressureBegin(middle, float(weights.sum() ** -0.5), len(onsets))


def _coarse(steps: Sequence[tuple[float, float]], timed: TimedViews) -> float:
    """Return the offset at which the motion that steps would make lies best on the motion that was seen."""
    every = np.concatenate(timed.times)
    order = np.argsort(every)
    seen = every[order], np.concatenate(timed.speeds)[order]
    grid = np.arange(-0.5, max(seen[0][-1] - seen[0][0], steps[-1][0] + 0.5), GRID)
    expected = np.zeros(len(grid))
    for at, jump in steps:
        after = grid - at
        expected += np.where(after >= 0, jump * np.exp(-np.maximum(after, 0) / FADES), 0.0)
    return best_lag(seen, (grid, expected), np.inf)[0]


def _curve(views: Sequence[StampedView], times: Array, speeds: Array, expected: float) -> Array:
    """Return (n, 2) how far [m] a camera's cloth has come at instants [s] about a step; none where it was not at rest.

    It is measured along the motion itself, which averages the noise of the images.
    """
    before = np.flatnonzero(times < expected - BEFORE)
    if not len(before) or speeds[before[-1]] > SLOW:
        return np.zeros((0, 2))
    rest, start = views[before[-1]], times[before[-1]]
    drift = np.nan_to_num(rest.speed)
    fields = {
        k: change(rest.cloud, views[k].cloud) - drift * (times[k] - start)
        for k in map(int, np.flatnonzero((times > start) & (times < expected + SOON)))
    }
    fields = {k: field for k, field in fields.items() if np.isfinite(field).sum() > LEAST}
    far = {k: float(np.sqrt(np.nanmean(field**2))) for k, field in fields.items()}
    shown = next((k for k in sorted(far) if far[k] > CLEAR), None)  # how the cloth moves after the step
    if shown is None:
        return np.zeros((0, 2))
    points = []
    for k, field in fields.items():
        both = np.isfinite(field) & np.isfinite(fields[shown])
        pattern = fields[shown][both]
        points.append((times[k], float(field[both] @ pattern / (pattern @ pattern)) * far[shown]))
    return np.array(points)


def _start(curves: Sequence[Array], expected: float) -> tuple[float, float] | None:
    """Return the instant [s] of a step that the curves of all cameras share, and its standard deviation; None where
    they do not say it."""
    points = sum(map(len, curves))
    if points < 2 * len(curves) + 2:
        return None

    def off(guess: Array) -> Array:
        parts = []
        for curve in curves:
            after = np.maximum(curve[:, 0] - expected - guess[0], 0.0) / np.exp(guess[1])
            shape = 1.0 - np.exp(-(after**POWER))
            size = float(shape @ curve[:, 1]) / max(float(shape @ shape), 1e-12)
            parts.append((curve[:, 1] - size * shape) / np.hypot(NOISE, SHAPE * curve[:, 1]))
        return np.asarray(np.concatenate(parts))

    starts = [[start, np.log(time)] for start in (-0.01, 0.01) for time in (0.01, 0.03, 0.1)]
    best = min((least_squares(off, start) for start in starts), key=lambda solved: float(solved.cost))
    information = best.jac.T @ best.jac
    misfit = max(1.0, 2 * float(best.cost) / (points - len(curves) - 2 or 1))
    if abs(best.x[0]) > BEFORE or np.linalg.cond(information) > 1e12:
        return None
    return expected + float(best.x[0]), max(RESOLUTION, float(misfit * np.linalg.inv(information)[0, 0]) ** 0.5)

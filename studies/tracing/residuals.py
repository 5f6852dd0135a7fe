"""The residuals of a fit as everything that looks at them takes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.sheet import Sheet
from fabdesign.trial import Trial
from optimize.fit.clouds import Array, Match, Sample
from optimize.fit.fitted import Fit
from optimize.fit.left_out import LeftOut, Scored
from studies.measured_data import MeasuredData

STROKE = 100e3  # Pa by which a channel's pressure rises in one stroke
_RATE = 0.01  # s


@dataclass(frozen=True, eq=False)
class Residuals:
    samples: Sequence[Sample]
    sheets: Sequence[Sheet]  # the model's motions, a sample each
    found: Match
    residual: Array  # (N,) m, zero where not kept
    kept: NDArray[np.bool_]  # (N,) no stray, and the motion is there
    counts: Array  # (N,) how much of what a point says errors of the inputs leave, 0 to 1
    session: Array  # (samples, 3) place in the session, and of what came before: Pa s of all channels, and strokes

    @staticmethod
    def of(data: MeasuredData, fit: Fit) -> "Residuals":
        """Return the residuals of a fit to the data, whose sets say what each specimen went through before."""
        linear = LeftOut.of(fit, range(len(data.samples)))
        past: dict[Path, Array] = {}
        for measured in data.sets:
            past |= use_before(measured.trials)
        session = np.array([[s.trial.order, *past.get(s.trial.file, np.zeros(2))] for s in data.samples], dtype=float)
        return Residuals(
            data.samples, fit.state.sheets, linear.found, linear.residual, linear.kept, fit.normal.counts, session
        )

    @property
    def scored(self) -> Scored:
        """Of each trial as it is, fitted."""
        return self.scored_as(self.residual)

    def scored_as(self, residual: Array) -> Scored:
        """Of each trial, with (N,) m in place of the residual."""
        weights = self.counts * self.kept
        squares, sums = np.zeros(len(self.samples)), np.zeros(len(self.samples))
        np.add.at(squares, self.found.sample, weights * np.square(residual))
        np.add.at(sums, self.found.sample, weights)
        return Scored(squares, sums)


def use_before(trials: Sequence[Trial]) -> dict[Path, Array]:
    """Return what a session's specimen has behind it when each trial begins, (2,): Pa s of all channels, and strokes
    of STROKE; by the trial's file."""
    behind, so_far = {}, np.zeros(2)
    for trial in sorted(trials, key=lambda trial: trial.order):
        behind[trial.file] = so_far
        pressure = trial.program.at(np.arange(0.0, trial.times[-1] + _RATE, _RATE))
        strokes = np.maximum(np.diff(pressure, axis=0, prepend=0.0), 0.0).sum() / STROKE
        so_far = so_far + [_RATE * pressure.sum(), strokes]
    return behind

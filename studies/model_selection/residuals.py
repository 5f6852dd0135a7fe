"""The residuals of a fit as everything that looks at them takes them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.shape import Sheet
from fabdesign.nouns.array import Array
from optimize.fit.clouds import Match, Sample
from optimize.fit.cross_validation import LeftOut, Scored
from optimize.fit.fitted import Fit
from studies.measured.fit_data import MeasuredData


@dataclass(frozen=True, eq=False)
class Residuals:
    samples: Sequence[Sample]
    sheets: Sequence[Sheet]  # the model's motions, a sample each
    misfit: Match
    residual: Array  # (N,) m, zero where not kept
    kept: NDArray[np.bool_]  # (N,) no stray, and the motion is there
    counts: Array  # (N,) how much of what a point says errors of the inputs leave, 0 to 1
    session: Array  # (samples, 3) as the data have it

    @staticmethod
    def of(data: MeasuredData, fit: Fit) -> "Residuals":
        """Return the residuals of a fit to the data, whose sets say what each specimen went through before."""
        linear = LeftOut.of(fit, range(len(data.samples)))
        assert isinstance(linear.misfit, Match)
        return Residuals(
            data.samples, fit.state.sheets, linear.misfit, linear.residual, linear.kept, fit.normal.counts, data.session
        )

    @property
    def scored(self) -> Scored:
        """Return the squares of each trial as it is, fitted."""
        return self.scored_as(self.residual)

    def scored_as(self, residual: Array) -> Scored:
        """Return the squares of each trial with (N,) m in place of the residual."""
        weights = self.counts * self.kept
        squares, sums = np.zeros(len(self.samples)), np.zeros(len(self.samples))
        np.add.at(squares, self.misfit.sample, weights * np.square(residual))
        np.add.at(sums, self.misfit.sample, weights)
        return Scored(squares, sums)

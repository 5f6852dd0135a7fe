"""One fit of many effects, over growing horizons.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, the fit finds its way,
and what is not there comes out as nothing: what one horizon says for certain to be next to nothing takes no part in the
later ones, where a column costs a motion of every trial.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.forward import Term
from optimize.fit.clouds import Array, evenly
from optimize.fit.descent import Progress, horizons, parts
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter, FitVector
from studies.measured_data import MeasuredData

EARLY = 1.0  # s, of the horizons before the last: a column costs a motion as long
EARLY_TRIALS = 8  # of these at most: they lead near, where the last horizon begins with all
KNOWN = 0.35  # of the prior's standard deviation, over which the data say little of an unknown

# of so much data, from a start (p,); the horizon [s], None: the last; and what tells its share of the work
FitUntil = Callable[[MeasuredData, FitVector, Array, float | None, Progress], Fit]


@dataclass(frozen=True, eq=False)
class Nothing:
    """A term that is off: where a shorter horizon had its unknowns x (k,), and their standard deviations. most: m RMS
    by which it could move the residuals."""

    term: Term
    parameters: tuple[FitParameter, ...]
    x: Array
    deviation: Array
    most: float


def joint_fit(
    data: MeasuredData,
    vector: FitVector,
    start: Array,
    tolerance: float,
    fitted: FitUntil,
    progress: Progress = lambda line, share: None,
) -> tuple[Fit, dict[str, Nothing]]:
    """The fit of all frames, and the terms that it is without, by label: what cannot matter beside `tolerance` [m], of
    those whose strengths alone are fitted and that no model gave. fitted: makes the fit of each horizon."""
    nothing: dict[str, Nothing] = {}
    *shorter, last = horizons(data.samples)
    shorter = [horizon for horizon in shorter if horizon <= EARLY]
    *told, told_last = parts(progress, *(np.cumsum(shorter) / (sum(shorter) + last)).tolist())
    few = data.only(evenly(len(data.trials), EARLY_TRIALS).tolist())
    for horizon, own in zip(shorter, told, strict=True):
        early = fitted(few.until(horizon), vector, start, horizon, own)
        gone = negligible(early, tolerance)
        nothing |= gone
        vector, index = vector.only([label for label in vector.labels if label not in gone])
        start = early.x[index]
    return fitted(data, vector, start, None, told_last), nothing


def negligible(early: Fit, tolerance: float) -> dict[str, Nothing]:
    """The terms that are well known and, two standard deviations off, move the residuals by less than half the
    `tolerance` [m] RMS, less what the other unknowns can take of that."""
    normal, vector = early.normal, early.vector
    share = normal.scale**2 / max(normal.tempering * float(normal.frames.sum()), 1e-12)
    ridged = normal.sensitivity + share * np.diag(1 / vector.prior**2)
    deviation = np.sqrt(np.diag(early.covariance))
    found = {}
    for label, term in zip(vector.labels, vector.terms, strict=True):
        part = vector.part(label)
        others = np.setdiff1d(np.arange(len(early.x)), part)
        across = normal.sensitivity[np.ix_(part, others)]
        left = normal.sensitivity[np.ix_(part, part)] - across @ np.linalg.solve(
            ridged[np.ix_(others, others)], across.T
        )
        size = np.abs(early.x[part]) + 2 * deviation[part]
        most = float(size @ np.sqrt(np.maximum(np.diag(left), 0.0)))
        parameters = tuple(vector.parameters[k] for k in part)
        known = (deviation[part] <= KNOWN * vector.prior[part]).all()
        if known and most <= 0.5 * tolerance and _may_go(term, parameters):
            found[label] = Nothing(term, parameters, early.x[part], deviation[part], most)
    return found


def _may_go(term: Term, parameters: Sequence[FitParameter]) -> bool:
    """Not what a model gave, whether it is fitted or held."""
    keys = {parameter.name.rpartition(".")[2] for parameter in parameters}
    return bool(keys) and keys <= {*EFFECTS[term.name].strengths} - term.values.keys()

"""One fit of many effects, over growing horizons.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, the fit finds its way,
and what is not there comes out as nothing: what one horizon says for certain to be next to nothing takes no part in the
later ones, where a column costs a motion of every trial. Where cloth buckles, that way has false minima too, and what
the factors alone lead to may be nearer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.forward import Term
from optimize.fit.clouds import Array, evenly
from optimize.fit.descent import Progress, horizons, parts
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter, FitVector
from studies.calibration.intervals import expected_rms
from studies.measured_data import MeasuredData

EARLY = 1.0  # s, of the horizons before the last: a column costs a motion as long
EARLY_TRIALS = 8  # of these at most: they lead near, where the last horizon begins with all
KNOWN = 0.35  # of the prior's standard deviation, over which the data say little of an unknown


class FitUntil(Protocol):
    """What makes the fit of a horizon."""

    def __call__(
        self,
        data: MeasuredData,
        vector: FitVector,
        start: Array,
        /,
        *,
        named: str,
        horizon: float | None,
        expected: float,
        progress: Progress,
    ) -> Fit:
        """Of so much data, from a start (p,). horizon: s, None: the last. expected: as optimize.fit.descent.fit takes
        it. progress: is told its share of the work."""
        ...


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
    right = expected_rms(data.noise, tolerance)
    expected = np.inf if vector.terms else right  # with effects at nothing much is left before they are found
    *shorter, last = horizons(data.samples)
    shorter = [horizon for horizon in shorter if horizon <= EARLY]
    *told, told_last = parts(progress, *(np.cumsum(shorter) / (sum(shorter) + last)).tolist())
    few = data.only(evenly(len(data.trials), EARLY_TRIALS).tolist())
    for horizon, own in zip(shorter, told, strict=True):
        until = partial(fitted, few.until(horizon), horizon=horizon, progress=own)
        early = until(vector, start, named=f"to {horizon:g} s", expected=expected)
        if vector.terms and horizon == shorter[0] and early.after > right:
            early = _from_factors(early, until)
        gone = negligible(early, tolerance)
        nothing |= gone
        vector, index = vector.only([label for label in vector.labels if label not in gone])
        start = early.x[index]
    return fitted(data, vector, start, named="", horizon=None, expected=expected, progress=told_last), nothing


def _from_factors(early: Fit, until: Callable[..., Fit]) -> Fit:
    """The better of a fit that leaves too much and one that begins with effects at nothing, where the factors alone
    lead: a cloth that buckles has false minima on either way."""
    plain = early.vector.without_effects
    factors = until(plain, plain.start, named="factors first", expected=np.inf).x
    other = until(early.vector, beside(early.vector, factors), named="from those factors", expected=np.inf)
    return min(early, other, key=lambda one: one.after)


def beside(vector: FitVector, factors: Array) -> Array:
    """(p,) of a vector's unknowns: factors, and effects at nothing."""
    x = np.zeros(len(vector.parameters))
    x[: len(factors)] = factors
    return x


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

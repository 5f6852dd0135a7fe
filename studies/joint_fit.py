"""One fit of many effects, over growing horizons.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, the fit finds its way,
and what is not there comes out as nothing: what one horizon says for certain to be next to nothing takes no part in the
later ones, where a column costs a motion of every trial. Where cloth buckles, that way has false minima too, and what
the factors alone lead to may be nearer.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.forward import Term
from optimize.fit.clouds import Array, evenly
from optimize.fit.descent import Progress, horizons, parts
from optimize.fit.fitted import Fit
from optimize.fit.needed import NEEDED, alike, needed
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
    *,
    patient: bool = False,
) -> tuple[Fit, dict[str, Nothing]]:
    """The fit of all frames, and the terms that it is without, by label: what cannot matter beside `tolerance` [m], of
    those whose strengths alone are fitted and that no model gave. fitted: makes the fit of each horizon. patient:
    whether it begins again where a later horizon leaves too much, too, not the first alone."""
    right = expected_rms(data.noise, tolerance)
    stages = _stages(data, fitted, np.inf if vector.terms else right, progress)  # effects at nothing leave much
    descent, untried = _Descent(vector, start), bool(vector.terms)
    for k, stage in enumerate(stages):
        descent = _on(descent, stage, tolerance)
        if untried and descent.left > right and (patient or k == 0):
            untried, other = False, _from_factors(vector, stages[0])
            for before in stages[: k + 1]:
                other = _on(other, before, tolerance)
            descent = min(descent, other, key=lambda one: one.left)
    assert descent.fit is not None
    return descent.fit, descent.nothing


@dataclass(frozen=True, eq=False)
class _Descent:
    """A fit between horizons: its unknowns, where they are, and what was left out. named: in what is said."""

    vector: FitVector
    x: Array
    named: str = ""
    nothing: dict[str, Nothing] = field(default_factory=dict)
    fit: Fit | None = None

    @property
    def left(self) -> float:
        """m RMS, capped."""
        return np.inf if self.fit is None else self.fit.after


@dataclass(frozen=True, eq=False)
class _Stage:
    """A horizon. named: in what is said."""

    fitted: Callable[..., Fit]
    named: str
    is_last: bool


def _stages(data: MeasuredData, fitted: FitUntil, expected: float, progress: Progress) -> list[_Stage]:
    *shorter, last = horizons(data.samples)
    shorter = [horizon for horizon in shorter if horizon <= EARLY]
    told = parts(progress, *(np.cumsum(shorter) / (sum(shorter) + last)).tolist())
    few = data.only(evenly(len(data.trials), EARLY_TRIALS).tolist())
    lengths = [*((h, few.until(h), f"to {h:g} s") for h in shorter), (None, data, "")]
    return [
        _Stage(partial(fitted, seen, horizon=h, expected=expected, progress=own), named, h is None)
        for (h, seen, named), own in zip(lengths, told, strict=True)
    ]


def _on(descent: _Descent, stage: _Stage, tolerance: float) -> _Descent:
    """Over one horizon; what cannot matter takes no part in the next."""
    found = stage.fitted(descent.vector, descent.x, named=f"{descent.named} {stage.named}".strip())
    gone = {} if stage.is_last else negligible(found, tolerance, descent.nothing)
    vector, index = descent.vector.only([label for label in descent.vector.labels if label not in gone])
    return _Descent(vector, found.x[index], descent.named, descent.nothing | gone, found)


def _from_factors(vector: FitVector, first: _Stage) -> _Descent:
    """Where the factors alone lead over the first horizon, and effects at nothing: a cloth that buckles has false
    minima on either way."""
    plain = vector.without_effects
    factors = first.fitted(plain, plain.start, named=f"factors {first.named}".strip()).x
    return _Descent(vector, beside(vector, factors), "from factors")


def beside(vector: FitVector, factors: Array) -> Array:
    """(p,) of a vector's unknowns: factors, and effects at nothing."""
    x = np.zeros(len(vector.parameters))
    x[: len(factors)] = factors
    return x


def negligible(early: Fit, tolerance: float, before: Mapping[str, Nothing]) -> dict[str, Nothing]:
    """The terms that are well known and, two standard deviations off, move the residuals by less than half the
    `tolerance` [m] RMS, less what the other unknowns can take of that: all of them together with those gone `before`,
    in quadrature, the least first, since each of a cloth's muscles may be a little odd. Not what does the same as one
    that is needed: it is next to nothing beside that one alone, and may be the one that acts."""
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
    certain = needed(early.minimum, early.covariance, vector, NEEDED)
    same = {other for label in certain for other in alike(early.sensitivity, vector, label, [*found])}
    small = sorted((label for label in found if label not in same), key=lambda label: found[label].most)
    already = sum(of.most**2 for of in before.values())
    together = np.sqrt(already + np.cumsum([found[label].most ** 2 for label in small]))
    return {label: found[label] for label, most in zip(small, together, strict=True) if most <= 0.5 * tolerance}


def _may_go(term: Term, parameters: Sequence[FitParameter]) -> bool:
    """Not what a model gave, whether it is fitted or held."""
    keys = {parameter.name.rpartition(".")[2] for parameter in parameters}
    return bool(keys) and keys <= {*EFFECTS[term.name].strengths} - term.values.keys()

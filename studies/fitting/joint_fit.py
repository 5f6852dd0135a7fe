"""One fit of many effects, over growing horizons.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, the fit finds its way,
and what is not there comes out as nothing: what one horizon says to be next to nothing takes no part in the later ones,
where a column costs a motion of every trial. The last fit has all trials and all unknowns. Where cloth buckles, that
way has false minima too, and what the factors alone lead to may be nearer.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.forward import Term
from optimize.fit.clouds import evenly
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.policy import ROUGH
from optimize.fit.problem import horizons_of, widened
from optimize.fit.significance import needed
from studies.fitting.fits import Fits, beginning, shown
from studies.fitting.fitted_model import expected_rms
from studies.measured.fit_data import MeasuredData

EARLY = 1.0  # s, of the horizons before all frames: a column costs a motion as long
EARLY_TRIALS = 8  # of these at most: they lead near, where the last fit begins
KNOWN = 0.35  # of the prior's standard deviation, over which the data say little of an unknown
KEPT = 4.0  # of log likelihood: an effect that costs less to drop at rest, or from the early trials, is not fitted on
_AT_LAST = 0.5  # of all work, where the last fit has all trials; of that where the same are seen again, a quarter


def joint_fit(data: MeasuredData, vector: FitVector, start: Array, fits: Fits) -> Fit:
    """Return the fit of all frames over growing horizons. Of the terms whose strengths alone are fitted and that no
    model gave, what cannot matter beside the tolerance takes part in the last fit alone."""
    right = expected_rms(data.noise, fits.tolerance)
    enough = right if fits.patient else expected_rms(data.noise, 2 * fits.tolerance)
    some = _early_trials(data)
    lengths = horizons_of(data.samples)
    lengths = [horizon for horizon in lengths if horizon <= EARLY or horizon == lengths[-1]]
    share = _AT_LAST if len(some.trials) < len(data.trials) else _AT_LAST / 4
    ends = [0.0, *((1 - share) * np.cumsum(lengths) / sum(lengths)).tolist()]
    expected = np.inf if vector.terms else right  # effects at nothing leave much
    stages = [
        _Stage(some.until(horizon), horizon, horizon == lengths[-1], fits.coarse.within(*part), expected)
        for horizon, part in zip(lengths, pairwise(ends), strict=True)
    ]
    descent, untried = _Descent(vector, start), bool(vector.terms)
    for k, stage in enumerate(stages):
        descent = stage.after(descent)
        if untried and descent.remaining > enough and (fits.patient or k == 0):
            untried, other = False, _from_factors(vector, stages[0])
            for before in stages[: k + 1]:
                other = before.after(other)
            descent = min(descent, other, key=lambda one: one.remaining)
    last, begin = fits.within(ends[-1], 1.0), FitStart(descent.x)
    if descent.fit is not None and len(some.trials) == len(data.trials):
        begin = FitStart(descent.x, descent.jacobian, descent.fit.inputs)
    problem, named = last.problem(data, vector, expected), f"{descent.named} at last".strip()
    return last.fit(problem, begin, fits.last(vector), named)


def joint_fit_from_rest(data: MeasuredData, vector: FitVector, fits: Fits, at_rest: Fit) -> Fit:
    """Return the fit of all frames from where shapes at rest are fitted. What these do not need, or a few trials of
    what does not act at rest, takes no part in the last fit."""
    nothing = unneeded(at_rest)
    there, index = vector.only(set(vector.labels) - nothing)
    x, some = beginning(vector, at_rest, nothing)[index], _early_trials(data)
    if len(some.trials) < len(data.trials):
        early = fits.coarse.within(0.0, _AT_LAST)
        begun = early.fit(early.problem(some, there), FitStart(x), ROUGH, "of few trials")
        at_rest_too = {label_effect(label) for label in shown(at_rest)}
        idle = {label for label in unneeded(begun) if label_effect(label) not in at_rest_too}
        x = begun.x.copy()
        x[there.parts(idle)] = 0.0
        there, index = there.only(set(there.labels) - idle)
        x, fits = x[index], fits.within(_AT_LAST, 1.0)
    return fits.fit(fits.problem(data, there), FitStart(x), fits.last(there), "at last")


def _early_trials(data: MeasuredData) -> MeasuredData:
    """Return EARLY_TRIALS of the data, spread over them."""
    return data.only(evenly(len(data.trials), EARLY_TRIALS).tolist())


@dataclass(frozen=True, eq=False)
class _Descent:
    """A fit between horizons: all unknowns, where they are, and the inactive terms, by label.
    named: in what is said. at: which of the unknowns the last fit has."""

    vector: FitVector
    x: Array
    named: str = ""
    inactive: frozenset[str] = frozenset()
    fit: Fit | None = None
    at: Indices | None = None

    @property
    def part(self) -> tuple[FitVector, Indices]:
        """Return the unknowns that take part, and which they are."""
        return self.vector.only([label for label in self.vector.labels if label not in self.inactive])

    @property
    def remaining(self) -> float:
        """Return the capped RMS, m."""
        return np.inf if self.fit is None else self.fit.after

    @property
    def jacobian(self) -> Array:
        """Return the Jacobian (N, p) m of all unknowns: NaN for those that take no part."""
        assert self.fit is not None
        assert self.at is not None
        return widened(self.fit.state.jacobian, self.at, len(self.x))

    def less(self, labels: Iterable[str]) -> "_Descent":
        """Return the descent with more terms inactive, by their labels among those that take part, and at nothing."""
        dropped = {*labels}
        every = [label for label in self.vector.labels if label not in self.inactive]
        more = {name for name, label in zip(every, self.part[0].labels, strict=True) if label in dropped}
        x = self.x.copy()
        x[self.vector.parts(more)] = 0.0
        return replace(self, x=x, inactive=self.inactive | more)


@dataclass(frozen=True, eq=False)
class _Stage:
    """A horizon [s] of some trials. last: whether that is all of their frames."""

    data: MeasuredData
    horizon: float
    last: bool
    fits: Fits
    expected: float

    def fit(self, vector: FitVector, start: Array, named: str) -> Fit:
        """Return the fit of a vector over the horizon. named: before the horizon."""
        problem = self.fits.problem(self.data, vector, self.expected)
        return self.fits.fit(problem, FitStart(start), ROUGH, f"{named} to {self.horizon:g} s".strip())

    def after(self, descent: _Descent) -> _Descent:
        """Return the descent over the horizon; what cannot matter takes no part in the next."""
        vector, index = descent.part
        fit = self.fit(vector, descent.x[index], descent.named)
        x = np.zeros(len(descent.x))
        x[index] = fit.x
        return replace(descent, x=x, fit=fit, at=index).less(negligible(fit, 0.0 if self.last else self.fits.tolerance))


def _from_factors(vector: FitVector, first: _Stage) -> _Descent:
    """Return where the factors alone lead over the first horizon, with effects at nothing: a cloth that buckles has
    false minima with and without them."""
    plain = vector.without_effects
    return _Descent(vector, beside(vector, first.fit(plain, plain.start, "factors").x), "from factors")


def beside(vector: FitVector, factors: Array) -> Array:
    """Return a vector's unknowns (p,): factors, and effects at nothing."""
    x = np.zeros(len(vector.parameters))
    x[: len(factors)] = factors
    return x


def negligible(early: Fit, tolerance: float) -> frozenset[str]:
    """Return the terms that are well known and, two standard deviations off, move the residuals by less than half the
    `tolerance` [m] RMS, less what the other unknowns can take of that."""
    normal, vector = early.normal, early.vector
    share = normal.scale**2 / max(normal.tempering * float(normal.frames.sum()), 1e-12)
    ridged = normal.sensitivity + share * np.diag(1 / vector.prior**2)
    deviation = np.sqrt(np.diag(early.covariance))
    labels = []
    for label, term in zip(vector.labels, vector.terms, strict=True):
        part = vector.part(label)
        others = np.setdiff1d(np.arange(len(early.x)), part)
        across = normal.sensitivity[np.ix_(part, others)]
        reduced = normal.sensitivity[np.ix_(part, part)] - across @ np.linalg.solve(
            ridged[np.ix_(others, others)], across.T
        )
        size = np.abs(early.x[part]) + 2 * deviation[part]
        most = float(size @ np.sqrt(np.maximum(np.diag(reduced), 0.0)))
        known = (deviation[part] <= KNOWN * vector.prior[part]).all()
        if known and most <= 0.5 * tolerance and _may_go(term, tuple(vector.parameters[k] for k in part)):
            labels.append(label)
    return frozenset(labels)


def unneeded(fit: Fit) -> frozenset[str]:
    """Return the terms that move the residuals of a fit, and that cost under KEPT to drop, one after another."""
    kept = needed(fit.minimum, fit.covariance, fit.vector, KEPT)
    terms = dict(zip(fit.vector.labels, fit.vector.terms, strict=True))
    return frozenset(
        label
        for label in shown(fit)
        if label not in kept and _may_go(terms[label], tuple(fit.vector.parameters[k] for k in fit.vector.part(label)))
    )


def _may_go(term: Term, parameters: Sequence[FitParameter]) -> bool:
    """Return whether a term may be dropped: no model gave it, fitted or held."""
    keys = {parameter.name.rpartition(".")[2] for parameter in parameters}
    return bool(keys) and keys <= {*EFFECTS[term.name].strengths} - term.values.keys()

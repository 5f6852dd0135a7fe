"""One fit of many effects, over growing horizons.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, the fit finds its way,
and what is not there comes out as nothing: what one horizon says to be next to nothing takes no part in the later ones,
where a column costs a motion of every trial. The last fit has all trials and all unknowns. Where cloth buckles, that
way has false minima too, and what the factors alone lead to may be nearer.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.nouns.forward import Term
from optimize.fit.clouds import Array, Indices, evenly
from optimize.fit.descent import Progress, horizons, parts
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.problem import widened
from optimize.fit.significance import needed
from studies.calibration.intervals import expected_rms
from studies.calibration.rest_fit import beginning, shown
from studies.measured.fit_data import MeasuredData

EARLY = 1.0  # s, of the horizons before all frames: a column costs a motion as long
EARLY_TRIALS = 8  # of these at most: they lead near, where the last fit begins
KNOWN = 0.35  # of the prior's standard deviation, over which the data say little of an unknown
KEPT = 4.0  # of log likelihood: an effect that costs less to drop at rest, or from the early trials, is not fitted on
_AT_LAST = 0.5  # of all work, where the last fit has all trials; of that where the same are seen again, a quarter


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
        jacobian: Array | None = None,
    ) -> Fit:
        """Of so much data, from a start (p,). horizon: s; None: the last fit. expected, jacobian: as
        optimize.fit.descent.fit takes them. progress: is told its share of the work."""
        ...


def joint_fit(
    data: MeasuredData,
    vector: FitVector,
    start: Array,
    tolerance: float,
    fitted: FitUntil,
    progress: Progress = lambda line, share: None,
    *,
    patient: bool = False,
    at_rest: Fit | None = None,
) -> Fit:
    """The fit of all frames. What cannot matter beside `tolerance` [m], of the terms whose strengths alone are fitted
    and that no model gave, takes part in the last fit alone. fitted: makes each fit. patient: whether it begins again
    wherever a horizon leaves more than a right model, not the first alone where that is far more. at_rest: what shapes
    at rest say; where that is known, no horizon is looked at, and what they say is nothing takes no part at all."""
    right = expected_rms(data.noise, tolerance)
    much = right if patient else expected_rms(data.noise, 2 * tolerance)
    few = data.only(evenly(len(data.trials), EARLY_TRIALS).tolist())
    nothing: frozenset[str] = frozenset()
    lengths = horizons(data.samples)
    lengths = [horizon for horizon in lengths if horizon <= EARLY or horizon == lengths[-1]]
    if at_rest is not None:
        nothing = unneeded(at_rest)
        lengths, start = lengths[-1:], beginning(vector, at_rest, nothing)
    share = _AT_LAST if len(few.trials) < len(data.trials) else _AT_LAST / 4
    *told, at_last = parts(progress, *((1 - share) * np.cumsum(lengths) / sum(lengths)).tolist())
    expected = np.inf if vector.terms else right  # effects at nothing leave much
    stages = [
        _Stage(
            few.until(horizon),
            horizon,
            tolerance if horizon < lengths[-1] else 0.0,
            partial(fitted, expected=expected, progress=own),
        )
        for horizon, own in zip(lengths, told, strict=True)
    ]
    descent, untried = _Descent(vector, start, aside=nothing), bool(vector.terms) and at_rest is None
    for k, stage in enumerate(stages):
        descent = stage.after(descent)
        if untried and descent.left > much and (patient or k == 0):
            untried, other = False, _from_factors(vector, stages[0])
            for before in stages[: k + 1]:
                other = before.after(other)
            descent = min(descent, other, key=lambda one: one.left)
    if at_rest is not None and descent.fit is not None:
        shapes_tell = {label_effect(label) for label in shown(at_rest)}
        descent = descent.less(k for k in unneeded(descent.fit) if label_effect(k) not in shapes_tell)
        nothing = descent.aside
    there, index = vector.only(set(vector.labels) - nothing)
    return fitted(
        data, there, descent.x[index], named=f"{descent.named} at last".strip(), horizon=None, expected=expected,
        progress=at_last, jacobian=descent.jacobian[:, index] if len(few.trials) == len(data.trials) else None,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Descent:
    """A fit between horizons: all unknowns, where they are, and the terms that are off and take no part, by label.
    named: in what is said. at: which of the unknowns the last fit has."""

    vector: FitVector
    x: Array
    named: str = ""
    aside: frozenset[str] = frozenset()
    fit: Fit | None = None
    at: Indices | None = None

    @property
    def part(self) -> tuple[FitVector, Indices]:
        """The unknowns that take part, and which they are."""
        return self.vector.only([label for label in self.vector.labels if label not in self.aside])

    @property
    def left(self) -> float:
        """m RMS, capped."""
        return np.inf if self.fit is None else self.fit.after

    @property
    def jacobian(self) -> Array:
        """(N, p) m, of all unknowns: NaN for those that take no part."""
        assert self.fit is not None
        assert self.at is not None
        return widened(self.fit.state.jacobian, self.at, len(self.x))

    def less(self, labels: Iterable[str]) -> "_Descent":
        """Return the descent with more terms aside, by their labels among those that take part, and at nothing."""
        gone = {*labels}
        every = [label for label in self.vector.labels if label not in self.aside]
        more = {whole for whole, label in zip(every, self.part[0].labels, strict=True) if label in gone}
        x = self.x.copy()
        x[self.vector.parts(more)] = 0.0
        return replace(self, x=x, aside=self.aside | more)


@dataclass(frozen=True, eq=False)
class _Stage:
    """A horizon [s] of some trials. tolerance: m, beside which what cannot matter takes no part in the next."""

    data: MeasuredData
    horizon: float
    tolerance: float
    fitted: partial[Fit]

    def fit(self, vector: FitVector, start: Array, named: str) -> Fit:
        named = f"{named} to {self.horizon:g} s".strip()
        return self.fitted(self.data, vector, start, named=named, horizon=self.horizon)

    def after(self, descent: _Descent) -> _Descent:
        vector, index = descent.part
        found = self.fit(vector, descent.x[index], descent.named)
        x = np.zeros(len(descent.x))
        x[index] = found.x
        return replace(descent, x=x, fit=found, at=index).less(negligible(found, self.tolerance))


def _from_factors(vector: FitVector, first: _Stage) -> _Descent:
    """Where the factors alone lead over the first horizon, and effects at nothing: a cloth that buckles has false
    minima on either way."""
    plain = vector.without_effects
    return _Descent(vector, beside(vector, first.fit(plain, plain.start, "factors").x), "from factors")


def beside(vector: FitVector, factors: Array) -> Array:
    """(p,) of a vector's unknowns: factors, and effects at nothing."""
    x = np.zeros(len(vector.parameters))
    x[: len(factors)] = factors
    return x


def negligible(early: Fit, tolerance: float) -> frozenset[str]:
    """The terms that are well known and, two standard deviations off, move the residuals by less than half the
    `tolerance` [m] RMS, less what the other unknowns can take of that."""
    normal, vector = early.normal, early.vector
    share = normal.scale**2 / max(normal.tempering * float(normal.frames.sum()), 1e-12)
    ridged = normal.sensitivity + share * np.diag(1 / vector.prior**2)
    deviation = np.sqrt(np.diag(early.covariance))
    found = []
    for label, term in zip(vector.labels, vector.terms, strict=True):
        part = vector.part(label)
        others = np.setdiff1d(np.arange(len(early.x)), part)
        across = normal.sensitivity[np.ix_(part, others)]
        left = normal.sensitivity[np.ix_(part, part)] - across @ np.linalg.solve(
            ridged[np.ix_(others, others)], across.T
        )
        size = np.abs(early.x[part]) + 2 * deviation[part]
        most = float(size @ np.sqrt(np.maximum(np.diag(left), 0.0)))
        known = (deviation[part] <= KNOWN * vector.prior[part]).all()
        if known and most <= 0.5 * tolerance and _may_go(term, tuple(vector.parameters[k] for k in part)):
            found.append(label)
    return frozenset(found)


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
    """Not what a model gave, whether it is fitted or held."""
    keys = {parameter.name.rpartition(".")[2] for parameter in parameters}
    return bool(keys) and keys <= {*EFFECTS[term.name].strengths} - term.values.keys()

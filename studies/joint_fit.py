"""One fit of many effects, over growing horizons.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, the fit finds its way,
and what is not there comes out as nothing: what one horizon says for certain to be next to nothing takes no part in the
later ones, where a column costs a motion of every trial. Where cloth buckles, that way has false minima too, and what
the factors alone lead to may be nearer.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.forward import Term
from optimize.fit.clouds import Array, Indices, evenly
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
    by which it could move the residuals. moved: m^2, the mean square by which leaving it out moves those of the trial
    that it moves most, beyond what those that went before it do."""

    term: Term
    parameters: tuple[FitParameter, ...]
    x: Array
    deviation: Array
    most: float
    moved: float


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
    """The terms that are well known and, left out all together, move the residuals of no trial by more than half the
    `tolerance` [m] RMS, with what went `before` in quadrature, the least first: each of a cloth's muscles may be a
    little odd, and be driven in one trial alone. Not what does the same as one that is needed: it is next to nothing
    beside that one alone, and may be the one that acts."""
    vector, deviation, moves = early.vector, np.sqrt(np.diag(early.covariance)), _Moves(early)
    found = {}
    for label, term in zip(vector.labels, vector.terms, strict=True):
        part = vector.part(label)
        parameters = tuple(vector.parameters[k] for k in part)
        if (deviation[part] <= KNOWN * vector.prior[part]).all() and _may_go(term, parameters):
            size = np.abs(early.x[part]) + 2 * deviation[part]
            found[label] = Nothing(
                term, parameters, early.x[part], deviation[part], moves.at_most(part, size), moves.expected(part)
            )
    certain = needed(early.minimum, early.covariance, vector, NEEDED)
    same = {other for label in certain for other in alike(early.sensitivity, vector, label, [*found])}
    already = sum(of.moved for of in before.values())
    gone, so_far = dict[str, Nothing](), 0.0
    for label in sorted(found.keys() - same, key=lambda label: found[label].moved):
        together = moves.expected(vector.parts([*gone, label]))
        if already + together <= (0.5 * tolerance) ** 2:
            gone[label], so_far = replace(found[label], moved=together - so_far), together
    return gone


class _Moves:
    """By how much the residuals of a fit move where some unknowns are left out and the others take what they can."""

    def __init__(self, fit: Fit) -> None:
        self.fit, normal = fit, fit.normal
        share = normal.scale**2 / max(normal.tempering * float(normal.frames.sum()), 1e-12)
        self._ridged = normal.sensitivity + share * np.diag(1 / fit.vector.prior**2)
        trial, jacobian = fit.state.found.sample, np.nan_to_num(fit.state.jacobian)
        own = [trial == one for one in np.unique(trial)]
        weights = normal.frames * len(own) / max(float(normal.frames.sum()), 1e-12)
        self._of_trials = [(jacobian[rows] * weights[rows, None]).T @ jacobian[rows] for rows in own]  # m^2, (p, p)

    def at_most(self, part: Indices, size: Array) -> float:
        """m RMS, by unknowns of so many units, all to the same side."""
        unique = self._kept(part).T @ self.fit.normal.sensitivity[:, part]
        return float(size @ np.sqrt(np.maximum(np.diag(unique), 0.0)))

    def expected(self, part: Indices) -> float:
        """m^2, mean square of the trial that moves most, as far as the unknowns are known: of x and its covariance."""
        kept, x = self._kept(part), self.fit.x[part]
        squares = np.outer(x, x) + self.fit.covariance[np.ix_(part, part)]
        return max(float(np.sum((kept.T @ one @ kept) * squares)) for one in self._of_trials)

    def _kept(self, part: Indices) -> Array:
        """(p, k): these unknowns, less what the others do to make up for them."""
        others = np.setdiff1d(np.arange(len(self._ridged)), part)
        kept = np.zeros((len(self._ridged), len(part)))
        kept[part] = np.eye(len(part))
        kept[others] = -np.linalg.solve(
            self._ridged[np.ix_(others, others)], self.fit.normal.sensitivity[np.ix_(others, part)]
        )
        return kept


def _may_go(term: Term, parameters: Sequence[FitParameter]) -> bool:
    """Not what a model gave, whether it is fitted or held."""
    keys = {parameter.name.rpartition(".")[2] for parameter in parameters}
    return bool(keys) and keys <= {*EFFECTS[term.name].strengths} - term.values.keys()

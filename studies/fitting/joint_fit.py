"""One fit of many effects.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, frames in balance lead
near, and the fit of motions begins there: what is not needed there, or by a few trials, takes no part in the last fit,
where a column costs a motion of every trial.
"""

from collections.abc import Sequence

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.nouns.forward import Term
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.policy import ROUGH
from optimize.fit.significance import needed
from studies.fitting.fits import Fits, shown, starts_of
from studies.measured.fit_data import MeasuredData

MANY = 20  # unknowns, of which those that are not needed are not fitted on
EARLY_TRIALS = 8  # trials, by which effects without a tangent are asked for first
KEPT = 4.0  # of log likelihood: an effect that costs less to drop in balance, or by few trials, is not fitted on
_AT_LAST = 0.5  # of all work, where the last fit has more trials


def joint_fit(data: MeasuredData, vector: FitVector, fits: Fits, balanced: Fit | None) -> Fit:
    """Return the fit of all frames from where they are in balance. Where the factors alone end is no start: effects
    hide in them there, though it leaves less."""
    many = len(vector.parameters) > MANY
    nothing = unneeded(balanced) if balanced is not None and many else frozenset()
    there, index = vector.only(set(vector.labels) - nothing)
    starts = starts_of(vector, balanced, nothing)[:, index]
    if many and len(data.trials) > EARLY_TRIALS:
        early = fits.coarse.within(0.0, _AT_LAST)
        some = data.spread(EARLY_TRIALS)
        begun = early.fit(early.problem(some, there), FitStart(starts), ROUGH, "of few trials")
        certain = set() if balanced is None else {label_effect(label) for label in shown(balanced)}
        idle = {label for label in unneeded(begun) if label_effect(label) not in certain}
        x = begun.x.copy()
        x[there.parts(idle)] = 0.0
        there, index = there.only(set(there.labels) - idle)
        starts, fits = x[None, index], fits.within(_AT_LAST, 1.0)
    return fits.fit(fits.problem(data, there), FitStart(starts), fits.last(there), "at last")


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

"""One fit of many effects.

A fit without an effect goes to a false minimum, where a lag becomes damping. Where all may act, frames in balance lead
near, and the fit of motions begins there: what is not needed there, or by a few trials, takes no part in the last fit,
where a column costs a motion of every trial.
"""

from fabdesign.effects.registry import label_effect
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitVector
from optimize.fit.policy import ROUGH
from studies.fitting.fits import Fits, shown, starts_of, unneeded, worth_fitting
from studies.measured.fit_data import MeasuredData

MANY = 20  # unknowns, of which those that are not needed are not fitted on
EARLY_TRIALS = 8  # trials, by which effects without a tangent are asked for first
_AT_LAST = 0.5  # of all work, where the last fit has more trials


def joint_fit(data: MeasuredData, vector: FitVector, fits: Fits, balanced: Fit | None) -> Fit:
    """Return the fit of all frames from where they are in balance. Where the factors alone end is no start: effects
    hide in them there, though it leaves less."""
    many = len(vector.parameters) > MANY
    there = vector.only(worth_fitting(vector, balanced))[0] if many else vector
    starts = starts_of(there, balanced)
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

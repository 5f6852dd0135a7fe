"""The verdict of a trace: adequate, an effect, or unexplained."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.nouns.model import EffectTerm, Quantity

Word = Literal["adequate", "effect", "unexplained"]
LEAST_SHARE = 0.5  # of the excess, that its cause removes
GROSS = 2.0  # times the tolerance: what leaves more is not near a right model
STRUCTURE = 0.25  # of an excess, that the baseline, or one kind of feature, must take to count as structure

SO_FAR = "so far:"
_NAMED_SO_FAR = 3  # effects
_FIRST_CLAUSE = re.compile(r"[,;:]")


@dataclass(frozen=True)
class Evidence:
    """Excess held out, m: of the refitted model, with all effects that were certain, and of the baseline on what the
    first leaves.

    The baseline takes from what a model leaves that was fitted to all trials, so that its gain is over `fitted`, not
    over `before`, for which the declared parameters were fitted without the trial."""

    before: float
    after: float
    effects: int  # that were certain, and were added
    box_before: float
    structure: float = 0.0  # share of what the effects leave that one kind of feature takes of trials left out
    fitted: float | None = None  # m that the refitted model leaves of the trials that it was fitted to; None: `before`
    typical: float = 0.0  # m, the median over trials held out of what the refitted model leaves of each
    typical_after: float = math.inf  # m, the same with all effects
    drift: float = 0.0  # m by which it certainly changes from the first trial of the session to the last

    def adequate(self, tolerance: float) -> bool:
        """Return whether the refitted model leaves no more than the tolerance [m], in the mean and in the median, and
        does not change by more over the session."""
        return max(self.before, self.typical, self.drift) <= tolerance

    def explains_most_trials(self, tolerance: float) -> bool:
        """Return whether the effects bring half of the trials held out from beyond the tolerance [m] to within it,
        whatever they leave of single ones. Such a trial may stand at another stable shape, or, held out, need a factor
        that the others do not fix."""
        return self.typical > tolerance >= self.typical_after


def decide(evidence: Evidence, tolerance: float) -> Word:
    """Return the verdict by the rules of docs/trace.md. tolerance: m."""
    if evidence.adequate(tolerance):
        return "adequate"
    if evidence.effects == 0:
        return "unexplained"
    if evidence.after <= tolerance:
        return "effect"
    if evidence.structure > STRUCTURE:  # the nearest of the wrong names
        return "unexplained"
    if evidence.explains_most_trials(tolerance):
        return "effect"
    most = min(GROSS * tolerance, (1 - LEAST_SHARE) * evidence.before)
    return "effect" if evidence.after <= most else "unexplained"


def explains(evidence: Evidence) -> float | None:
    """Return the share of the gap to the noise floor that the effects close; None where the baseline finds no gap."""
    if evidence.before <= 0 or evidence.box_before >= evidence.before:
        return None
    return 1 - evidence.after / evidence.before


def so_far(labels: Sequence[str]) -> str:
    """Return what a trace thinks after its joint fit, before what is needed has been confirmed by trials left out."""
    if not labels:
        return f"{SO_FAR} no effect is needed; being confirmed"
    effects = [EFFECTS[label_effect(label)] for label in labels[:_NAMED_SO_FAR]]
    named = " and ".join(f"{e.name.replace('_', ' ')} ({_FIRST_CLAUSE.split(e.what)[0]})" for e in effects)
    more = f" and {len(labels) - _NAMED_SO_FAR} more" if len(labels) > _NAMED_SO_FAR else ""
    return f"{SO_FAR} {named}{more}; being confirmed"


def effect_in_words(effect: EffectTerm) -> str:
    values = ", ".join(f"{name.replace('_', ' ')} {_value(q)}" for name, q in effect.parameters.items())
    return f"{effect.name.replace('_', ' ')} ({values})"


def _value(quantity: Quantity) -> str:
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    if quantity.interval90 is None:
        return f"{quantity.value:.3g}{unit}"
    return f"{quantity.value:.3g}{unit}, 90 % {quantity.interval90[0]:.3g} to {quantity.interval90[1]:.3g}"

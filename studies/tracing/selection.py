"""This module selects effects: one joint fit of all, then those are dropped again that the data do not need.

Around the false minimum that a fit without them goes to the wrong names come first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.geometry.metrics import over
from optimize.fit.cross_validation import LeftOut
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.policy import AT_REST, NEAR, Policy
from optimize.fit.significance import NEEDED, cheapest_first, conditioned, cost, needed
from studies.fitting.intervals import expected_rms
from studies.fitting.joint_fit import beside, joint_fit
from studies.fitting.rest_fit import beginning, fit_at_rest
from studies.model_selection.judged import Judged, is_certain
from studies.model_selection.rules import ON_SETS, Selection, below, follow
from studies.model_selection.verdict import so_far
from studies.tracing.reduction import promised, reduced
from studies.tracing.refits import SetRefits, to_first_order
from studies.tracing.task import Task

SLIGHT = 2.0  # times the tolerance: what leaves no more is near the minimum, and the joint fit begins there
PROMISING = 0.5  # of what the declared parameters leave: where one effect promises to leave more, it is not all
HOPELESS = 4.0  # times the tolerance: what leaves more is not refined before the joint fit


def select(task: Task) -> Selection:
    """Select effects by one joint fit, then backwards, to first order: dropped is what its joint covariance does not
    need, then what trials left out gain too little by. What stays is fitted with its shapes and tried once more, and of
    several each by a fit without it."""
    every = fit_vector(["all"], factors=task.factors, designs=task.designs)
    vector = without(every, task.known)
    at_rest = fit_at_rest(task.data, task.fits, vector)
    begun = _Begun.over_horizons(task, vector) if at_rest is None else _Begun.at_rest(task, vector, at_rest)
    excess = _excess(task, begun.plain)
    if excess <= task.tolerance and begun.plain.vector.is_plausible(begun.plain.x):
        task.say(so_far(()))
        begin = FitStart(begun.plain.minimum, inputs=begun.plain.inputs)
        return _adequate(task, vector, task.fit("plain to its end", begun.plain.vector, begin))
    everything = begun.joint(excess)
    task.say(so_far(needed(everything.minimum, everything.covariance, everything.vector, NEEDED)))
    selection = backwards(SetRefits(task), everything, task.weighed(begun.plain, everything.inputs))
    return replace(selection, at_rest=at_rest)


@dataclass(frozen=True)
class _Begun:
    """Where a trace begins. plain: the declared parameters alone, as far as they are not hopeless. joint: makes the fit
    of every effect from what the plain one leaves of trials left out [m]."""

    plain: Fit
    joint: Callable[[float], Fit]

    @staticmethod
    def over_horizons(task: Task, vector: FitVector) -> "_Begun":
        """Begin at the data sheet. Where the declared parameters leave little, the residuals are nearly linear about
        them, and the joint fit begins there: from the data sheet a cloth that snaps leads it astray. Not where they had
        to go where no specimen is: an effect hides in them then."""
        plain = task.fit("plain", vector.without_effects, FitStart(), _hopeful(task))

        def joint(excess: float) -> Fit:
            near = excess <= SLIGHT * task.tolerance and plain.vector.is_plausible(plain.x)
            start = beside(vector, plain.x) if near else vector.start
            return joint_fit(task.data, vector, start, replace(task.fits, named="every effect"))

        return _Begun(plain, joint)

    @staticmethod
    def at_rest(task: Task, vector: FitVector, at_rest: Fit) -> "_Begun":
        """Begin where shapes at rest are fitted: so near that no horizon is looked at, and that one Jacobian leads."""
        begin = beginning(vector, at_rest, ())
        inputs = task.input_errors(vector, begin)
        factors = np.stack([x[vector.are_factors] for x in (beginning(vector, at_rest, at_rest.vector.labels), begin)])
        plain = task.fit("plain", vector.without_effects, FitStart(factors, inputs=inputs), _hopeful(task))
        start = FitStart(begin, inputs=inputs)
        return _Begun(plain, lambda _: task.fit("every effect", vector, start, AT_REST))


def _hopeful(task: Task) -> Policy:
    """Return how the declared parameters are fitted before any effect is looked at."""
    return replace(NEAR, hopeless=expected_rms(task.data.noise, HOPELESS * task.tolerance))


def backwards(refits: SetRefits, everything: Fit, plain: Fit) -> Selection:
    """Return what the rules leave of a joint fit. plain: where the declared parameters ended by themselves, by the
    weights of `everything`."""
    labels, small = worth(refits, everything)
    if not labels:
        alone = refits.alone(everything, plain)
        return Selection(everything, alone, refits.judged(alone), small=tuple(small))
    known = enough(refits, everything, labels, plain)
    exact = known is not None
    if known is None:
        fewer, labels = reduced(refits.task, everything, labels)
        known = refits.of(fewer, labels)
    judged, of_all = refits.judged(known), refits.judged(everything).excess
    begun = Selection(everything, plain, judged, of_all, tuple(small), most=judged, exact=exact)
    return follow(ON_SETS, refits, begun)


def _excess(task: Task, fitted: Fit) -> float:
    """Return m that a fit leaves of trials left out, in their mean or, where that is more, in their median."""
    scored = LeftOut.of(fitted, task.data.folds).scored()
    return max(scored.excess(task.floor), scored.typical(task.floor))


def _adequate(task: Task, vector: FitVector, plain: Fit) -> Selection:
    """Return the selection where the declared parameters explain all: effects take part to first order."""
    everything = task.linearised(
        "every effect beside them", vector, FitStart(beside(vector, plain.x), inputs=plain.inputs)
    )
    small = sparse(everything, needed(everything.minimum, everything.covariance, vector, NEEDED))
    return Selection(everything, plain, SetRefits(task).judged(plain), small=tuple(small))


def without(vector: FitVector, known: Sequence[str]) -> FitVector:
    """Return a vector less the effects that the model has already."""
    labels = [label for label, term in zip(vector.labels, vector.terms, strict=True) if term.name not in known]
    return vector.only(labels)[0]


def worth(refits: SetRefits, everything: Fit) -> tuple[list[str], list[str]]:
    """Return the terms that the joint fit says the data need, and those that trials left out gain too little by, to
    first order. Shapes are not fitted yet, so what is left says nothing."""
    vector, judged = everything.vector, refits.judged(everything)
    certain = needed(everything.minimum, everything.covariance, vector, NEEDED)
    labels = _with_channels(judged, refits.tolerance, certain, sparse(everything, certain))
    dropped = [label for label in vector.labels if label not in labels]
    stays = partial(refits.matters_elsewhere, everything)
    small = below(judged, labels, dropped, refits.tolerance, stays)
    return [label for label in labels if label not in small], small


def _with_channels(judged: Judged, tolerance: float, certain: Sequence[str], few: Sequence[str]) -> list[str]:
    """Return the sparse terms, and the other channels of their effects where trials left out gain by them together. A
    place moves to where it is in a fit."""
    vector, trials = judged.fit.vector, judged.trials
    kept = [label for label in certain if label in few or _sits_in_a_channel(label)]
    one, all_of_them = (
        trials.scored(vector.parts([label for label in vector.labels if label not in on])) for on in (few, kept)
    )
    several = len(kept) > len(few) and is_certain(trials.gain(one, all_of_them, judged.floor), tolerance)
    return kept if several else [*few]


def _sits_in_a_channel(label: str) -> bool:
    effect = EFFECTS[label_effect(label)]
    return bool(effect.chosen) and all(effect.parameters[name].whole for name in effect.chosen)


def sparse(everything: Fit, labels: Sequence[str]) -> list[str]:
    """Return the terms, and of several places or channels of one effect only the one that costs most to drop."""
    x, covariance = everything.minimum, everything.covariance
    costs = {label: cost(x, covariance, everything.vector.part(label)) for label in labels}
    best: dict[str, str] = {}
    for label in sorted(labels, key=lambda label: costs[label]):
        best[label_effect(label)] = label
    return [label for label in labels if label in best.values()]


def enough(refits: SetRefits, everything: Fit, labels: Sequence[str], plain: Fit) -> Fit | None:
    """Return the fit with the one effect that costs most to drop, if it leaves as little as all together do, to first
    order: the joint fit shares its effect among others, which go only slowly one by one. It is not tried where it
    promises to leave more, and over half of what `plain` leaves."""
    vector = everything.vector
    off = vector.parts(label for label in vector.labels if label not in labels)
    there = conditioned(everything.minimum, everything.covariance, off)
    *_, (strongest, _, _) = cheapest_first(*there, {label: vector.part(label) for label in labels})
    least = promised(everything, everything.minimum)
    promise = promised(everything, to_first_order(everything, [strongest]))
    if promise > PROMISING * plain.after and over(promise, least) > refits.tolerance:
        return None
    hopeless = float(np.hypot(least, refits.tolerance))
    one = refits.of(everything, [strongest], hopeless=hopeless, exact=True, named=f"{strongest} alone")
    fits = over(one.after, least) <= 0.5 * refits.tolerance
    return one if fits and not refits.needed_elsewhere(everything, one, vector.inside(there[0])) else None

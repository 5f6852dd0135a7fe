"""This module selects effects: one joint fit of all, then those are dropped again that the data do not need.

Around the false minimum that a fit without them goes to the wrong names come first.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.geometry.metrics import over
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Term
from fabdesign.units import in_mm
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.policy import DECLARED_ALONE, ROUGH
from optimize.fit.significance import NEEDED, cheapest_first, conditioned, cost, needed
from studies.fitting.fits import fit_in_balance, starts_of
from studies.fitting.fitted_model import expected_rms
from studies.model_selection.judged import Judged, certain_drift, is_certain
from studies.model_selection.rules import ON_SETS, Selection, below, follow
from studies.model_selection.verdict import GROSS, LEAST_SHARE, so_far
from studies.tracing.task import Task, to_first_order

HOPELESS = 4.0  # times the tolerance: what leaves more is not refined before the joint fit


def select(task: Task) -> Selection:
    """Select effects by one joint fit, then backwards, to first order: dropped is what its joint covariance does not
    need, then what trials left out gain too little by. What stays is fitted with its shapes and tried once more, and of
    several each by a fit without it."""
    vector = without(fit_vector(["all"], factors=task.factors, designs=task.designs), task.known)
    factors = vector.without_effects
    balanced = fit_in_balance(task.data, task.fits, vector)
    hopeful = replace(ROUGH, hopeless=expected_rms(task.data.noise, HOPELESS * task.tolerance))
    plain = task.fit("plain", factors, FitStart(starts_of(factors, balanced)), hopeful)
    judged = task.judged(plain)
    excess = max(judged.excess, judged.typical)
    drift = certain_drift(judged, task.data.session[:, 0])
    if max(excess, drift) <= task.tolerance and plain.vector.is_plausible(plain.x):
        task.say(so_far(()))
        to_its_end = FitStart(plain.minimum, plain.state.jacobian, plain.inputs)
        plain = task.fit("plain to its end", plain.vector, to_its_end, DECLARED_ALONE)
        return replace(_adequate(task, vector, plain), drift=drift)
    starts = starts_of(vector, balanced)
    if excess <= GROSS * task.tolerance and plain.vector.is_plausible(plain.x):
        # the residuals are nearly linear there; where factors had to go where no specimen is, an effect hides in them
        starts = np.concatenate([starts, starts_of(vector, plain)])
    policy = ROUGH if balanced is None else replace(ROUGH, content=expected_rms(task.data.noise, task.tolerance))
    everything = task.fit("every effect", vector, FitStart(starts), policy)
    task.say(so_far(needed(everything.minimum, everything.covariance, everything.vector, NEEDED)))
    return replace(backwards(task, everything, task.weighed(plain, everything.inputs)), drift=drift)


def backwards(task: Task, everything: Fit, plain: Fit) -> Selection:
    """Return what the rules leave of a joint fit. plain: where the declared parameters ended by themselves, by the
    weights of `everything`."""
    labels, small = worth(task, everything)
    if not labels:
        alone = task.judged(task.alone(everything, plain))
        return Selection(everything, alone, alone, small=tuple(small))
    known = enough(task, everything, labels, plain)
    exact = known is not None
    if known is None:
        fewer, labels = reduced(task, everything, labels)
        known = task.with_effects(fewer, labels)
    judged, of_all = task.judged(known), task.judged(everything).excess
    begun = Selection(everything, task.judged(plain), judged, of_all, tuple(small), exact=exact)
    return follow(ON_SETS, task, begun)


def _adequate(task: Task, vector: FitVector, plain: Fit) -> Selection:
    """Return the selection where the declared parameters explain all: effects take part to first order."""
    beside = np.pad(plain.x, (0, len(vector.parameters) - len(plain.x)))
    everything = task.linearised("every effect beside them", vector, FitStart(beside, inputs=plain.inputs))
    small = sparse(everything, needed(everything.minimum, everything.covariance, vector, NEEDED))
    judged = task.judged(plain)
    return Selection(everything, judged, judged, small=tuple(small))


def without(vector: FitVector, known: Sequence[str]) -> FitVector:
    """Return a vector less the effects that the model has already."""
    labels = [label for label, term in zip(vector.labels, vector.terms, strict=True) if term.name not in known]
    return vector.only(labels)[0]


def worth(task: Task, everything: Fit) -> tuple[list[str], list[str]]:
    """Return the terms that the joint fit says the data need, and those that trials left out gain too little by, to
    first order; the last is asked by a fit. Shapes are not fitted yet, so what is left says nothing."""
    vector, judged = everything.vector, task.judged(everything)
    certain = needed(everything.minimum, everything.covariance, vector, NEEDED)
    labels = _with_channels(judged, task.tolerance, certain, sparse(everything, certain))
    dropped = [label for label in vector.labels if label not in labels]

    def stays(off: Sequence[str], label: str) -> bool:
        return all(other in off for other in labels if other != label) or task.matters_elsewhere(everything, off, label)

    small = below(judged, labels, dropped, task.tolerance, stays)
    return [label for label in labels if label not in small], small


def _with_channels(judged: Judged, tolerance: float, certain: Sequence[str], fewer: Sequence[str]) -> list[str]:
    """Return the sparse terms, and the other channels of their effects where trials left out gain by them together. A
    place moves to where it is in a fit."""
    vector, trials = judged.fit.vector, judged.trials
    kept = [label for label in certain if label in fewer or _sits_in_a_channel(label)]
    one, all_of_them = (
        trials.scored(vector.parts([label for label in vector.labels if label not in on])) for on in (fewer, kept)
    )
    several = len(kept) > len(fewer) and is_certain(trials.gain(one, all_of_them, judged.floor), tolerance)
    return kept if several else [*fewer]


def _sits_in_a_channel(label: str) -> bool:
    effect = EFFECTS[label_effect(label)]
    return bool(effect.chosen) and all(effect.parameters[name].integer for name in effect.chosen)


def sparse(everything: Fit, labels: Sequence[str]) -> list[str]:
    """Return the terms, and of several places or channels of one effect only the one that costs most to drop."""
    x, covariance = everything.minimum, everything.covariance
    costs = {label: cost(x, covariance, everything.vector.part(label)) for label in labels}
    best: dict[str, str] = {}
    for label in sorted(labels, key=lambda label: costs[label]):
        best[label_effect(label)] = label
    return [label for label in labels if label in best.values()]


def enough(task: Task, everything: Fit, labels: Sequence[str], plain: Fit) -> Fit | None:
    """Return the fit with the one effect that costs most to drop, if it leaves as little as all together do, to first
    order: the joint fit shares its effect among others, which go only slowly one by one. It is not tried where it
    promises to leave more, and over half of what `plain` leaves."""
    vector = everything.vector
    off = vector.parts(label for label in vector.labels if label not in labels)
    there = conditioned(everything.minimum, everything.covariance, off)
    *_, (strongest, _, _) = cheapest_first(*there, {label: vector.part(label) for label in labels})
    least = everything.promised(everything.minimum)
    promise = everything.promised(to_first_order(everything, [strongest]))
    if promise > (1 - LEAST_SHARE) * plain.after and over(promise, least) > task.tolerance:
        return None
    hopeless = float(np.hypot(least, task.tolerance))
    one = task.with_effects(everything, [strongest], hopeless=hopeless, jacobian="anew", named=f"{strongest} alone")
    fits = over(one.after, least) <= 0.5 * task.tolerance
    return one if fits and not task.needed_elsewhere(everything, one, vector.inside(there[0])) else None


@dataclass(frozen=True, eq=False)
class Begin:
    """Where a fit without some effects begins. jacobian: (N, p) m, of the fit with them. rms, promised: m of residuals
    capped at 10 mm, as simulated and to first order."""

    vector: FitVector
    x: Array
    jacobian: Array
    rms: float
    promised: float


def reduced(task: Task, joint: Fit, labels: Collection[str]) -> tuple[Fit, list[str]]:
    """Return from where a fit of the terms `labels` alone may begin: the joint fit, or one without some other terms;
    and their labels there, with those of what must stay beside them.

    Where the tolerance more than first order promises is left without all the others, in quadrature, only half as many
    go at once, the cheapest first, and what stays is fitted before the next, by the joint fit's own Jacobian as long as
    that leads on. One that leaves more by itself, fitted too, stays."""
    known, wanted, stage = joint, _terms(joint, labels), 0
    while dropped := _cheapest_first(known, wanted):
        begin = begin_without(task, known, dropped)
        if _holds(task, begin):
            break
        while len(dropped) > 1 and not _holds(task, begin):
            dropped = dropped[: (len(dropped) + 1) // 2]
            begin = begin_without(task, known, dropped)
        stage += 1
        without = f"{in_mm(begin.rms):.3f} mm RMS without {', '.join(dropped)}"
        task.say(f"{without}; to first order {in_mm(begin.promised):.3f}")
        fitted = task.fit(f"fewer {stage}", begin.vector, FitStart(begin.x, begin.jacobian, known.inputs), ROUGH)
        if over(fitted.after, begin.promised) > task.tolerance:
            wanted += _terms(known, dropped)
        else:
            known = fitted
    return known, _labels(known, wanted)


def begin_without(task: Task, known: Fit, labels: Collection[str]) -> Begin:
    """Return where a fit without the terms `labels` begins: the better of where the joint covariance says the others
    then are and where they are with them."""
    there = known.without(labels)
    vector, index = known.vector.only([label for label in known.vector.labels if label not in labels])
    rms, x = task.nearest(vector, [there[index], known.x[index]])
    return Begin(vector, x, known.state.jacobian[:, index], rms, known.promised(there))


def _holds(task: Task, begin: Begin) -> bool:
    return over(begin.rms, begin.promised) <= task.tolerance


def _terms(known: Fit, labels: Collection[str]) -> list[Term]:
    """Return terms by label: a label changes where it is the last of its effect, its term does not."""
    return [term for label, term in zip(known.vector.labels, known.vector.terms, strict=True) if label in labels]


def _labels(known: Fit, terms: Sequence[Term]) -> list[str]:
    return [label for label, term in zip(known.vector.labels, known.vector.terms, strict=True) if term in terms]


def _cheapest_first(known: Fit, wanted: Sequence[Term]) -> list[str]:
    """Return the labels of all other terms, in the order in which they are dropped to first order."""
    kept = _labels(known, wanted)
    others = {label: known.vector.part(label) for label in known.vector.labels if label not in kept}
    return [name for name, *_ in cheapest_first(known.minimum, known.covariance, others)]

"""This module selects effects: one joint fit of all, of which those stay that there is evidence for.

Around the false minimum that a fit without them goes to the wrong names come first.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.policy import DECLARED_ALONE, ROUGH
from optimize.fit.problem import widened
from optimize.fit.relevance import evidence
from optimize.fit.significance import NEEDED, cost, needed
from studies.fitting.fits import starts_of, worth_fitting
from studies.fitting.fitted_model import expected_rms
from studies.model_selection.judged import certain_drift
from studies.model_selection.rules import ON_SETS, Selection, follow
from studies.model_selection.verdict import GROSS, so_far
from studies.tracing.task import Task

HOPELESS = 4.0  # times the tolerance: what leaves more is not refined before the joint fit


def every_unknown(task: Task) -> FitVector:
    """Return the declared parameters and all effects but those that the model has already."""
    return without(fit_vector(["all"], factors=task.factors, designs=task.designs), task.known)


def select(task: Task, vector: FitVector, balanced: Fit | None) -> Selection:
    """Select effects by one joint fit of a vector: those that it has evidence for are fitted with their shapes. Then
    rules drop what trials left out gain too little by. balanced: what frames in balance say."""
    factors, starts = vector.without_effects, starts_of(vector, balanced)
    inputs = task.input_errors(vector, starts[0])
    hopeful = replace(ROUGH, hopeless=expected_rms(task.data.noise, HOPELESS * task.tolerance))
    plain = task.fit("plain", factors, FitStart(starts_of(factors, balanced), inputs=inputs), hopeful)
    judged = task.judged(plain)
    excess = max(judged.excess, judged.typical)
    drift = certain_drift(judged, task.data.session[:, 0])
    if max(excess, drift) <= task.tolerance and plain.vector.is_plausible(plain.x):
        task.say(so_far(()))
        to_its_end = FitStart(plain.minimum, plain.state.jacobian, plain.inputs)
        plain = task.fit("plain to its end", plain.vector, to_its_end, DECLARED_ALONE)
        return replace(_adequate(task, vector, plain), drift=drift)
    if excess <= GROSS * task.tolerance and plain.vector.is_plausible(plain.x):
        # the residuals are nearly linear there; where factors had to go where no specimen is, an effect hides in them
        starts = np.concatenate([starts, starts_of(vector, plain)])
    everything = with_all_effects(task, vector, FitStart(starts, inputs=inputs), balanced)
    return replace(backwards(task, everything, plain), drift=drift)


def with_all_effects(task: Task, vector: FitVector, start: FitStart, balanced: Fit | None) -> Fit:
    """Return the joint fit: of what frames in balance have evidence for, with all other effects to first order beside
    it. Where that does not explain most trials, of all."""
    if balanced is None:
        return task.fit("every effect", vector, start, ROUGH)
    assert start.x is not None
    policy = replace(ROUGH, content=expected_rms(task.data.noise, task.tolerance))
    some, places = vector.only(worth_fitting(vector, balanced) & {*balanced.vector.labels})
    known = task.fit("what frames in balance show", some, replace(start, x=start.x[:, places]), policy)
    x, jacobian = np.zeros(len(vector.names)), widened(known.state.jacobian, places, len(vector.names))
    x[places] = known.x
    beside = FitStart(x, jacobian, known.inputs)
    if task.judged(known).typical > task.tolerance:
        return task.fit("every effect", vector, beside, policy)
    return task.linearised("every effect beside it", vector, beside)


def backwards(task: Task, everything: Fit, plain: Fit) -> Selection:
    """Return what the rules leave of the terms that a joint fit has evidence for. plain: where the declared parameters
    ended by themselves."""
    labels = with_evidence(everything)
    task.say(so_far(labels))
    if not labels:
        alone = task.judged(task.alone(everything, plain))
        return Selection(everything, alone, alone)
    known = task.judged(task.with_effects(everything, labels))
    begun = Selection(everything, task.judged(plain), known, task.judged(everything).excess)
    return follow(ON_SETS, task, begun)


def _adequate(task: Task, vector: FitVector, plain: Fit) -> Selection:
    """Return the selection where the declared parameters explain all: effects take part to first order."""
    beside = np.pad(plain.x, (0, len(vector.parameters) - len(plain.x)))
    everything = task.linearised("every effect beside them", vector, FitStart(beside, inputs=plain.inputs))
    judged = task.judged(plain)
    return Selection(everything, judged, judged, small=tuple(with_evidence(everything)))


def without(vector: FitVector, known: Sequence[str]) -> FitVector:
    """Return a vector less the effects that the model has already."""
    labels = [label for label, term in zip(vector.labels, vector.terms, strict=True) if term.name not in known]
    return vector.only(labels)[0]


def with_evidence(everything: Fit) -> list[str]:
    """Return the terms of the effects that a joint fit has evidence for: of channels all that the data need, of places
    the one that costs most to drop."""
    x, covariance, vector = everything.minimum, everything.covariance, everything.vector
    groups: dict[str, list[str]] = {}
    for label in vector.labels:
        groups.setdefault(label_effect(label), []).append(label)
    score = evidence(everything, {name: vector.parts(labels) for name, labels in groups.items()})
    certain = needed(x, covariance, vector, NEEDED)
    terms: list[str] = []
    for name, labels in groups.items():
        if score[name] >= NEEDED:
            best = max(labels, key=lambda label: cost(x, covariance, vector.part(label)))
            terms += [label for label in labels if label == best or (label in certain and _is_in_a_channel(name))]
    return terms


def _is_in_a_channel(name: str) -> bool:
    effect = EFFECTS[name]
    return bool(effect.chosen) and all(effect.parameters[key].integer for key in effect.chosen)

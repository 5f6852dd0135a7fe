"""Fits with fewer effects than another, from where that is and on its Jacobian; and what they lose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.nouns.forward import Term
from optimize.fit.clouds import Array
from optimize.fit.cross_validation import Gain, LeftOut, Scored
from optimize.fit.fitted import Fit
from optimize.fit.normal import loss
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.problem import Evaluation, widened
from optimize.fit.significance import NEEDED, conditioned
from studies.tracing.task import Place, Task

CLOSE = 2.0  # of log likelihood, a quarter of what makes an effect needed: a step that promises less is the last


def with_shapes(joint: Fit, labels: Sequence[str]) -> tuple[FitVector, Array]:
    """Return the factors and these terms with all of their parameters that are no choice of a whole number, and (2, p)
    where a joint fit says they are with the others off: to first order, and as they are with the others there, which
    is nearer where these are far from small."""
    gone = joint.vector.parts(label for label in joint.vector.labels if label not in labels)
    places = [joint.minimum]
    if len(gone):
        places.insert(0, conditioned(joint.minimum, joint.covariance, gone)[0])
    vector, index = joint.vector.only(labels)
    known = [dict(zip(vector.names, vector.inside(x[index]), strict=True)) for x in places]
    parameters = [p for p in vector.parameters if p.is_factor]
    for label, term in zip(vector.labels, vector.terms, strict=True):
        effect = EFFECTS[term.name]
        for key, p in effect.parameters.items():
            if not p.whole:
                name = f"{label}.{key}"
                unknown = FitParameter(name, p.deviation, p.centre, p.transform, p.unit, p.bounds)
                begin = known[0].get(name, unknown.unknown(term.values.get(key, p.typical)))
                parameters.append(replace(unknown, start=begin))
    terms = tuple(_chosen_only(term) for term in vector.terms)
    whole = FitVector(tuple(parameters), vector.factors, terms)
    return whole, np.array([[of.get(p.name, p.start) for p in parameters] for of in known])


def fit_of(
    task: Task,
    known: Fit,
    labels: Sequence[str],
    *,
    hopeless: float = np.inf,
    sure: bool = False,
    named: str | None = None,
) -> Fit:
    """Return a fit of these effects alone, from where one with more is, on its Jacobian but for shapes that it has not.
    hopeless: m RMS, of a fit that need not be refined. sure: whether its Jacobian is made where it ends."""
    vector, starts = with_shapes(known, labels)
    fewer, index = known.vector.only(labels)
    at = [vector.names.index(name) for name in fewer.names]
    jacobian = widened(known.state.jacobian[:, index], at, len(vector.names))
    named = named or f"{' '.join(vector.labels)}{' at last' if sure else ''}"
    return task.fit(named, vector, known.inputs, starts, close=CLOSE, hopeless=hopeless, sure=sure, jacobian=jacobian)


def fit_without(task: Task, known: Fit, labels: Sequence[str], *, hopeless: float = np.inf) -> Fit:
    """Return a fit of the effects of another but `labels`, as `fit_of` has it."""
    return fit_of(task, known, [other for other in known.vector.labels if other not in labels], hopeless=hopeless)


def fit_alone(task: Task, known: Fit, plain: Fit) -> Fit:
    """Return the declared parameters' fit, from where they are by themselves or beside the effects of a fit, whichever
    is nearer: what one of their false minima leaves is nothing that an effect explains."""
    vector, starts = with_shapes(known, [])
    return task.fit("plain to its end", vector, known.inputs, np.array([plain.minimum, *starts]))


def _chosen_only(term: Term) -> Term:
    """What a fit of all parameters does not move."""
    return replace(term, values={k: v for k, v in term.values.items() if EFFECTS[term.name].parameters[k].whole})


def is_certain(gain: Gain, least: float) -> bool:
    """least: m."""
    return gain[0] >= least and gain[1][0] > 0


@dataclass(frozen=True, eq=False)
class Judged:
    """A fit and what trials left out say of it, and of those with fewer effects. What goes one after another must not
    add up, so these are compared with the one with most effects."""

    task: Task
    fit: Fit

    @cached_property
    def trials(self) -> LeftOut:
        return LeftOut.of(self.fit, self.task.data.folds)

    @cached_property
    def scored(self) -> Scored:
        """Of trials left out."""
        return self.trials.scored()

    def loses(self, simpler: Fit, least: float, cause: bool) -> bool:
        """Whether a fit with fewer effects does not do as well. As well: trials left out lose under `least` [m], or not
        for certain, and, where what it lacks may be a `cause`, either the data lose too little, or other layouts differ
        by less than the tolerance."""
        if self.predicts_better(simpler, least):
            return True
        return cause and needed_elsewhere(self.task, self.fit, self.fit.x, simpler)

    def predicts_better(self, other: Fit, least: float) -> bool:
        """Whether trials left out lose `least` [m] by another fit, and that for certain."""
        without, own = LeftOut.of(other, self.task.data.folds).scored(), self.scored
        alike = replace(own, squares=own.squares * without.weights / np.maximum(own.weights, 1e-12))
        return is_certain(self.trials.gain(without, alike, self.task.floor), least)


def needed_elsewhere(task: Task, known: Fit, x: Array, simpler: Fit) -> bool:
    """Whether the data lose by a simpler fit, and other layouts move otherwise than where `known` has its unknowns x
    (p,)."""
    return _lost(task, known, simpler) >= NEEDED and task.matters_elsewhere(
        Place(known.vector, x), Place(simpler.vector, simpler.x)
    )


def _lost(task: Task, known: Fit, other: Fit) -> float:
    """Of log likelihood and prior, what a fit with fewer effects loses; shapes that `known` has not cost nothing."""
    x = np.zeros(len(known.x))
    places = {name: k for k, name in enumerate(known.vector.names)}
    labels = {
        label: _label_in(known.vector, t) for label, t in zip(other.vector.labels, other.vector.terms, strict=True)
    }
    for name, value in zip(other.vector.names, other.x, strict=True):
        label, dot, key = name.rpartition(".")
        if (place := places.get(f"{labels.get(label, label)}{dot}{key}")) is not None:
            x[place] = value
    there = Evaluation(x, other.state.sheets, other.state.found)
    return loss(task.data.samples, known.state, there, known.normal, np.diag(1 / known.vector.prior**2), known.inputs)


def _label_in(vector: FitVector, term: Term) -> str:
    """Of a term in a vector: that of the same effect, of several in the same channel."""
    own = [(label, other) for label, other in zip(vector.labels, vector.terms, strict=True) if other.name == term.name]
    whole = _chosen_only(term).values
    return own[0][0] if len(own) == 1 else next(label for label, other in own if _chosen_only(other).values == whole)

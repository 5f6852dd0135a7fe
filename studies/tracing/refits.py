"""Fits of a set with fewer effects than another, from where that is and on its Jacobian."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Term
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.normal import loss
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.policy import FitStage, Policy
from optimize.fit.problem import Evaluation, widened
from optimize.fit.significance import NEEDED
from studies.model_selection.decoys import Decoys, decoys_beside
from studies.model_selection.judged import Judged
from studies.model_selection.rules import Refits
from studies.tracing.reduction import promised
from studies.tracing.task import Place, Task

# A step is the last that promises less than a quarter, in log likelihood, of what makes an effect needed.
_LAST = FitStage(slight=0.01, least=NEEDED / 4, exact_end=False)
ASKED = Policy("fewer effects", _LAST, _LAST)


@dataclass(frozen=True, eq=False)
class SetRefits(Refits):
    """Fits of a set's motions that rules ask for (`rules.Refits`)."""

    task: Task

    @property
    def tolerance(self) -> float:  # type: ignore[override]
        """Return the tolerance, m of excess."""
        return self.task.tolerance

    def say(self, line: str) -> None:
        """Tell what is done."""
        self.task.say(line)

    def judged(self, fit: Fit) -> Judged:
        """Return a fit with what trials left out say of it."""
        return Judged(fit, self.task.data.folds, self.task.floor)

    def of(
        self, known: Fit, labels: Sequence[str], *, hopeless: float = np.inf, exact: bool = False, named: str = ""
    ) -> Fit:
        """Return a fit of these effects alone, from where one with more is, on its Jacobian but for shapes that it has
        not. hopeless: m RMS, of a fit that need not be refined. exact: whether it begins on a Jacobian of its own."""
        vector, starts = with_shapes(known, labels)
        fewer, index = known.vector.only(labels)
        at = [vector.names.index(name) for name in fewer.names]
        jacobian = None if exact else widened(known.state.jacobian[:, index], at, len(vector.names))
        named = named or f"{' '.join(vector.labels)}{' at last' if exact else ''}"
        content = float(np.hypot(promised(known, to_first_order(known, labels)), 0.5 * self.tolerance))
        policy = replace(ASKED, hopeless=hopeless, content=content)
        return self.task.fit(named, vector, FitStart(starts, jacobian, known.inputs), policy)

    def without(self, known: Fit, labels: Sequence[str], *, hopeless: float = np.inf) -> Fit:
        """Return a fit of the effects of another but `labels`, as `of` has it."""
        return self.of(known, [other for other in known.vector.labels if other not in labels], hopeless=hopeless)

    def exact(self, known: Fit) -> Fit:
        """Return the fit of the same effects, gone on with by a Jacobian made where it ended."""
        return self.of(known, known.vector.labels, exact=True)

    def alone(self, known: Fit, plain: Fit) -> Fit:
        """Return the declared parameters' fit, from where they are by themselves or beside the effects of a fit,
        whichever is nearer: what one of their false minima leaves is nothing that an effect explains."""
        vector, starts = with_shapes(known, [])
        begin = FitStart(np.array([plain.minimum, *starts]), inputs=known.inputs)
        return self.task.fit("plain to its end", vector, begin)

    def decoys(self, known: Fit, everything: Fit) -> Decoys:
        """Return effects by chance beside a fit."""
        data = self.task.data
        return decoys_beside(known, everything, data.samples, data.folds, self.task.floor)

    def matters_elsewhere(self, fit: Fit, dropped: Sequence[str], label: str) -> bool:
        """Return whether a fit with terms `dropped` off differs on other layouts where one more is, to first order: by
        the tolerance, whatever is left of trials left out."""
        places = [Place(fit.vector, fit.without(labels)) for labels in (dropped, [*dropped, label])]
        return self.task.matters_elsewhere(*places)

    def needed_elsewhere(self, known: Fit, simpler: Fit, x: Array | None = None) -> bool:
        """Return whether the data lose by a simpler fit, and other layouts move otherwise than where `known` has its
        unknowns x (p,), by default where it ended."""
        place = Place(known.vector, known.x if x is None else x)
        return _lost(known, simpler) >= NEEDED and self.task.matters_elsewhere(place, Place(simpler.vector, simpler.x))


def with_shapes(joint: Fit, labels: Sequence[str]) -> tuple[FitVector, Array]:
    """Return the factors and these terms with all of their parameters that are no choice of a whole number, and (2, p)
    where a joint fit says they are with the others off: to first order, and as they are with the others there, which
    is nearer where these are far from small."""
    places = [to_first_order(joint, labels), joint.minimum]
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


def to_first_order(joint: Fit, labels: Sequence[str]) -> Array:
    """Return (p,) where a joint fit has its unknowns, to first order, with all terms but `labels` off."""
    return joint.without(label for label in joint.vector.labels if label not in labels)


def _chosen_only(term: Term) -> Term:
    """Return a term with the values alone that a fit of all parameters does not move."""
    return replace(term, values={k: v for k, v in term.values.items() if EFFECTS[term.name].parameters[k].whole})


def _lost(known: Fit, other: Fit) -> float:
    """Return what a fit with fewer effects loses, of log likelihood and prior. Shapes not in `known` cost nothing."""
    x = np.zeros(len(known.x))
    places = {name: k for k, name in enumerate(known.vector.names)}
    labels = {
        label: label_in(known.vector, t) for label, t in zip(other.vector.labels, other.vector.terms, strict=True)
    }
    for name, value in zip(other.vector.names, other.x, strict=True):
        label, dot, key = name.rpartition(".")
        if (place := places.get(f"{labels.get(label, label)}{dot}{key}")) is not None:
            x[place] = value
    there = Evaluation(x, other.state.misfit, other.state.sheets)
    return loss(known.state, there, known.normal, known.vector, known.inputs)


def label_in(vector: FitVector, term: Term) -> str:
    """Return the label of a term in a vector: that of the same effect, of several in the same channel."""
    same = [(label, other) for label, other in zip(vector.labels, vector.terms, strict=True) if other.name == term.name]
    chosen = _chosen_only(term).values
    return same[0][0] if len(same) == 1 else next(label for label, t in same if _chosen_only(t).values == chosen)

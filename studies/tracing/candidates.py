"""This module ranks effects by their gain, and finds those that the data cannot tell from the chosen ones: by linear
algebra on the joint fit, but for pairs that are the same from rest. And where no effect of the list explains what is
missing, a term with a formula of its own: the basis functions that `learned` has inside the simulator are fitted
together, those that the data do not need are dropped, and what is left is kept only if whole trials left out gain half
of their excess by it."""

from dataclasses import replace

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import effects_of, label_effect
from fabdesign.nouns.array import Array, Indices
from optimize.fit.cross_validation import LeftOut, Scored
from optimize.fit.descent import FitStart
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.policy import END, ROUGH
from optimize.fit.problem import widened
from optimize.fit.significance import NEEDED, alike, does, eliminated
from studies.model_selection.judged import Judged
from studies.model_selection.outcome import Candidate
from studies.model_selection.rules import Selection
from studies.model_selection.verdict import LEAST_SHARE
from studies.tracing.experiment import Explanation
from studies.tracing.task import ASKED, Task


def candidates_of(selection: Selection) -> tuple[tuple[Candidate, ...], dict[str, Explanation]]:
    """Return every effect of the joint fit, the largest gain first; and by name those that would do as well as one
    chosen, as the model that has it instead."""
    everything, chosen = selection.everything, selection.chosen
    taken = {label_effect(label) for label in chosen.vector.labels}
    others = [label for label in everything.vector.labels if label_effect(label) not in taken]
    parts = {label: everything.vector.part(label) for label in others}
    columns = np.concatenate([np.zeros(0, dtype=np.intp), *parts.values()]).astype(np.intp)
    wide = selection.judged.trials.with_columns(everything.state.jacobian[:, columns], everything.vector.prior[columns])
    count, first, places = len(chosen.x), len(chosen.x), {}
    for label, part in parts.items():
        places[label] = np.arange(first, first + len(part))
        first += len(part)
    added = np.arange(count, first)
    asked = [(added, chosen.vector.part(label), label) for label in chosen.vector.labels]
    asked += [(np.setdiff1d(added, places[label]), places[label], label) for label in others]
    candidates = [_candidate(wide, off, part, label, selection) for off, part, label in asked]
    best: dict[str, Candidate] = {}
    for candidate in sorted(candidates, key=lambda c: c.gain):
        best[candidate.name] = candidate
    ranked = sorted(best.values(), key=lambda c: (-c.chosen, -c.gain))
    return tuple(ranked), _alternatives(wide, selection, places)


def same_from_rest(task: Task, selection: Selection) -> dict[str, Explanation]:
    """Return by name effects that do the same as one chosen wherever motions begin at rest, as the model with it
    instead: fitted, since Jacobians of two places tell them apart, and left out where trials left out lose by it."""
    chosen, alternatives = selection.chosen, dict[str, Explanation]()
    taken = {*effects_of(chosen.vector.labels), *task.known}
    for label in selection.labels:
        other = EFFECTS[label_effect(label)].same_from_rest
        if other and EFFECTS[other].named and other not in taken:
            vector, kept = _in_place(chosen.vector, label, fit_vector([other], designs=task.designs), other)
            start = np.concatenate([chosen.x[kept], chosen.x[chosen.vector.part(label)]])
            jacobian = widened(chosen.state.jacobian[:, kept], np.arange(len(kept)), len(start))
            begin = FitStart(start, jacobian, chosen.inputs)
            fitted = task.fit(f"{other} for {label}", vector, begin, ASKED)
            if not selection.judged.predicts_better(task.judged(fitted), task.tolerance):
                names = " and ".join(effects_of(vector.labels))
                alternatives[other] = Explanation(names, vector, fitted.x, label_effect(label))
    return alternatives


def _in_place(vector: FitVector, label: str, source: FitVector, other: str) -> tuple[FitVector, Indices]:
    """Return a vector with the term `other` of a vector `source`, last, in place of its own `label`, and which of its
    unknowns are kept."""
    kept = np.setdiff1d(np.arange(len(vector.names)), vector.part(label))
    terms = [term for name, term in zip(vector.labels, vector.terms, strict=True) if name != label]
    exchanged = FitVector(
        (*(vector.parameters[k] for k in kept), *(source.parameters[k] for k in source.part(other))),
        vector.factors,
        (*terms, source.terms[source.labels.index(other)]),
    )
    return exchanged, kept


def _candidate(wide: LeftOut, off: Indices, part: Indices, label: str, selection: Selection) -> Candidate:
    """Return the effect whose unknowns are `part`, beside a model with the unknowns `off` at nothing."""
    with_it, without = wide.scored(off), wide.scored(np.concatenate([off, part]))
    gain, interval = wide.gain(without, with_it, selection.floor)
    return Candidate(
        label_effect(label), gain, interval, *_remaining(with_it, selection), label in selection.labels,
        _detectable(wide, off, part, label),
    )  # fmt: skip


def _remaining(scored: Scored, selection: Selection) -> tuple[float, float]:
    """Return the excess of trials left out in the mean and in the median, m."""
    return scored.excess(selection.floor), scored.typical(selection.floor)


def _detectable(wide: LeftOut, off: Indices, part: Indices, label: str) -> dict[str, float]:
    """Return the value of each strength that would have cost NEEDED to drop, with all parameters but `off` free."""
    free = np.setdiff1d(np.arange(len(wide.x)), off)
    covariance = np.linalg.inv(wide.information[np.ix_(free, free)])
    places = np.searchsorted(free, part)
    return _smallest(label_effect(label), np.sqrt(np.diag(covariance)[places]))


def _smallest(name: str, deviations: Array) -> dict[str, float]:
    """Return the value of each strength that would have cost NEEDED to drop. deviations: of x, in order."""
    effect, smallest = EFFECTS[name], {}
    for key, deviation in zip(effect.strengths, deviations.tolist(), strict=False):
        parameter, size = effect.parameters[key], float(np.sqrt(2 * NEEDED)) * deviation
        if parameter.transform == "log":
            smallest[key] = parameter.centre * float(np.exp(size))
        else:
            smallest[key] = parameter.centre + size
    return smallest


def _alternatives(wide: LeftOut, selection: Selection, places: dict[str, Indices]) -> dict[str, Explanation]:
    """Return effects that would do what a chosen one does (cosine over ALIKE, less what the other unknowns of the model
    can take), or did at the joint fit: where the chosen one takes the whole effect of both, the cloth has moved to
    another place by then. Each comes as the model with it in that one's place, to first order."""
    chosen, joint = selection.chosen, selection.everything
    total = wide.information
    alternatives: dict[str, Explanation] = {}
    for label in selection.labels:
        part = chosen.vector.part(label)
        others = np.setdiff1d(np.arange(len(chosen.x)), part)
        data = total - np.diag(1 / wide.prior**2)
        remaining = data - data[:, others] @ np.linalg.solve(total[np.ix_(others, others)], data[others])
        change = remaining[:, part] @ chosen.x[part]
        size = float(chosen.x[part] @ change[part])
        same = [k for k in joint.vector.labels if label_effect(k) == label_effect(label)]
        there = alike(joint.normal.sensitivity, joint.vector, same[0], [*places]) if len(same) == 1 else []
        for other, columns in places.items():
            if other in there or does(remaining, columns, change, size):
                model = _instead(wide, selection, label, other, columns)
                alternatives.setdefault(label_effect(other), model)
    return alternatives


def _instead(wide: LeftOut, selection: Selection, label: str, other: str, columns: Indices) -> Explanation:
    """Return the model with a term `other`, whose unknowns are `columns` of `wide`, in place of `label`."""
    chosen = selection.chosen.vector
    part = chosen.part(label)
    vector, kept = _in_place(chosen, label, selection.everything.vector, other)
    free = np.concatenate([kept, columns])
    slope = wide.gradient - wide.information[:, part] @ wide.x[part]
    x = wide.x[free] - np.linalg.solve(wide.information[np.ix_(free, free)], slope[free])
    names = effects_of([*(name for name in chosen.labels if name != label), other])
    return Explanation(" and ".join(names), vector, vector.inside(x), label_effect(label))


def discover(task: Task, selection: Selection) -> Judged | None:
    """Fit a formula from the data sheet, as the joint fit: few coefficients beside the declared parameters. None where
    nothing is needed or too little gained."""
    inputs = selection.everything.inputs
    vector = fit_vector(["discovered"], factors=task.factors, designs=task.designs)
    full = task.fit("discovered", vector, FitStart(inputs=inputs), ROUGH)
    coefficients = {vector.names[k]: np.array([k]) for k in np.flatnonzero(~vector.are_factors)}
    needed, x = eliminated(full.minimum, full.covariance, coefficients, NEEDED)
    if not needed:
        return None
    kept = [k for k, name in enumerate(vector.names) if name in needed or name not in coefficients]
    necessary = replace(vector, parameters=tuple(vector.parameters[k] for k in kept))
    named = f"discovered, {' '.join(name.rpartition('.')[2] for name in needed)}"
    judged = task.judged(task.fit(named, necessary, FitStart(vector.inside(x)[kept], inputs=inputs), END))
    return judged if judged.excess <= (1 - LEAST_SHARE) * selection.before.excess else None

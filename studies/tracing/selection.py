"""What the data need: one joint fit of every effect, then those dropped again that the data do not need.

A fit without an effect goes to a false minimum, where a lag becomes damping; around it the wrong names come first.
Where all may act, the fit finds its way, and what is not there comes out as nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fabdesign.checkpoint import Checkpoint
from fabdesign.effects import EFFECTS
from fabdesign.forward import ForwardModel, Term
from optimize.fit.clouds import Array, Indices, Sample, cut
from optimize.fit.descent import CLOSE, Fit, fit, horizons
from optimize.fit.inputs import Accuracy, InputErrors
from optimize.fit.left_out import LeftOut
from optimize.fit.parameters import FitParameter, FitVector, fit_vector
from optimize.fit.problem import FitProblem
from studies.tracing.kept_fit import kept_fit

NEEDED = 8.0  # of log likelihood: what costs less to drop is dropped; four standard deviations of one parameter
EARLY = 1.0  # s, of the horizons before the last: a column costs a motion as long
KNOWN = 0.35  # of the prior's standard deviation, over which the data say little of an unknown
_EARLY_CLOSE = 3.0  # of log likelihood: where a fit ends that others follow
ALIKE = 0.98  # cosine from which on two effects are one answer
Say = Callable[[str], None]
Gains = dict[str, tuple[float, tuple[float, float]]]


@dataclass(frozen=True, eq=False)
class Task:
    """What is fitted. start: of the factors. known: effects that the model has and that stay as they are."""

    samples: Sequence[Sample]
    forward: ForwardModel
    folds: Sequence[int]
    floor: float  # m, RMS of the noise in the residuals
    tolerance: float  # m of excess
    accuracy: Accuracy
    factors: dict[str, float]
    known: Sequence[str]
    scope: str | None  # of the muscles' effects
    checkpoint: Checkpoint
    say: Say

    @property
    def channels(self) -> int:
        return max(s.trial.design.channels for s in self.samples)


@dataclass(frozen=True, eq=False)
class Selection:
    """everything: the joint fit. plain: the declared parameters alone. chosen: with what is needed; `plain` itself
    where that is nothing. small: effects that are certain but within the tolerance. nothing: m RMS that terms left out
    of the joint fit on its way could move the residuals by at most, by label."""

    everything: Fit
    plain: Fit
    chosen: Fit
    folds: Sequence[int]
    floor: float
    small: tuple[str, ...]
    nothing: Mapping[str, float]

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the effects chosen, the one whose absence costs most first."""
        gains = self.gains
        return tuple(sorted(self.chosen.vector.labels, key=lambda label: -gains[label][0]))

    @cached_property
    def gains(self) -> Gains:
        """Of each effect chosen."""
        return gains_of(self.chosen.vector, LeftOut.of(self.chosen, self.folds), self.floor)


def gains_of(vector: FitVector, left: LeftOut, floor: float) -> Gains:
    """By each effect of a fit: m of excess, in quadrature, that trials left out gain by it, and 90 %."""
    own = left.scored()
    return {label: left.gain(left.scored(vector.part(label)), own, floor) for label in vector.labels}


def select(task: Task) -> Selection:
    """One joint fit from the data sheet, then backwards, to first order from its joint covariance; what stays is fitted
    with its shapes and must gain more than the tolerance of trials left out.

    The horizon grows, as in any fit; what a horizon says for certain to be next to nothing is left out of the later
    ones: a column costs a motion of every trial."""
    fabric = task.samples[0].trial.design.fabric
    size = fabric.width, fabric.height
    every = fit_vector(["all"], factors=task.factors, scope=task.scope, channels=task.channels, size=size)
    vector = without(every, task.known)
    nothing: dict[str, float] = {}
    start = vector.start
    for horizon in [h for h in horizons(task.samples)[:-1] if h <= EARLY]:
        shorter = replace(task, samples=[cut(sample, horizon) for sample in task.samples])
        early = _fit(shorter, f"every effect to {horizon:g} s", vector, start=start, close=_EARLY_CLOSE, near=True)
        gone = negligible(early, task.tolerance)
        nothing |= gone
        vector, index = vector.only([label for label in vector.labels if label not in gone])
        start = early.x[index]
    everything = _fit(task, "every effect", vector, start=start, near=True)
    plain = _fit(task, "plain", vector.without_effects, everything.inputs)
    labels = sparse(everything, needed(everything.minimum, everything.covariance, everything.vector))
    chosen, small, known = plain, [], everything
    while labels:
        vector, x = with_shapes(known, labels)
        known = _fit(task, " ".join(labels), vector, everything.inputs, x, near=True)
        weak = _weakest(task, known)
        if weak is None:
            chosen = _fit(task, "chosen", vector, everything.inputs, known.minimum)
            break
        small.append(weak)
        labels = [label for label in known.vector.labels if label != weak]
    if chosen is not plain and LeftOut.of(plain, task.folds).scored().excess(task.floor) <= task.tolerance:
        small += labels
        chosen = plain
    return Selection(everything, plain, chosen, task.folds, task.floor, tuple(small), nothing)


def label_effect(label: str) -> str:
    """The effect's name in the label of one of its terms."""
    return label.partition(":")[0]


def negligible(early: Fit, tolerance: float) -> dict[str, float]:
    """The terms that are well known and, two standard deviations off, move the residuals by less than half the
    `tolerance` [m] RMS, less what the other unknowns can take of that; and by how much [m] at most."""
    normal, vector = early.normal, early.vector
    share = normal.scale**2 / max(normal.tempering * float(normal.frames.sum()), 1e-12)
    ridged = normal.sensitivity + share * np.diag(1 / vector.prior**2)
    deviation = np.sqrt(np.diag(early.covariance))
    found = {}
    for label in vector.labels:
        part = vector.part(label)
        others = np.setdiff1d(np.arange(len(early.x)), part)
        across = normal.sensitivity[np.ix_(part, others)]
        left = normal.sensitivity[np.ix_(part, part)] - across @ np.linalg.solve(
            ridged[np.ix_(others, others)], across.T
        )
        size = np.abs(early.x[part]) + 2 * deviation[part]
        most = float(size @ np.sqrt(np.maximum(np.diag(left), 0.0)))
        if (deviation[part] <= KNOWN * vector.prior[part]).all() and most <= 0.5 * tolerance:
            found[label] = most
    return found


def without(vector: FitVector, known: Sequence[str]) -> FitVector:
    """Less the effects that the model has already."""
    labels = [label for label, term in zip(vector.labels, vector.terms, strict=True) if term.name not in known]
    return vector.only(labels)[0]


def needed(x: Array, covariance: Array, vector: FitVector) -> list[str]:
    """The terms that cost at least NEEDED each to drop, one after another, the cheapest first, with all other unknowns
    moving along as their joint normal distribution says."""
    left = {label: vector.part(label) for label in vector.labels}
    x, covariance = x.copy(), covariance.copy()
    while left:
        costs = {label: cost(x, covariance, part) for label, part in left.items()}
        cheapest = min(costs, key=lambda label: costs[label])
        if costs[cheapest] >= NEEDED:
            break
        x, covariance = conditioned(x, covariance, left.pop(cheapest))
    return [*left]


def cost(x: Array, covariance: Array, part: Indices) -> float:
    """Of log likelihood, what it costs to switch unknowns off."""
    own = covariance[np.ix_(part, part)]
    return float(0.5 * x[part] @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ x[part])


def conditioned(x: Array, covariance: Array, part: Indices) -> tuple[Array, Array]:
    """Mean and covariance where the unknowns `part` are zero."""
    gain = covariance[:, part] @ np.linalg.pinv(covariance[np.ix_(part, part)], rcond=1e-9, hermitian=True)
    x = x - gain @ x[part]
    covariance = covariance - gain @ covariance[part]
    x[part] = 0.0
    covariance[part], covariance[:, part] = 0.0, 0.0
    return x, covariance


def sparse(everything: Fit, labels: Sequence[str]) -> list[str]:
    """Of several places or channels of one effect, the one that costs most to drop: the sparse case."""
    x, covariance = everything.minimum, everything.covariance
    costs = {label: cost(x, covariance, everything.vector.part(label)) for label in labels}
    best: dict[str, str] = {}
    for label in sorted(labels, key=lambda label: costs[label]):
        best[label_effect(label)] = label
    return [label for label in labels if label in best.values()]


def with_shapes(joint: Fit, labels: Sequence[str]) -> tuple[FitVector, Array]:
    """The factors and these terms with all of their parameters that are no choice of a whole number, and where a
    joint fit says they are with the others off."""
    x, covariance = joint.minimum, joint.covariance
    gone = [joint.vector.part(label) for label in joint.vector.labels if label not in labels]
    if gone:
        x, _ = conditioned(x, covariance, np.concatenate(gone))
    vector, index = joint.vector.only(labels)
    known = dict(zip(vector.names, vector.inside(x[index]), strict=True))
    parameters = [p for p in vector.parameters if p.is_factor]
    for label, term in zip(vector.labels, vector.terms, strict=True):
        effect = EFFECTS[term.name]
        for key, p in effect.parameters.items():
            if not p.whole:
                name = f"{label}.{key}"
                unknown = FitParameter(name, p.deviation, p.centre, p.transform, p.unit, p.bounds)
                begin = known.get(name, unknown.unknown(term.values.get(key, p.typical)))
                parameters.append(replace(unknown, start=begin))
    terms = tuple(_chosen_only(term) for term in vector.terms)
    whole = FitVector(tuple(parameters), vector.factors, terms)
    return whole, np.array([known.get(p.name, p.start) for p in parameters])


def _chosen_only(term: Term) -> Term:
    """What a fit of all parameters does not move."""
    return replace(term, values={k: v for k, v in term.values.items() if EFFECTS[term.name].parameters[k].whole})


def _weakest(task: Task, chosen: Fit) -> str | None:
    """The effect that trials left out gain least by, if that is not certain, or not more than the tolerance; or, where
    another gains more, not more than what all of them leave: the first one's law is then not quite the right one, and
    small effects take up what it lacks."""
    trials = LeftOut.of(chosen, task.folds)
    gains = gains_of(chosen.vector, trials, task.floor)
    weakest = min(gains, key=lambda label: gains[label][0])
    gain, (low, _) = gains[weakest]
    left = trials.scored().excess(task.floor) if len(gains) > 1 else 0.0
    return weakest if gain < max(task.tolerance, left) or low <= 0 else None


def _fit(
    task: Task,
    named: str,
    vector: FitVector,
    inputs: InputErrors | None = None,
    start: Array | None = None,
    close: float = CLOSE,
    near: bool = False,
) -> Fit:
    """Kept in the trace's folder. inputs: what errors of them do, where that is known."""

    def compute() -> Fit:
        return fit(
            task.samples,
            task.forward,
            vector=vector,
            accuracy=inputs or task.accuracy,
            start=start,
            close=close,
            near=near,
            progress=lambda line, share: task.say(f"{named}, {len(vector.parameters)} unknowns: {line}"),
        )

    problem = FitProblem(task.samples, task.forward, task.forward, vector)
    return kept_fit(task.checkpoint, f"fit_{_file_name(named)}", problem, inputs, compute)


def _file_name(named: str) -> str:
    return "".join(c if c.isalnum() or c == "_" else "-" for c in named)

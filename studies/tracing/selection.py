"""What the data need: one joint fit of every effect, then those dropped again that the data do not need.

Around the false minimum that a fit without them goes to the wrong names come first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from optimize.fit.clouds import Array
from optimize.fit.cross_validation import Gain, LeftOut
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.problem import widened
from optimize.fit.significance import NEEDED, needed
from studies.calibration.intervals import expected_rms
from studies.calibration.joint_fit import beside, joint_fit
from studies.calibration.rest_fit import fit_at_rest
from studies.measured.fit_data import MeasuredData
from studies.tracing.backward_elimination import backwards, gains_of, is_cause, parts_of, sparse
from studies.tracing.decoys import Decoys
from studies.tracing.task import Task
from studies.tracing.verdict import so_far

SLIGHT = 2.0  # times the tolerance: what leaves no more is near the minimum, and the joint fit begins there
HOPELESS = 4.0  # times the tolerance: what leaves more is not refined before the joint fit


@dataclass(frozen=True, eq=False)
class Selection:
    """everything: the joint fit; to first order about `plain` where that is adequate. plain: the declared parameters
    alone. chosen: with what is needed; `plain` itself where that is nothing. small: effects that are certain but within
    the tolerance, or like all others too small for a cause. decoys: beside what is chosen; None without effects."""

    everything: Fit
    plain: Fit
    chosen: Fit
    folds: Sequence[int]
    floor: float
    small: tuple[str, ...]
    decoys: Decoys | None = None
    at_rest: Fit | None = None  # what shapes at rest say of the effects that act there

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the effects chosen that are causes, the one whose absence costs most first."""
        gains = self.gains
        causes = [label for label in gains if is_cause(self.chosen, label)]
        return tuple(sorted(causes, key=lambda label: -gains[label][0]))

    @property
    def slight(self) -> tuple[str, ...]:
        """Of the effects chosen, those too small for a cause: trials left out gain by them beside one."""
        causes = self.labels
        return tuple(label for label in self.gains if label not in causes)

    @cached_property
    def gains(self) -> dict[str, Gain]:
        """Of each effect chosen."""
        return gains_of(parts_of(self.chosen.vector), LeftOut.of(self.chosen, self.folds), self.floor)


def select(task: Task) -> Selection:
    """One joint fit from the data sheet, then backwards, to first order: dropped is what its joint covariance does not
    need, then what trials left out gain too little by. What stays is fitted with its shapes and asked once more, and of
    several each by a fit without it.

    Where the declared parameters leave little, the residuals are nearly linear about them, and the joint fit begins
    there: from the data sheet a cloth that snaps leads it astray. Not where they had to go where no specimen is: an
    effect hides in them then."""
    every = fit_vector(["all"], factors=task.factors, designs=task.designs)
    vector = without(every, task.known)
    hopeless = expected_rms(task.data.noise, HOPELESS * task.tolerance)
    at_rest = partial(
        fit_at_rest, task.data, task.forward, checkpoint=task.checkpoint, progress=lambda line, _: task.say(line)
    )
    factors = at_rest(vector.without_effects)
    start = None if factors is None else factors.x
    plain = task.fit("plain", vector.without_effects, start=start, near=True, hopeless=hopeless)
    excess = _excess(task, plain)
    plausible = plain.vector.is_plausible(plain.x)
    if excess <= task.tolerance and plausible:
        task.say(so_far(()))
        return _adequate(task, vector, task.fit("plain to its end", plain.vector, plain.inputs, plain.minimum))
    start = beside(vector, plain.x) if excess <= SLIGHT * task.tolerance and plausible else vector.start

    def fitted(
        data: MeasuredData,
        own: FitVector,
        start: Array,
        *,
        named: str,
        expected: float,
        jacobian: Array | None = None,
        **_: object,
    ) -> Fit:
        named = f"every effect {named}".strip()
        return replace(task, data=data).fit(named, own, start=start, near=True, expected=expected, jacobian=jacobian)

    rested = at_rest(vector)
    everything = joint_fit(task.data, vector, start, task.tolerance, fitted, patient=True, at_rest=rested)
    if rested is not None:  # what the shapes do not need may be what motions do
        everything = _with_all(task, vector, everything)
    task.say(so_far(needed(everything.minimum, everything.covariance, everything.vector, NEEDED)))
    plain = task.weighed(plain, everything.inputs)
    plain, chosen, small, decoys = backwards(task, everything, plain)
    return Selection(everything, plain, chosen, task.data.folds, task.floor, tuple(small), decoys, rested)


def _with_all(task: Task, vector: FitVector, joint: Fit) -> Fit:
    """Return a joint fit to first order with all unknowns of a vector, those that it has not at nothing."""
    _, at = vector.only([k for k, term in zip(vector.labels, vector.terms, strict=True) if term in joint.vector.terms])
    x = np.zeros(len(vector.parameters))
    x[at] = joint.x
    jacobian = widened(joint.state.jacobian, at, len(x))
    return task.linearised("every effect beside them", vector, x, joint.inputs, jacobian)


def _excess(task: Task, fitted: Fit) -> float:
    """Return m that a fit leaves of trials left out, in their mean or, where that is more, in their median."""
    scored = LeftOut.of(fitted, task.data.folds).scored()
    return max(scored.excess(task.floor), scored.typical(task.floor))


def _adequate(task: Task, vector: FitVector, plain: Fit) -> Selection:
    """What the declared parameters explain: effects take part to first order."""
    everything = task.linearised("every effect beside them", vector, beside(vector, plain.x), plain.inputs)
    small = sparse(everything, needed(everything.minimum, everything.covariance, vector, NEEDED))
    return Selection(everything, plain, plain, task.data.folds, task.floor, tuple(small))


def without(vector: FitVector, known: Sequence[str]) -> FitVector:
    """Less the effects that the model has already."""
    labels = [label for label, term in zip(vector.labels, vector.terms, strict=True) if term.name not in known]
    return vector.only(labels)[0]

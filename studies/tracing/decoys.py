"""Names by chance: effects driven by another trial's pressures, which no data can need, judged as effects are.

What a fit leaves has structure, and with many effects to choose from one may take some of it by chance. A decoy is an
effect's columns with the trials exchanged: as large and as smooth as the effect's own, and wrong (target-decoy
competition, Elias and Gygi 2007, doi:10.1038/nmeth1019).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.effects.registry import label_effect
from fabdesign.units import in_mm
from optimize.fit.clouds import Motion, Sample
from optimize.fit.cross_validation import Gain, LeftOut
from optimize.fit.fitted import Fit
from optimize.fit.misfit import Array, Indices
from optimize.fit.parameters import FitVector
from optimize.fit.policy import STEP
from optimize.fit.problem import Evaluation, FitProblem, columns
from optimize.fit.significance import NEEDED, cost
from studies.tracing.task import Task

TURNS = 2  # decoys of an effect: each trial has the columns of the next of its design, or of the one after that
CHANCE = 0.95  # quantile of the decoys' gains that an effect must gain more than


@dataclass(frozen=True)
class Decoys:
    """gains: what trials left out gain by each, beside a fit; needed: whether its data do, as `NEEDED` has it."""

    gains: tuple[Gain, ...]
    needed: tuple[bool, ...]

    @property
    def chance(self) -> float:
        """m of excess that one decoy in twenty gains; 0 without any."""
        return max(0.0, float(np.quantile([gain for gain, _ in self.gains], CHANCE))) if self.gains else 0.0

    def as_json(self, tolerance: float) -> dict[str, float]:
        """`decoys` of `trace.json`; tolerance: m."""
        return {"tried": len(self.gains), "taken": self.taken(tolerance), "chance_mm": in_mm(self.chance)}

    def taken(self, least: float) -> int:
        """How many would be called missing, where an effect must gain `least` [m]."""
        return sum(
            needed and gain >= least and low > 0
            for needed, (gain, (low, _)) in zip(self.needed, self.gains, strict=True)
        )


def decoys_beside(task: Task, known: Fit, joint: FitVector) -> Decoys:
    """Of the effects that `known` has, and of those of a joint fit that it does not have. Kept with the task's fits.
    None of them where a design has no two trials with different pressures."""

    def judged() -> list[tuple[Gain, bool]]:
        task.say("decoys: effects driven by other trials' pressures")
        return _judged(task, known, joint)

    kept = task.checkpoint.get(f"decoys_{' '.join(known.vector.labels)}", judged)
    return Decoys(tuple((gain, (low, high)) for (gain, (low, high)), _ in kept), tuple(needed for _, needed in kept))


def _judged(task: Task, known: Fit, joint: FitVector) -> list[tuple[Gain, bool]]:
    """Of each decoy: what trials left out gain by it, and whether the data need it."""
    orders = turned(task.data.samples, task.data.folds)
    if not orders:
        return []
    taken = {label_effect(label) for label in known.vector.labels}
    others, _ = joint.only([label for label in joint.labels if label_effect(label) not in taken])
    added = tuple(p for p in others.parameters if not p.is_factor)
    own = known.vector
    vector = FitVector((*own.parameters, *added), own.factors, (*own.terms, *others.terms))
    x = np.concatenate([known.x, np.zeros(len(added))])
    parts = {label: vector.part(label) for label in vector.labels}
    problem = task.problem(vector)
    tables = decoy_columns(problem, Evaluation(x, known.state.misfit, known.state.sheets), parts, orders)
    trials = LeftOut.of(known, task.data.folds)
    without, found = trials.scored(), []
    for table in tables:
        first = 0
        for part in parts.values():
            beside = trials.with_columns(table[:, first : first + len(part)], vector.prior[part])
            needed = _cost(beside, len(part)) >= NEEDED
            found.append((trials.gain(without, beside.scored(), task.floor), needed))
            first += len(part)
    return found


def _cost(beside: LeftOut, count: int) -> float:
    """Of log likelihood, at the minimum to first order, what the last `count` unknowns cost to switch off."""
    covariance = np.linalg.inv(beside.information)
    x = beside.x - covariance @ beside.gradient
    return cost(x, np.asarray(covariance, dtype=np.float64), np.arange(len(x) - count, len(x)))


def decoy_columns(
    problem: FitProblem, evaluation: Evaluation, parts: dict[str, Indices], orders: Sequence[Sequence[int]]
) -> list[Array]:
    """(N, k) m of each order: the unknowns of all `parts`, one after another, each trial with another's changes."""
    vector, samples, x = problem.vector, problem.samples, evaluation.x
    unknowns = np.concatenate([*parts.values()])
    steps = vector.steps(x, np.diag(STEP * vector.scale))[unknowns]
    others = [[vector.case(s.trial, x + step) for s in samples] for step in steps]
    found: list[list[Array]] = [[] for _ in orders]
    for changes in problem.displacements(evaluation, others):
        for order, own in zip(orders, found, strict=True):
            own.append(columns(evaluation, [_at(samples[s], samples[t], changes[t]) for s, t in enumerate(order)]))
    lengths = steps[np.arange(len(unknowns)), unknowns]
    return [np.nan_to_num(np.concatenate(own, axis=1)) / lengths for own in found]


def _at(sample: Sample, other: Sample, change: Motion) -> Motion:
    """(k, F, n, n, 3): another sample's changes at the frames of this one, the nearest in time."""
    return change[:, np.abs(other.times[None] - sample.times[:, None]).argmin(axis=1)]


def turned(samples: Sequence[Sample], folds: Sequence[int]) -> list[list[int]]:
    """Which sample's changes each sample takes: of its design and of other pressures, the next, and the one after.
    Empty where a design has no two."""
    orders = []
    for turn in range(1, TURNS + 1):
        order = []
        for s, sample in enumerate(samples):
            others = [
                t % len(samples)
                for t in range(s + 1, s + len(samples))
                if samples[t % len(samples)].trial.design_name == sample.trial.design_name
                and folds[t % len(samples)] != folds[s]
            ]
            if not others:
                return []
            order.append(others[(turn - 1) % len(others)])
        orders.append(order)
    return orders

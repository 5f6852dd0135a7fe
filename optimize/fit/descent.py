"""The one fit: bounded Gauss-Newton steps in a problem's unknowns, with priors; honest covariances."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from fabdesign.nouns.array import Array, Indices
from fabdesign.runtime.store import Checkpoint
from fabdesign.units import in_mm
from optimize.fit import policy as constants
from optimize.fit.fitted import Ending, Fit, concluded, kept
from optimize.fit.normal import LARGEST, Normal, directions, loss, step_to_minimum
from optimize.fit.parameters import FitVector
from optimize.fit.policy import END, FitStage, Policy
from optimize.fit.problem import Evaluation, InputErrors, Linearisation, Problem
from optimize.fit.significance import needed

Progress = Callable[[str, float], None]  # what is done, and about what share of it all


@dataclass(frozen=True, eq=False)
class FitStart:
    """Where a fit begins. x: (p,) or (k, p), of several where the residuals are least; None: at the vector's start.
    jacobian: (N, p) m, of a place near x, of which columns of NaN are made;
    the others are made again where its steps gain too little. inputs: what errors of them do on all rows, known from a
    fit of the same rows, so that models are compared by the same weights; None: the problem says."""

    x: Array | None = None
    jacobian: Array | None = None
    inputs: InputErrors | None = None


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a fit that has a place already. fit: makes the fit that ends there."""

    def __init__(self, fit: Callable[[], Fit]) -> None:
        super().__init__()
        self.fit = fit


def silent(line: str, share: float) -> None:
    """Tell nobody."""


def fit(
    problem: Problem,
    start: FitStart = FitStart(),
    policy: Policy = END,
    *,
    named: str = "",
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> Fit:
    """Return the most probable unknowns of a problem. Each iteration evaluates it, and a difference for each unknown.

    named: in the checkpoint, which keeps the fit. progress: is told what is done, and about what share. Ctrl-C raises
    Interrupted once there is a place to end at.

    Where a fit leaves k times what the problem expects of a right model, what is left is the model's error, not chance,
    and log likelihood counts by 1/k^2: a model that is wrong is not refined.

    All rows of a block share the model's error, so their likelihood is tempered: raised to the power that makes its
    curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011), and at least so far that a
    block counts as MODES observations: an error of the model that all trials share scatters no scores. The covariance
    is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where nothing is left
    because every motion diverges.
    """

    def compute() -> Fit:
        work = _Work(problem, start, policy)
        try:
            return work.fit(progress)
        except KeyboardInterrupt as stop:
            if work.reached is None:
                raise
            raise Interrupted(work.reached) from stop

    return compute() if checkpoint is None else kept(checkpoint, named, problem, start.inputs, compute)


@dataclass(frozen=True, eq=False)
class _Course:
    """Where a descent stands. exact: whether the state's Jacobian was made there; complete: all of its columns."""

    state: Linearisation
    exact: bool = True
    complete: bool = True
    damping: float = 0.0
    iterations: int = 0
    ended: Ending | None = None


@dataclass(frozen=True, eq=False)
class _Descent:
    """Steps on some rows. before: m RMS, at the data sheet. inputs: what errors of them do. hopeless, content: as a
    policy's."""

    problem: Problem
    inputs: InputErrors | None
    before: float
    hopeless: float = np.inf
    content: float = 0.0

    def concluded(self, state: Linearisation, iterations: int, ended: Ending) -> Fit:
        """Return the fit that ends at a state."""
        return concluded(self.problem, state, self.inputs, self.before, iterations, ended)

    def after(self, course: _Course, stage: FitStage) -> _Course:
        """Return where one iteration leads.

        Between two Jacobians by differences stands Broyden's update (1965), which costs no motions of its own, while
        steps gain most of what they promise. Columns of effects that the data do not need where the fit stands are as
        old as the first Jacobian, unless a step gains nothing.
        """
        state, vector, exact = course.state, self.problem.vector, course.exact
        course = replace(course, iterations=course.iterations + 1)
        step, normal = step_to_minimum(state, vector, self.inputs, damping=course.damping, far=stage.far)
        linear = _promised(state, step)
        promised = -loss(state, linear, normal, vector, self.inputs)
        longest = float(np.abs(step / vector.scale).max())
        if longest < LARGEST * (1 - 1e-9) and linear.misfit.rms > self.hopeless:
            return replace(course, ended="hopeless")
        there, gain = self._best(state, step, normal, promised)
        enough = stage.enough(len(vector.parameters), float(normal.frames.sum()))
        enough *= max(1.0, state.misfit.rms / self.problem.expected) ** 2
        small = promised < enough or longest < stage.slight or (exact and 0 < gain < enough)
        if gain > 0:
            course = replace(course, damping=course.damping / 10)
            if small and (exact or not stage.exact_end):
                ended = self.problem.with_jacobian(there, state.jacobian)
                return replace(course, state=ended, ended="converged")
            if not small and gain > constants.PROMISED * promised:
                updated = self.problem.with_jacobian(there, updated_jacobian(self.problem, state, there))
                return replace(course, state=updated, exact=False)
            if there.misfit.rms <= self.content:
                return replace(course, state=self.problem.with_jacobian(there, state.jacobian), ended="converged")
            return self._linearised(course, there, _needed_columns(vector, state.x, step, normal), normal)
        if state.misfit.rms <= self.content or (small and exact):
            return replace(course, ended="converged")
        if exact and course.complete:
            return replace(course, damping=max(10 * course.damping, constants.DAMPING))
        # what gains nothing with some columns made anew may with all
        every = np.arange(len(step)) if exact else _needed_columns(vector, state.x, step, normal)
        return self._linearised(course, state, every, normal)

    def _best(self, state: Linearisation, step: Array, normal: Normal, promised: float) -> tuple[Evaluation, float]:
        """Return where the best length of a step leads, and what it gains. The whole and half of it are tried at once,
        since few motions cost as much as twice as many; others where that is far from the promise."""
        vector = self.problem.vector

        def among(lengths: Sequence[float]) -> list[tuple[Evaluation, float]]:
            there = self.problem.evaluate([vector.inside(state.x + length * step) for length in lengths])
            return [(other, -loss(state, other, normal, vector, self.inputs)) for other in there]

        tried = among(constants.LENGTHS)
        if not constants.GOOD * promised < max(gain for _, gain in tried) < promised / constants.GOOD:
            tried += among(constants.OTHER_LENGTHS)
        return max(tried, key=lambda one: one[1])

    def _linearised(self, course: _Course, there: Evaluation, fresh: Indices, normal: Normal) -> _Course:
        """Return the course with the columns `fresh` made anew at a place."""
        along = directions(normal, self.problem.vector)
        state = self.problem.linearise(there, along, course.state.jacobian, fresh)
        return replace(course, state=state, exact=True, complete=len(fresh) == len(along))


class _Work:
    """A fit under way, and what makes the fit that ends where it stands."""

    def __init__(self, problem: Problem, start: FitStart, policy: Policy) -> None:
        self.problem, self.start, self.policy = problem, start, policy
        self.iterations = 0
        self.reached: Callable[[], Fit] | None = None

    def fit(self, progress: Progress) -> Fit:
        """Fit all rows, then with the finer engine if any."""
        problem, coarse = self.problem, self.problem.coarse
        rows, finer = parts(progress, 1.0 if coarse is problem else 0.5)
        descent, evaluation = self._begun(coarse)
        state = begun(coarse, evaluation, np.diag(constants.STEP * problem.vector.scale), self.start.jacobian)
        course = self._all_rows(descent, state, rows)
        if coarse is not problem:  # grids differ by less than a model does: one step is usual
            evaluation, sheet = problem.evaluate([course.state.x, np.zeros(len(course.state.x))])
            descent = _Descent(problem, descent.inputs, sheet.misfit.rms)
            state = problem.with_jacobian(evaluation, course.state.jacobian)
            course = self._descend(descent, _Course(state, exact=False), self.policy.finer, "finer grid, ", finer)
        return descent.concluded(course.state, self.iterations, course.ended or "iterations")

    def _begun(self, problem: Problem) -> tuple[_Descent, Evaluation]:
        """Return a descent, and the best of the starts, of which the data sheet may be the only one."""
        starts = np.atleast_2d(problem.vector.start if self.start.x is None else self.start.x)
        evaluations = problem.evaluate([*starts, *(np.zeros((1, starts.shape[1])) if starts.any() else [])])
        best = min(evaluations[:-1] or evaluations, key=lambda one: one.misfit.rms)
        inputs = problem.input_errors(best) if self.start.inputs is None else self.start.inputs
        return _Descent(problem, inputs, evaluations[-1].misfit.rms, self.policy.hopeless, self.policy.content), best

    def _all_rows(self, descent: _Descent, state: Linearisation, progress: Progress) -> _Course:
        """Return where the first steps and, where these leave little enough, the last ones lead."""
        begin, end, exact = self.policy.begin, self.policy.end, self.start.jacobian is None
        if end is None:
            stage = replace(begin, exact_end=begin.exact_end and exact)
            return self._descend(descent, _Course(state, exact), stage, "", progress)
        first, second = parts(progress, 0.5)
        state = self._descend(descent, _Course(state, exact), begin, "", first).state
        if state.misfit.rms > constants.WRONG * self.problem.expected:
            end = replace(begin, exact_end=end.exact_end)
        return self._descend(descent, _Course(state, exact=False), end, "", second)

    def _descend(self, descent: _Descent, course: _Course, stage: FitStage, line: str, progress: Progress) -> _Course:
        """Return where a stage ends."""
        course, before = replace(course, complete=course.exact), self.iterations
        while course.ended is None and course.iterations < constants.ITERATIONS:
            k, state = course.iterations + 1, course.state
            progress(f"{line}iteration {k}: {in_mm(state.misfit.rms):.3f} mm RMS", k / (k + 2))
            self.reached = partial(descent.concluded, state, before + k - 1, "interrupted")
            course = descent.after(course, stage)
        self.iterations = before + course.iterations
        return course


def begun(problem: Problem, evaluation: Evaluation, along: Array, jacobian: Array | None) -> Linearisation:
    """Return an evaluation with a Jacobian by differences; of `jacobian` (N, p) m the columns of NaN alone are made."""
    if jacobian is None:
        return problem.linearise(evaluation, along)
    missing = np.flatnonzero(np.isnan(jacobian).all(axis=0))
    if not len(missing):
        return problem.with_jacobian(evaluation, jacobian)
    return problem.linearise(evaluation, along, jacobian, missing)


def parts(progress: Progress, *ends: float) -> list[Progress]:
    """Return the progress of each part of work that goes in parts, one after another. ends: the shares of all work at
    which the parts but the last end."""

    def part(begin: float, end: float) -> Progress:
        return lambda line, share: progress(line, float(begin + share * (end - begin)))

    return [part(*pair) for pair in pairwise((0.0, *ends, 1.0))]


def _needed_columns(vector: FitVector, x: Array, step: Array, normal: Normal) -> Indices:
    """Return all columns but those of effects that the linearised data need neither at x nor where the step leads."""
    covariance = np.asarray(np.linalg.inv(normal.information + vector.precision), dtype=np.float64)
    kept = {label for place in (x, x + step) for label in needed(place, covariance, vector, constants.LITTLE)}
    dropped = vector.parts(label for label in vector.labels if label not in kept)
    return np.setdiff1d(np.arange(len(x)), dropped)


def _promised(state: Linearisation, step: Array) -> Evaluation:
    """Return what a step would lead to if the residuals were linear."""
    misfit = replace(state.misfit, residual=state.misfit.residual + state.jacobian @ step)
    return Evaluation(state.x + step, misfit, state.sheets)


def updated_jacobian(problem: Problem, state: Linearisation, other: Evaluation) -> Array:
    """Return the Jacobian at another place, updated by how the residuals changed on the way (Broyden)."""
    step = problem.moving(other.x - state.x)
    before, after, most = state.misfit.residual, other.misfit.residual, state.misfit.loss.cap
    missed = after - before - state.jacobian @ step
    usable = np.isfinite(missed) & (np.abs(after) < most) & (np.abs(before) < most)
    return np.asarray(state.jacobian + np.outer(np.where(usable, missed, 0.0), step / max(float(step @ step), 1e-30)))

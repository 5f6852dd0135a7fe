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


@dataclass(eq=False)
class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a fit that has a place already. fit: makes the fit that ends there."""

    fit: Callable[[], Fit]


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
        descent = _Descent(problem, start, policy)
        try:
            return descent.fit(progress)
        except KeyboardInterrupt as stop:
            if descent.reached is None:
                raise
            raise Interrupted(descent.reached) from stop

    return compute() if checkpoint is None else kept(checkpoint, named, problem, start.inputs, compute)


class _Descent:
    """A fit under way. state: where it stands, on the engine that it goes by. exact: how many columns of the Jacobian
    were made there. reached: makes the fit that ends where the last iteration began."""

    def __init__(self, problem: Problem, start: FitStart, policy: Policy) -> None:
        self.problem, self.start, self.policy = problem, start, policy
        self.inputs = start.inputs
        self.before = np.nan  # m RMS, at the data sheet
        self.iterations, self.exact, self.damping = 0, 0, 0.0
        self.ended: Ending | None = None
        self.reached: Callable[[], Fit] | None = None

    def fit(self, progress: Progress) -> Fit:
        """Fit all rows by the first steps and, where these leave little enough, the last ones."""
        problem, policy, by_jacobian = self.problem, self.policy, self.start.jacobian is None
        first, second = parts(progress, 1.0 if policy.end is None else 0.5)
        best = self._best_start()
        self.state = begun(problem, best, np.diag(constants.STEP * problem.vector.scale), self.start.jacobian)
        begin = replace(policy.begin, exact_end=policy.begin.exact_end and by_jacobian)
        self._descend(begin, first, len(self.state.x) if by_jacobian else 0)
        if policy.end is not None:
            wrong = self.state.misfit.rms > constants.WRONG * problem.expected
            end = replace(policy.begin, exact_end=policy.end.exact_end) if wrong else policy.end
            self._descend(end, second)
        return self._concluded(self.ended or "iterations")()

    def _best_start(self) -> Evaluation:
        """Return the best of the starts, of which the data sheet may be the only one, and ask what errors of the inputs
        do there."""
        starts = np.atleast_2d(self.problem.vector.start if self.start.x is None else self.start.x)
        evaluations = self.problem.evaluate([*starts, *(np.zeros((1, starts.shape[1])) if starts.any() else [])])
        best = min(evaluations[:-1] or evaluations, key=lambda one: one.misfit.rms)
        if self.inputs is None:
            self.inputs = self.problem.input_errors(best)
        self.before = evaluations[-1].misfit.rms
        return best

    def _descend(self, stage: FitStage, progress: Progress, exact: int = 0) -> None:
        """Go on to where a stage ends."""
        self.exact, self.damping = exact, 0.0
        for k in range(1, constants.ITERATIONS + 1):
            progress(f"iteration {k}: {in_mm(self.state.misfit.rms):.3f} mm RMS", k / (k + 2))
            self.reached = self._concluded("interrupted")
            self.ended = self._iterate(stage)
            self.iterations += 1
            if self.ended is not None:
                break

    def _concluded(self, ended: Ending) -> Callable[[], Fit]:
        """Return what makes the fit that ends where this one stands."""
        return partial(concluded, self.problem, self.state, self.inputs, self.before, self.iterations, ended)

    def _iterate(self, stage: FitStage) -> Ending | None:
        """Go where one iteration leads. Return why the stage ends there, None where it goes on.

        Between two Jacobians by differences stands Broyden's update (1965), which costs no motions of its own, while
        steps gain most of what they promise. Columns of effects that the data do not need where the fit stands are as
        old as the first Jacobian, unless a step gains nothing.
        """
        state, problem, exact = self.state, self.problem, self.exact > 0
        step, normal = step_to_minimum(state, problem.vector, self.inputs, damping=self.damping, far=stage.far)
        linear = state.after(step)
        promised = -self._loss(linear, normal)
        longest = float(np.abs(step / problem.vector.scale).max())
        if longest < LARGEST * (1 - 1e-9) and linear.misfit.rms > self.policy.hopeless:
            return "hopeless"
        enough = max(stage.least, stage.least_each * len(step), stage.least_share * float(normal.frames.sum()))
        enough *= max(1.0, state.misfit.rms / problem.expected) ** 2
        there, gain = self._best_length(step, normal, promised, enough)
        small = promised < enough or longest < stage.slight or (exact and 0 < gain < enough)
        stuck = not gain > 0  # NaN, too
        there = state if stuck else there
        self.damping /= 1 if stuck else 10
        if not (stuck or small) and gain > constants.PROMISED * promised:
            updated = updated_jacobian(problem, state, there)
            self.state, self.exact = problem.with_jacobian(there, updated), 0
        elif (small and (exact or not (stuck or stage.exact_end))) or there.misfit.rms <= self.policy.content:
            self.state = problem.with_jacobian(there, state.jacobian)
            return "converged"
        elif stuck and self.exact == len(step):
            self.damping = max(10 * self.damping, constants.DAMPING)
        else:  # what gains nothing with some columns made anew may with all
            needed_alone = not (stuck and exact)
            fresh = _needed_columns(problem.vector, state.x, step, normal) if needed_alone else np.arange(len(step))
            along = directions(normal, problem.vector)
            self.state, self.exact = problem.linearise(there, along, state.jacobian, fresh), len(fresh)
        return None

    def _best_length(self, step: Array, normal: Normal, promised: float, enough: float) -> tuple[Evaluation, float]:
        """Return where the best length of a step leads, and what it gains. The whole and half of it are tried at once,
        since few motions cost as much as twice as many; others where that is far from a promise of `enough`."""
        x, vector = self.state.x, self.problem.vector

        def among(lengths: Sequence[float]) -> list[tuple[Evaluation, float]]:
            there = self.problem.evaluate([vector.inside(x + length * step) for length in lengths])
            return [(other, -self._loss(other, normal)) for other in there]

        tried = among(constants.LENGTHS)
        kept = constants.GOOD * promised < max(gain for _, gain in tried) < promised / constants.GOOD
        if promised >= enough and not kept:
            tried += among(constants.OTHER_LENGTHS)
        return max(tried, key=lambda one: one[1])

    def _loss(self, other: Evaluation, normal: Normal) -> float:
        return loss(self.state, other, normal, self.problem.vector, self.inputs)


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


def updated_jacobian(problem: Problem, state: Linearisation, other: Evaluation) -> Array:
    """Return the Jacobian at another place, updated by how the residuals changed on the way (Broyden)."""
    step = problem.moving(other.x - state.x)
    before, after, most = state.misfit.residual, other.misfit.residual, state.misfit.loss.cap
    missed = after - before - state.jacobian @ step
    usable = np.isfinite(missed) & (np.abs(after) < most) & (np.abs(before) < most)
    return np.asarray(state.jacobian + np.outer(np.where(usable, missed, 0.0), step / max(float(step @ step), 1e-30)))

"""The one fit: bounded Gauss-Newton steps in its unknowns, with priors, over growing horizons; honest covariances."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.trial import Accuracy
from fabdesign.units import in_mm
from optimize.fit.clouds import FAR, Array, Indices, Sample, cut
from optimize.fit.fitted import Fit, capped, concluded
from optimize.fit.inputs import InputErrors, input_errors
from optimize.fit.normal import BLOCK, LARGEST, Normal, directions, loss, step_to_minimum
from optimize.fit.parameters import DECLARED, FitVector
from optimize.fit.problem import BenchProblem, Evaluation, FitProblem, Linearisation, Problem
from optimize.fit.significance import needed

STEP = 0.03  # of a logarithm, in the first finite differences
_ITERATIONS = 20
_CONVERGED = 0.01  # of a logarithm
_CLOSE = 0.007  # of log likelihood, an unknown: a step that promises less in all is the last, and still taken
_NEARLY = (3.0, 0.02)  # of log likelihood, in all and an observation, where another fit follows: 2 % of what is left
_PROMISED = 0.25  # of the gain that a step promised: while it gains as much, its Jacobian is updated, not made anew
_WRONG = 2.0  # times what a right model leaves: no last steps are worth their motions
_NEAR = 0.03  # of a logarithm: steps under it are left to the next horizon
_LITTLE = 2.0  # of log likelihood: an effect that costs less to drop keeps its former column
_DAMPING = 0.3  # Levenberg-Marquardt's, after a step that made it worse


Progress = Callable[[str, float], None]  # what is done, and about what share of it all
Reached = Callable[[Linearisation, int], None]  # told at each iteration where it stands, and how many there were


def fit(
    samples: Sequence[Sample],
    forward: ForwardModel,
    *,
    slopes: ForwardModel | None = None,
    vector: FitVector = DECLARED,
    accuracy: Accuracy | InputErrors | None = None,
    start: Array | None = None,
    close: float | None = None,
    near: bool = False,
    sure: bool = True,
    jacobian: Array | None = None,
    expected: float = np.inf,
    hopeless: float = np.inf,
    progress: Progress = lambda line, share: None,
    reached: Callable[[Callable[[], Fit]], None] = lambda fit_there: None,
) -> Fit:
    """Most probable unknowns given the samples. Each iteration simulates motions and a difference for each unknown.

    The horizon grows: the first half second alone, then the first second, and so on. Cloth that buckles late goes one
    way or another at factors a hair apart; what came before leads to factors near enough, and has fewer false minima.
    start: (p,) or (k, p) where it begins, on all frames at once, of several where the residuals are least; without it,
    at the vector's start with the first horizon.
    `slopes`, a cheaper engine, makes all motions and differences; `forward` looks at where that leads, and takes one
    step from there. Differences are always made where the factors are: those of another place seem to converge
    percents off.
    accuracy: of the inputs, whose errors then enter the residuals' covariance; or what they do on the last horizon,
    known from a fit of the same samples, so that models are compared by the same weights; None: the inputs are exact.
    close: of log likelihood, what the last step promises, or gains, at most; by default 0.007 for each unknown.
    near: another fit goes on from where this one ends, so that a step under 3 % ends it, and far frames count as
    others. jacobian: (N, p) m, of a place near `start`, of which columns of NaN are made; the others are made again
    where its steps gain too little, and, if `sure`, for the last step.
    expected: m RMS, what a right model leaves at most. Where a fit leaves k times as much, what is left is the model's
    error, not chance, and log likelihood counts by 1/k^2: a model that is wrong is not refined. Not for effects that
    begin at nothing, which leave much before they are found. hopeless: m RMS: where a horizon leaves more, or on
    all frames the minimum of the linearised residuals, the fit ends.
    `progress` is told what is done, and about what share; `reached`, at each iteration, what makes the fit that ends
    there, for whoever interrupts it.

    All points of a block of 0.5 s share the model's error, so their likelihood is tempered: raised to the power that
    makes its curvature agree with the scatter of the blocks' scores (Pauli, Racugno and Ventura 2011), and at least so
    far that a block counts as MODES observations: an error of the model that all trials share scatters no scores. The
    covariance is the sandwich of both (Liang and Zeger 1986), with the prior's share. Raises SimulationError where
    nothing is left because every motion diverges.
    """
    weight = np.diag(1 / vector.prior**2)
    slopes = forward if slopes is None else slopes
    starts = np.atleast_2d(vector.start if start is None else start)
    x, along, iterations = starts[0], np.diag(STEP * vector.scale), 0
    *early, last = horizons(samples)
    if start is not None:
        early = []
    costs = np.array([*early, last, 0 if slopes == forward else last])
    *ends, at_last = (np.cumsum(costs) / costs.sum()).tolist()[:-1]
    *shares, told, looking = parts(progress, *ends, at_last)
    for horizon, share in zip(early, shares, strict=True):
        problem = FitProblem([cut(sample, horizon) for sample in samples], slopes, slopes, vector)
        evaluation = problem.evaluate([x])[0]
        inputs = input_errors(problem, evaluation, accuracy) if isinstance(accuracy, Accuracy) else None
        state = problem.linearise(evaluation, along)
        there = _ending(reached, problem, inputs, capped(evaluation.found.residual), iterations)
        state, more, _ = _descend(
            problem, state, weight, f"to {horizon:g} s, ", share,
            near=True, sure=False, expected=expected, inputs=inputs, reached=there,
        )  # fmt: skip
        _, normal = step_to_minimum(problem.samples, state, weight, 0.0, vector, inputs, np.inf)
        x, along, iterations = state.x, directions(normal, vector), iterations + more
        starts = x[None]
        if capped(state.found.residual) > hopeless:
            hopeless = -np.inf
            break
    problem = FitProblem(samples, slopes, slopes, vector)
    *evaluations, sheet = problem.evaluate([*starts, np.zeros(len(x))])
    evaluation = min(evaluations, key=lambda one: capped(one.found.residual))
    inputs = input_errors(problem, evaluation, accuracy) if isinstance(accuracy, Accuracy) else accuracy
    state, before = begun(problem, evaluation, along, jacobian), capped(sheet.found.residual)
    if hopeless < 0:
        return concluded(problem, state, inputs, before, iterations, False)
    first, second = (told, told) if near else parts(told, 0.5)
    line, there = f"to {last:g} s, ", _ending(reached, problem, inputs, before, iterations)
    state, more, converged = _descend(
        problem, state, weight, line, first,
        near=True, sure=near and jacobian is None, exact=jacobian is None,
        expected=expected, hopeless=hopeless, inputs=inputs, reached=there,
    )  # fmt: skip
    if not near:
        iterations, wrong = iterations + more, capped(state.found.residual) > _WRONG * expected
        there = _ending(reached, problem, inputs, before, iterations)
        state, more, converged = _descend(
            problem, state, weight, line, second, near=wrong, sure=sure, exact=False,
            close=None if wrong else close, expected=expected, hopeless=hopeless, inputs=inputs, reached=there,
        )  # fmt: skip
    iterations += more
    if slopes != forward:  # grids differ by less than a model does: one step is usual
        problem = FitProblem(samples, forward, slopes, vector)
        evaluation, sheet = problem.evaluate([state.x, np.zeros(len(x))])
        before, there = capped(sheet.found.residual), _ending(reached, problem, inputs, before, iterations)
        state, more, converged = _descend(
            problem, problem.with_jacobian(evaluation, state.jacobian), weight, "finer grid, ", looking,
            near=near, sure=False, exact=False, close=close, expected=expected, inputs=inputs, reached=there,
        )  # fmt: skip
        iterations += more
    return concluded(problem, state, inputs, before, iterations, converged)


def begun(problem: Problem, evaluation: Evaluation, along: Array, jacobian: Array | None) -> Linearisation:
    """Return an evaluation with a Jacobian by differences; of `jacobian` (N, p) m the columns of NaN alone are made."""
    if jacobian is None:
        return problem.linearise(evaluation, along)
    missing = np.flatnonzero(np.isnan(jacobian).all(axis=0))
    if not len(missing):
        return problem.with_jacobian(evaluation, jacobian)
    return problem.linearise(evaluation, along, jacobian, missing)


def come_near(
    problem: Problem, inputs: InputErrors | None = None, progress: Progress = lambda line, share: None
) -> Fit:
    """The fit of a bench, or of shapes at rest, from the vector's start on all rows at once, until another goes on."""
    vector = problem.vector
    evaluation = problem.evaluate([vector.start])[0]
    before = capped(evaluation.found.residual, evaluation.found.loss.cap)
    state = problem.linearise(evaluation, np.diag(STEP * vector.scale))
    weight = np.diag(1 / vector.prior**2)
    state, iterations, converged = _descend(
        problem, state, weight, "", progress, near=True, sure=False, inputs=inputs
    )  # fmt: skip
    return concluded(problem, state, inputs, before, iterations, converged)


def fit_bench(problem: BenchProblem, progress: Progress = lambda line, share: None) -> Fit:
    """As `fit`, of a bench."""
    early, late = parts(progress, 0.5)
    near, weight = come_near(problem, progress=early), np.diag(1 / problem.vector.prior**2)
    state, more, converged = _descend(problem, near.state, weight, "", late, exact=False)
    return concluded(problem, state, None, near.before, near.iterations + more, converged)


def _ending(
    reached: Callable[[Callable[[], Fit]], None],
    problem: FitProblem,
    inputs: InputErrors | None,
    before: float,
    iterations: int,
) -> Reached:
    """What a descent tells that began after so many iterations."""
    return lambda state, more: reached(lambda: concluded(problem, state, inputs, before, iterations + more, False))


def parts(progress: Progress, *ends: float) -> list[Progress]:
    """Of work in parts one after another, what each tells its own share: `ends` are the shares of it all at which the
    parts but the last end."""

    def part(begin: float, end: float) -> Progress:
        return lambda line, share: progress(line, float(begin + share * (end - begin)))

    return [part(*pair) for pair in pairwise((0.0, *ends, 1.0))]


def horizons(samples: Sequence[Sample]) -> list[float]:
    """s after rest, one a descent: 0.5, 1.0, 2.0 and so on while that holds frames that the one before does not and is
    well short of the last, which holds all."""
    blocks = {max(1, int(np.ceil(time / BLOCK - 1e-6))) for sample in samples for time in sample.times}
    last, before, horizon = BLOCK * max(blocks), 0.0, BLOCK
    found: list[float] = []
    while 1.4 * horizon <= last:
        if any(before < BLOCK * k <= horizon for k in blocks):
            found.append(horizon)
        before, horizon = horizon, 2 * horizon
    return [*found, last]


def _descend(
    problem: Problem,
    state: Linearisation,
    weight: Array,
    named: str,
    progress: Progress,
    *,
    near: bool = False,
    sure: bool = True,
    exact: bool = True,
    close: float | None = None,
    expected: float = np.inf,
    hopeless: float = np.inf,
    inputs: InputErrors | None = None,
    reached: Reached = lambda state, iterations: None,
) -> tuple[Linearisation, int, bool]:
    """From `state` until a step is slight, or with `near` no longer large: where that led, how many iterations, and
    whether it converged. With `near` no frame counts less for being far off: what a model has not got yet may show in
    a few of them alone, and to pass over these is a false minimum. sure: a step ends it only where its Jacobian is by
    differences. exact: whether the state's is.

    Between two Jacobians by differences stands Broyden's update (1965), which costs no motions of its own, while
    steps gain most of what they promise. The last step is one by differences. Columns of effects that the data do not
    need where the fit stands are as old as the first Jacobian, unless a step gains nothing."""
    slight, far = (_NEAR, np.inf) if near else (_CONVERGED, FAR)
    vector, damping, whole = problem.vector, 0.0, exact
    for iteration in range(1, _ITERATIONS + 1):
        step, normal = step_to_minimum(problem.samples, state, weight, damping, problem.vector, inputs, far)
        linear = _promised(state, step)
        promised = -loss(problem.samples, state, linear, normal, weight, inputs)
        line = f"{named}iteration {iteration}: {in_mm(capped(state.found.residual)):.3f} mm RMS"
        progress(line, iteration / (iteration + 2))
        reached(state, iteration - 1)
        longest = float(np.abs(step / vector.scale).max())
        uncut = longest < LARGEST * (1 - 1e-9)
        if uncut and capped(linear.found.residual) > hopeless:
            return state, iteration, False
        evaluations = problem.evaluate([problem.vector.inside(state.x + length * step) for length in problem.lengths])
        gains = [-loss(problem.samples, state, other, normal, weight, inputs) for other in evaluations]
        best = int(np.argmax(gains))
        # where a part of a step is best, what is left of it is not slight
        longest *= max(1.0, problem.lengths[best])
        enough = close or _close(near, len(vector.parameters), float(normal.frames.sum()))
        enough *= max(1.0, capped(state.found.residual) / expected) ** 2
        small = promised < enough or longest < slight or (exact and 0 < gains[best] < enough)
        if gains[best] > 0:
            damping = damping / 10
            if small and (exact or not sure):
                return problem.with_jacobian(evaluations[best], state.jacobian), iteration, True
            there: Evaluation = evaluations[best]
            if not small and gains[best] > _PROMISED * promised:
                state, exact = problem.with_jacobian(there, _updated(problem, state, there)), False
                continue
        elif small and exact:
            return state, iteration, True
        elif exact and whole:
            damping = max(10 * damping, _DAMPING)
            continue
        else:
            there = state
        if exact and there is state:  # what gains nothing with some columns made anew may with all
            fresh = np.arange(len(step))
        else:
            fresh = _needed_columns(vector, (state.x, state.x + step), normal, weight)
        state = problem.linearise(there, directions(normal, vector), state.jacobian, fresh)
        exact, whole = True, len(fresh) == len(step)
    return state, _ITERATIONS, False


def _close(near: bool, unknowns: int, observations: float) -> float:
    """Of log likelihood: a step that promises less is the last."""
    return max(_NEARLY[0], _NEARLY[1] * observations) if near else _CLOSE * unknowns


def _needed_columns(vector: FitVector, places: Sequence[Array], normal: Normal, weight: Array) -> Indices:
    """All but those of effects that the data, as far as they are linear, need at none of the places (p,)."""
    covariance = np.asarray(np.linalg.inv(normal.information + weight), dtype=np.float64)
    kept = {label for x in places for label in needed(x, covariance, vector, _LITTLE)}
    gone = vector.parts(label for label in vector.labels if label not in kept)
    return np.setdiff1d(np.arange(len(weight)), gone)


def _promised(state: Linearisation, step: Array) -> Evaluation:
    """What a step would lead to if the residuals were linear."""
    found = replace(state.found, residual=state.found.residual + state.jacobian @ step)
    return Evaluation(state.x + step, state.sheets, found)


def _updated(problem: Problem, state: Linearisation, other: Evaluation) -> Array:
    """The Jacobian at another place, by what the residuals did on the way."""
    step = problem.moving(other.x - state.x)
    missed = other.found.residual - state.found.residual - state.jacobian @ step
    most = state.found.loss.cap
    usable = np.isfinite(missed) & (np.abs(other.found.residual) < most) & (np.abs(state.found.residual) < most)
    return np.asarray(state.jacobian + np.outer(np.where(usable, missed, 0.0), step / max(float(step @ step), 1e-30)))

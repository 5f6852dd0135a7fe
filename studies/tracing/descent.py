"""Gauss-Newton on those heights, between bounds."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from fabdesign.errors import SimulationError
from studies.calibration.clouds import cut
from studies.tracing.fit import Bench, State, little, loss, normal
from studies.tracing.vector import Array, Vector

REACH = 2.5  # prior standard deviations that a parameter moves at most in one iteration
LENGTHS = (1.0, 0.5, 0.2)  # of a step, tried at once
SLIGHT = 0.05  # prior standard deviations: a step under it is the last
EARLY = 0.5, 1.0  # s: the first iterations look no further, so that swings are followed into their right turn


def descend(
    bench: Bench,
    vector: Vector,
    x: Array,
    *,
    iterations: int,
    early: int = 0,
    slopes: Array | None = None,
    exact: bool = True,
    progress: Callable[[str], None] = lambda line: None,
) -> State:
    """From `x`, `early` iterations to each of the horizons EARLY, then up to `iterations` on all: the state with its
    Jacobian.

    slopes: (N, size) m, the Jacobian at `x` or near it. exact: by differences at the state itself, not what became of
    the last one on the way there. Raises SimulationError where the motions are lost from the start."""
    for horizon in EARLY if early else ():
        first = replace(bench, samples=[cut(sample, horizon) for sample in bench.samples])
        x = _descend(first, vector, x, early, None, False, f"to {horizon:g} s, ", progress).x
    found = _descend(bench, vector, x, iterations, slopes, exact, "", progress)
    return found if found.jacobian is not None else bench.with_slopes(found)


def _descend(
    bench: Bench,
    vector: Vector,
    x: Array,
    iterations: int,
    slopes: Array | None,
    exact_at_the_end: bool,
    named: str,
    progress: Callable[[str], None],
) -> State:
    """Between two Jacobians by differences stands Broyden's update (1965): a step costs its own motions alone. Without
    `exact_at_the_end` the state's is one of either, or none."""
    state = bench.states(vector, [x])[0]
    if not state.kept.any():
        raise SimulationError("every motion of the trials to trace diverged")
    state, exact, damping = replace(state, jacobian=slopes), False, 0.0
    least = little(bench)
    for iteration in range(1, iterations + 1):
        if state.jacobian is None:
            state, exact = bench.with_slopes(state), True
        progress(f"{named}iteration {iteration}: {1e3 * state.rms:.3f} mm RMS")
        gradient, hessian = normal(bench, state)
        step = bounded_step(vector, state.x, gradient, hessian + damping * np.diag(np.diag(hessian)))
        step *= min(1.0, REACH / max(float(np.abs(step).max()), 1e-12))
        tried = bench.states(vector, [state.x + length * step for length in LENGTHS])
        best = min(tried, key=lambda other: loss(bench, other))
        moved = float(np.abs(best.x - state.x).max())
        gained = loss(bench, state) - loss(bench, best)
        if gained > 0:
            last = moved < SLIGHT or gained < least
            done = last and exact
            slopes = None if last and (exact_at_the_end or not done) else _updated(state, best)
            state, exact, damping = replace(best, jacobian=slopes), False, damping / 10
            if done:
                break
        elif not exact:
            state = replace(state, jacobian=None)
        elif damping >= 1.0 or moved < SLIGHT:
            break
        else:
            damping = max(10 * damping, 0.1)
    return bench.with_slopes(state) if exact_at_the_end and not exact else state


def bounded_step(vector: Vector, x: Array, gradient: Array, hessian: Array) -> Array:
    """To the quadratic model's least value within the vector's bounds: a step that is cut at one of them afterwards
    leaves the other parameters where they are no good."""
    step = np.asarray(-np.linalg.solve(hessian, gradient), dtype=np.float64)
    low, high = vector.bounds
    if (x + step >= low).all() and (x + step <= high).all():
        return step
    root = np.linalg.cholesky(hessian)
    target = -solve_triangular(root, gradient, lower=True)
    return np.asarray(lsq_linear(root.T, target, bounds=(np.minimum(low - x, 0.0), np.maximum(high - x, 0.0))).x)


def _updated(state: State, other: State) -> Array:
    """The Jacobian at another state, by what the residuals did on the way."""
    step = other.x - state.x
    assert state.jacobian is not None
    missed = other.found.residual - state.found.residual - state.jacobian @ step
    usable = state.kept & other.kept & np.isfinite(missed)
    return np.asarray(state.jacobian + np.outer(np.where(usable, missed, 0.0), step / (step @ step)))

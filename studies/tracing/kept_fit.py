"""Fits that stand in a trace's folder: one that was killed goes on with the next."""

from collections.abc import Callable

import numpy as np

from fabdesign.checkpoint import Arrays, Checkpoint
from optimize.fit.descent import Fit, concluded
from optimize.fit.inputs import InputErrors
from optimize.fit.problem import FitProblem


def kept_fit(
    checkpoint: Checkpoint, name: str, problem: FitProblem, inputs: InputErrors | None, compute: Callable[[], Fit]
) -> Fit:
    """The fit of that name: where it ended and its Jacobian are kept, the motions there are made again. inputs: those
    that the fit was given; without them its own are kept."""
    fresh: list[Fit] = []

    def arrays() -> Arrays:
        found = compute()
        fresh.append(found)
        own = {} if inputs is not None or found.inputs is None else vars(found.inputs)
        told = np.array([found.before, found.iterations, found.converged], dtype=float)
        return {"x": found.x, "jacobian": found.state.jacobian, "told": told, **own}

    kept = checkpoint.arrays(name, arrays)
    if fresh:
        return fresh[0]
    if inputs is None and "columns" in kept:
        inputs = InputErrors(kept["columns"], kept["bent"])
    state = problem.with_jacobian(problem.evaluate([kept["x"]])[0], kept["jacobian"])
    before, iterations, converged = kept["told"].tolist()
    return concluded(problem, state, inputs, before, int(iterations), bool(converged))

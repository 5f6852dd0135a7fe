"""One step of a local search: NLopt minimises the objective on the shape's linear model within a trust region.

The only file that knows NLopt. The objective is not linearised, only the shape is (a prox-linear method: Drusvyatskiy
and Paquette, Efficiency of minimizing compositions of convex functions and smooth maps, Math. Program. 178, 2019), so
a step sees how the nearest neighbours change and costs no simulation.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import nlopt
import numpy as np

from fabdesign.nouns.array import Array
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.margins import LinearContraction
from optimize.search.objective import Objective, Poses

EVALUATIONS = 60  # of the linear model; the objective there is kinked, so that the last digits are not worth more
LEAST_GAIN = 1e-6  # m
MARGIN_STEP = 1e-5  # finite difference for the margins, of the cloth


@dataclass(frozen=True, eq=False)
class LinearShape:
    """shape(x) = shape + slopes (x - centre)."""

    centre: Vector  # (n,)
    shape: Poses  # (poses, 2 n, 3) m
    slopes: Array  # (n, poses, 2 n, 3) m

    def at(self, x: Vector) -> Poses:
        return self.shape + np.tensordot(x - self.centre, self.slopes, axes=1)

    def through(self, x: Vector, shape: Poses) -> "LinearShape":
        """Return the nearest model that holds at x too (Broyden, A class of methods for solving nonlinear simultaneous
        equations, Math. Comp. 19, 1965)."""
        way = x - self.centre
        missed = shape - self.at(x)
        return replace(self, slopes=self.slopes + np.multiply.outer(way / (way @ way), missed))


def best_step(model: LinearShape, objective: Objective, space: DesignSpace, radius: float) -> Vector:
    """Return the best feasible point of the linear model within `radius` reaches of its centre (the centre, if none
    is)."""
    reach = radius * space.reach
    lower, upper = np.maximum(0.0, model.centre - reach), np.minimum(1.0, model.centre + reach)
    thin = LinearShape(model.centre, model.shape[:, :: objective.thin], model.slopes[:, :, :: objective.thin])
    most, contraction = space.limits.contraction, None
    if most is not None:
        contraction = LinearContraction(space.decode(model.centre)[0], most, model.centre, model.shape, model.slopes)
    best_x, best_value = model.centre, np.inf
    if space.keeps(model.centre, model.shape):
        best_value = objective.gradient(thin.shape)[0]

    def value(x: Vector, gradient: Vector) -> float:
        nonlocal best_x, best_value
        reached, slope = objective.gradient(thin.at(x))
        if gradient.size:
            gradient[:] = np.tensordot(thin.slopes, slope, axes=3)
        if reached < best_value and space.feasible(x) and (contraction is None or contraction.at(x)[0].min() >= 0):
            best_x, best_value = x.copy(), reached
        return reached

    def violations(result: Vector, x: Vector, gradient: Array) -> None:
        margins = space.margins(x)
        result[: len(margins)] = -margins
        if gradient.size:
            gradient[:] = 0.0
            moved = x + MARGIN_STEP * np.eye(space.limited, len(x))
            gradient[: len(margins), : space.limited] = -(space.margins(moved) - margins).T / MARGIN_STEP
        if contraction is not None:
            slack, slopes = contraction.at(x)
            result[len(margins) :] = -slack
            if gradient.size:
                gradient[len(margins) :] = -slopes

    solver = nlopt.opt(nlopt.LD_SLSQP, len(model.centre))
    solver.set_lower_bounds(lower)
    solver.set_upper_bounds(upper)
    solver.set_min_objective(value)
    count = len(space.margins(model.centre)) + (contraction.count if contraction else 0)
    if count:
        solver.add_inequality_mconstraint(violations, np.full(count, 1e-7))
    solver.set_ftol_abs(LEAST_GAIN)
    solver.set_xtol_abs(1e-5)
    solver.set_maxeval(EVALUATIONS)
    with suppress(nlopt.RoundoffLimited, RuntimeError):  # the best point is kept here, whatever ends NLopt
        solver.optimize(np.clip(model.centre, lower, upper))
    return best_x

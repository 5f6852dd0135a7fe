"""One trust region that moves: what it wants evaluated, and what it makes of the answers.

In one step NLopt minimises the objective on the shape's linear model within the trust region. The only file that knows
NLopt. The objective is not linearised, only the shape is (a prox-linear method: Drusvyatskiy and Paquette, Efficiency
of minimizing compositions of convex functions and smooth maps, Math. Program. 178, 2019), so a step sees how the
nearest neighbours change and costs no simulation.
"""

from contextlib import suppress
from dataclasses import dataclass, field, replace

import nlopt
import numpy as np

from fabdesign.nouns.array import Array
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.margins import LinearContraction
from optimize.search.mirror import is_even_shape, mirror_of
from optimize.search.objective import Objective, Poses

STEP_LENGTHS = (1.0, 0.5, 1.6, 0.25, 1.3, 0.75, 2.2, 0.1)  # of the proposed step; at least FEWEST of them
FEWEST = 3
FIRST_RADIUS = 0.25
ENTRY_RADIUS = 0.1  # at least, on another forward model: what is best there lies elsewhere
LEAST_RADIUS = 0.01
LEAST_GAIN = 5e-6  # m, what the linear model must promise for another round
DISTINCT = 0.1  # reaches that two searches in one layout lie apart, at their widest, if both are followed

EVALUATIONS = 60  # of the linear model; the objective there is kinked, so that the last digits are not worth more
PROMISED = 1e-6  # m
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
    count = len(space.margins(model.centre)) + (len(contraction.at(model.centre)[0]) if contraction else 0)
    if count:
        solver.add_inequality_mconstraint(violations, np.full(count, 1e-7))
    solver.set_ftol_abs(PROMISED)
    solver.set_xtol_abs(1e-5)
    solver.set_maxeval(EVALUATIONS)
    with suppress(nlopt.RoundoffLimited, RuntimeError):  # the best point is kept here, whatever ends NLopt
        solver.optimize(np.clip(model.centre, lower, upper))
    return best_x


@dataclass
class LocalSearch:
    """`start` numbers where it began; value [m] is infinite where a limit is broken, so that to keep it is a gain.

    A round is: `trials`, evaluated and given to `accept`. A search without a `model` gets one of the slopes at x
    first, where the forward model offers derivatives; else it has its `shape` evaluated, and what it `lacks` given to
    `linearise`, and further rounds evaluate the `differences` around the first trial together with the trials.
    """

    start: int
    space: DesignSpace
    x: Vector
    value: float  # m
    radius: float = FIRST_RADIUS  # reaches
    rounds: int = 0
    done: bool = False
    shape: Poses | None = None  # at x; None after a checkpoint, which holds no shapes
    model: LinearShape | None = field(default=None, repr=False)
    slopes_at: Vector | None = None  # where the model's slopes are taken: at x (None), or at a trial nearby
    learned: list[Vector] = field(default_factory=list)  # trials since x was taken, that the model goes through too

    def enter(self, space: DesignSpace, x: Vector, value: float, shape: Poses) -> "LocalSearch":
        """Return the search that goes on from here in another space or on another forward model."""
        if space.keeps(x, shape):
            return LocalSearch(self.start, space, x, value, max(self.radius, ENTRY_RADIUS), shape=shape)
        return LocalSearch(self.start, space, x, np.inf, 1.0, shape=shape)  # it may go anywhere

    def differences(self, x: Vector) -> list[Vector]:
        """Return one-sided finite differences around x, towards the inside of the box."""
        return [x + step for step in np.diag(self._steps(x))]

    def _steps(self, x: Vector) -> Vector:
        return np.where(x + self.space.step <= 1.0, self.space.step, -self.space.step)

    def lacks(self, *, known: bool = True) -> list[Vector]:
        """Return what a model needs beside the shape at x: the differences around the place of its slopes, and that
        place first, unless it is x, whose shape is `known` to the model that slopes are taken on."""
        place = self.x if self.slopes_at is None else self.slopes_at
        return [*([] if known and self.slopes_at is None else [place]), *self.differences(place)]

    def linearise(self, shapes: list[Poses]) -> None:
        """Take the shapes at what it lacked."""
        place, around = self.x if self.slopes_at is None else self.slopes_at, self.shape
        if len(shapes) > len(place):
            around, *shapes = shapes
        assert self.shape is not None and around is not None
        self.model = LinearShape(self.x, self.shape, self._slopes(place, around, shapes))

    def _slopes(self, x: Vector, shape: Poses, ahead: list[Poses]) -> Array:
        """Return slopes by the shapes ahead of x. A diverged one says nothing: its variable stays for a round."""
        slopes = np.array([(other - shape) / h for other, h in zip(ahead, self._steps(x), strict=True)])
        slopes[~np.isfinite(slopes).all(axis=(1, 2, 3))] = 0.0
        return slopes

    def trials(self, objective: Objective, many: int = FEWEST, *, even_targets: bool = False) -> list[Vector]:
        """Return NLopt's best step at so many lengths, or FEWEST; none where it does not move. even_targets: an even
        layout with an even shape stays even."""
        assert self.model is not None
        mirror = mirror_of(self.space, self.x) if even_targets and is_even_shape(self.model.shape) else None
        if mirror is None or not mirror.keeps(self.x):
            step = best_step(self.model, objective, self.space, self.radius) - self.x
        else:
            even = replace(self.model, slopes=mirror.slopes(self.model.slopes))
            step = mirror.even(best_step(even, objective, self.space, self.radius)) - self.x
        if not np.any(step):
            return []  # also with borrowed slopes: they promise nothing either way
        xs = [np.clip(self.x + length * step, 0.0, 1.0) for length in STEP_LENGTHS[: max(many, FEWEST)]]
        return [xs[0], *(x for x in xs[1:] if self.space.feasible(x))]

    def accept(
        self, objective: Objective, xs: list[Vector], results: list[tuple[float, Poses]], ahead: list[Poses]
    ) -> None:
        """Move to the best trial if it gains, and widen or narrow the trust region by what the model promised; else the
        model learns the shortest trial.

        `ahead` are the shapes at the differences around the first trial (none in a last round): they serve as the
        slopes of whichever trial is taken, until a step fails with them.
        """
        self.rounds += 1
        if not xs:
            self.done = True
            return
        assert self.model is not None
        promised = self.value - objective.value(self.model.at(xs[0]))
        values = [value if self._kept(x, shape) else np.inf for x, (value, shape) in zip(xs, results, strict=True)]
        best = int(np.argmin(values))
        gain = self.value - values[best]
        if gain > 0:
            grown = 2.0 if gain > promised / 2 else 1.0
            self.radius = float(np.clip(grown * self._length(xs[best]), LEAST_RADIUS, 1.0))
            self.done = gain < LEAST_GAIN and self.slopes_at is None
            self.learned = []
            self.x, self.value, self.shape, self.model = xs[best], values[best], results[best][1], None
            if ahead:
                self.model = LinearShape(self.x, self.shape, self._slopes(xs[0], results[0][1], ahead))
                self.slopes_at = xs[0] if best > 0 else None
        elif self.slopes_at is not None:
            self.model = self.slopes_at = None
        else:
            shortest = min(range(len(xs)), key=lambda k: self._length(xs[k]))
            self.learned.append(xs[shortest])
            self.learn([results[shortest][1]])
            self.radius = min(self.radius, self._length(xs[0])) / 2
            self.done = promised < LEAST_GAIN or self.radius < LEAST_RADIUS

    def _kept(self, x: Vector, shape: Poses) -> bool:
        """Return whether the shape keeps a limit that it has too, which the model does not foresee for sure."""
        return self.space.limits.contraction is None or self.space.keeps(x, shape)

    def learn(self, shapes: list[Poses]) -> None:
        """Let the model go through the shapes at the last that were learned, unless they diverged."""
        for x, shape in zip(self.learned[-len(shapes) :], shapes, strict=True):
            if self.model is not None and np.any(x != self.x) and np.all(np.isfinite(shape)):
                self.model = self.model.through(x, shape)

    def _length(self, x: Vector) -> float:
        """Return reaches from here to x, at their widest."""
        return float(np.max(np.abs(x - self.x) / self.space.reach))

    def distinct(self, other: "LocalSearch") -> bool:
        """Return whether it is worth following both."""
        return self.space.design.muscles != other.space.design.muscles or self._length(other.x) > DISTINCT

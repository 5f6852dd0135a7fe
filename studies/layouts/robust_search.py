"""A more robust layout from one that was found: its places and pressures moved for the mean of copies, and single
muscles laid as two beside each other, whose errors are independent and average out.

Sample average approximation (Shapiro, Dentcheva, Ruszczynski, Lectures on Stochastic Programming, 2009, chapter 5): the
scatter is drawn once, each copy moves along with the layout, and the mean over the copies is an objective like any
other, with every copy a pose of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column, Jacobians, corner, pressure
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import Robust
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.local_search import LocalSearch
from optimize.search.objective import Objective, Poses, refined
from optimize.search.starts import Start
from optimize.search.step import LinearShape
from optimize.search.variations import doubled
from studies.layouts.robustness import mean_and_yield, normals
from studies.layouts.scatter import Scatter

COPIES = 8  # one block of lanes
ROUNDS = 5  # the first gains most
RADIUS = 0.1  # reaches, of the first step: the nominal search has been there


@dataclass(frozen=True, eq=False)
class Copies:
    """The copies of any layout of a space, and all of them as one shape: a pose each, after those of the one before."""

    study: Study
    robust: Robust
    objective: Objective  # of one copy
    forward: Predictor
    space: DesignSpace

    @property
    def together(self) -> Objective:
        """Return the mean over the copies."""
        objective = self.objective
        return replace(objective, targets=[*objective.targets] * COPIES, weights=[*objective.shares] * COPIES)

    def _scatter(self, x: Vector) -> tuple[Scatter, list[Array]]:
        scatter = Scatter(self.study, self.robust, *self.space.decode(x))
        return scatter, [*normals(scatter, self.study.seed + 2)[:COPIES]]

    def shapes(self, xs: Sequence[Vector]) -> list[Poses]:
        """Return (COPIES poses, 2 n, 3) m of every vector's copies, in one batch; a diverged one holds NaN."""
        drawn = [self._scatter(x) for x in xs]
        every = [copy for scatter, zs in drawn for copy in scatter.copies(zs)]
        shapes = drawn[0][0].shapes_of(self.objective, self.forward, every)
        return [np.concatenate(shapes[k * COPIES : (k + 1) * COPIES]) for k in range(len(xs))]

    def model(self, x: Vector, shape: Poses, jacobians: Jacobians) -> LinearShape:
        """Return how `shape`, that of the copies at x, changes with x. What has no derivative has none here."""
        scatter, zs = self._scatter(x)
        copies, poses, space = scatter.copies(zs), len(self.objective.targets), self.space
        columns, pull = self._columns(), np.array([scatter.pull(z) for z in zs])  # (copies, muscles)
        channels = [muscle.channel for muscle in space.design.muscles]
        slopes = np.zeros((space.dimension, COPIES, poses, *shape.shape[1:]))
        for pose in range(poses):
            cases = [scatter.case_of(self.objective, pose, copy) for copy in copies]
            derivatives = jacobians(cases, columns)
            for k, changes in enumerate(np.array([refined(c) for c in one.changes]) for one in derivatives):
                slopes[: space.position_count, k, pose] = changes[: space.position_count]
                by_muscle = changes[space.position_count :]
                for m, (channel, share) in enumerate(zip(channels, pull[k], strict=True)):
                    if space.vary_pressures:
                        at = space.position_count + pose * space.channels + channel
                        slopes[at, k, pose] += share * by_muscle[m]
        slopes *= space.units[:, None, None, None, None]
        slopes[~np.isfinite(slopes)] = 0.0
        return LinearShape(x, shape, slopes.reshape(len(x), *shape.shape))

    def _columns(self) -> list[Column]:
        """Return the columns of a copy's case: corners as the space has them, and the pressure of every muscle, which
        has a channel."""
        muscles = self.space.design.muscles
        corners = [
            (m, k) for m, muscle in enumerate(muscles) for k in range(len(muscle.path)) if self.space.vary_positions
        ]
        return [
            *(corner(m, k, way) for m, k in corners for way in ((1.0, 0.0), (0.0, 1.0))),
            *(pressure(m) for m in range(len(muscles)) if self.space.vary_pressures),
        ]


def descend(
    study: Study,
    robust: Robust,
    start: Start,
    objective: Objective,
    forward: Predictor,
    *,
    going: Callable[[], bool] = lambda: True,
) -> Start:
    """Return where the mean over the copies is least near `start`, on `forward`; `start` itself where the forward model
    has no derivatives or it does not gain. objective: of shapes at rest. going: asked before every round."""
    jacobians = replace(forward, model=Model()).faces_jacobian
    space, x = start
    if jacobians is None or not space.dimension:
        return start
    copies = Copies(study, robust, objective, forward, space)
    together, [shape] = copies.together, copies.shapes([x])
    search = LocalSearch(0, space, x, together.value(shape), RADIUS, shape=shape)
    if not np.isfinite(search.value):
        return start
    while not search.done and search.rounds < ROUNDS and going():
        if search.model is None:
            assert search.shape is not None
            search.model = copies.model(search.x, search.shape, jacobians)
        xs = search.trials(together)
        shapes = copies.shapes(xs) if xs else []
        results = [*zip(_or_infinite([together.value(one) for one in shapes]), shapes, strict=True)]
        search.accept(together, xs, results, [])
    return space, search.x


JUDGED = 64  # copies by which layouts are compared, others than those that the descent takes
SHARES = (0.5, 0.6, 0.7, 0.8)  # of a muscle's pressure, in each of two: their pull is no straight line in it
TRIED = 4  # doubled layouts, nearest first, of which copies are simulated
GAIN = 0.02  # of the expected value,
YIELD_GAIN = 0.05  # and of the copies, that a change must gain
ENOUGH = 0.97  # of the copies within the tolerance
PATIENCE = 2  # doubled muscles in a row without a gain


@dataclass(frozen=True, eq=False)
class MoreRobust:
    """start: the layout found. expected: m, and yielded: share within the tolerance, of copies on the coarse model.
    doubled: how many times a muscle was laid as two."""

    start: Start
    expected: float
    yielded: float
    doubled: int = 0

    @property
    def muscles(self) -> int:
        return len(self.start[0].design.muscles)

    def gains_on(self, other: "MoreRobust", robust: Robust, price: float) -> bool:
        """Return whether it is worth the change; price: m of the objective that each further muscle must gain."""
        gained = other.expected - self.expected
        if not gained >= max(0, self.muscles - other.muscles) * price:
            return False
        if robust.choose == "yield":
            return self.yielded >= other.yielded + YIELD_GAIN
        return gained >= GAIN * other.expected


def more_robust(
    study: Study,
    robust: Robust,
    start: Start,
    objective: Objective,
    forward: Predictor,
    *,
    tolerance: float,
    going: Callable[[], bool] = lambda: True,
) -> MoreRobust:
    """Return a more robust layout, by `forward`, the coarse model. Muscles are doubled where the study lets their
    number vary, up to its most, and while that gains. tolerance: m. going: asked before every round; what it cuts is no
    worse than `start`. Of targets that are frames of a motion too early to be near rest it is `start` itself."""
    objective = objective.at_rest
    if any(target.time is not None for target in objective.targets):
        return MoreRobust(start, np.inf, 0.0)

    def judged(one: Start, doubled: int) -> MoreRobust:
        scatter = Scatter(study, robust, *one[0].decode(one[1]))
        zs = normals(scatter, study.seed + 3)[:JUDGED]
        values = [objective.value(shape) for shape in scatter.shapes(objective, forward, [*zs])]
        return MoreRobust(one, *mean_and_yield(values, tolerance), doubled)

    def lowered(one: Start) -> Start:
        return descend(study, robust, one, objective, forward, going=going)

    space = replace(start[0], vary_positions=study.positions)
    start = space, space.encode(*start[0].decode(start[1]))
    best = judged(start, 0)
    moved = judged(lowered(start), 0)
    best = moved if moved.gains_on(best, robust, 0.0) else best
    most = study.muscles.most if study.muscles is not None and study.positions else 0
    current, failed = best, 0
    while current.muscles < most and failed < PATIENCE and going():
        if robust.choose == "yield" and best.yielded >= ENOUGH:
            break
        wider = _doubled(study, robust, current.start, objective, forward)
        if wider is None:
            break
        current = judged(lowered(wider), current.doubled + 1)
        if current.gains_on(best, robust, study.price.muscle):
            best, failed = current, 0
        else:
            failed += 1
    return best


def _doubled(study: Study, robust: Robust, start: Start, objective: Objective, forward: Predictor) -> Start | None:
    """Return that of the layouts with one muscle laid as two whose copies are nearest in the mean; None where none
    fits."""
    count = len(start[0].design.muscles)
    starts = [option for k in range(count) for share in SHARES if (option := doubled(start, k, share)) is not None]
    values = _or_infinite([objective.value(shape) for shape in objective.shapes(forward, starts)]) if starts else []
    nearest = [starts[i] for i in np.argsort(values)[:TRIED]]
    if not nearest:
        return None
    means = []
    for option in nearest:
        copies = Copies(study, robust, objective, forward, option[0])
        means.append(copies.together.value(copies.shapes([option[1]])[0]))
    return nearest[int(np.argmin(_or_infinite(means)))]


def _or_infinite(values: Sequence[float]) -> list[float]:
    return [value if np.isfinite(value) else np.inf for value in values]

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
from fabdesign.nouns.column import Jacobians, pressure
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.local_search import LinearShape, LocalSearch
from optimize.search.objective import Objective, Poses
from optimize.search.slopes import corner_column, corners_of, refined_jacobians
from optimize.search.starts import Start
from optimize.search.variations import doubled
from studies.layouts.robustness import mean_and_yield
from studies.layouts.scatter import Scatter, Scattering

COPIES = 8  # one block of lanes
ROUNDS = 5  # the first gains most
RADIUS = 0.1  # reaches, of the first step: the nominal search has been there


@dataclass(frozen=True, eq=False)
class Copies:
    """The copies of any layout of a space, and all of them as one shape: a pose each, after those of the one before."""

    how: Scattering
    space: DesignSpace

    @property
    def together(self) -> Objective:
        """Return the mean over the copies."""
        objective = self.how.objective
        return replace(objective, targets=[*objective.targets] * COPIES, weights=[*objective.shares] * COPIES)

    def _scatter(self, x: Vector) -> tuple[Scatter, list[Array]]:
        scatter = Scatter(self.how, *self.space.decode(x))
        return scatter, [*scatter.normals(2)[:COPIES]]

    def shapes(self, xs: Sequence[Vector]) -> list[Poses]:
        """Return (COPIES poses, 2 n, 3) m of every vector's copies, in one batch; a diverged one holds NaN."""
        shapes = self.how.shapes([scatter.copy(z) for scatter, zs in map(self._scatter, xs) for z in zs])
        return [np.concatenate(shapes[k * COPIES : (k + 1) * COPIES]) for k in range(len(xs))]

    def model(self, x: Vector, shape: Poses, jacobians: Jacobians) -> LinearShape:
        """Return how `shape`, that of the copies at x, changes with x. What has no derivative has none here."""
        scatter, zs = self._scatter(x)
        copies, poses, space = [scatter.copy(z) for z in zs], len(self.how.objective.targets), self.space
        channels, pull = [muscle.channel for muscle in space.design.muscles], [scatter.pull(z) for z in zs]
        levels = map(pressure, range(len(channels) * space.vary_pressures))  # a copy has a channel for each muscle
        columns = [*map(corner_column, corners_of(space)), *levels]
        slopes = np.zeros((space.dimension, COPIES, poses, *shape.shape[1:]))
        for pose in range(poses):
            cases = [self.how.case(pose, copy) for copy in copies]
            for k, changes in enumerate(one.changes for one in refined_jacobians(jacobians, cases, columns)):
                slopes[: space.position_count, k, pose] = changes[: space.position_count]
                by_muscle = changes[space.position_count :]
                for m, (channel, share) in enumerate(zip(channels, pull[k], strict=True)):
                    if space.vary_pressures:
                        at = space.position_count + pose * space.channels + channel
                        slopes[at, k, pose] += share * by_muscle[m]
        slopes *= space.units[:, None, None, None, None]
        slopes[~np.isfinite(slopes)] = 0.0
        return LinearShape(x, shape, slopes.reshape(len(x), *shape.shape))


def descend(how: Scattering, start: Start, *, going: Callable[[], bool] = lambda: True) -> Start:
    """Return where the mean over the copies, of shapes at rest, is least near `start`; `start` itself where the forward
    model has no derivatives or it does not gain. going: asked before every round."""
    jacobians, (space, x) = how.jacobians, start
    if jacobians is None or not space.dimension:
        return start
    copies = Copies(how, space)
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
        results = [*zip(together.values(shapes), shapes, strict=True)]
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

    def gains_on(self, other: "MoreRobust", how: Scattering) -> bool:
        """Return whether it is worth the change, and each further muscle its price."""
        gained = other.expected - self.expected
        if not gained >= max(0, self.muscles - other.muscles) * how.study.price.muscle:
            return False
        if how.robust.choose == "yield":
            return self.yielded >= other.yielded + YIELD_GAIN
        return gained >= GAIN * other.expected


def more_robust(
    how: Scattering, start: Start, *, tolerance: float, going: Callable[[], bool] = lambda: True
) -> MoreRobust:
    """Return a more robust layout. Muscles are doubled where the study lets their number vary, up to its most, and
    while that gains. tolerance: m. going: asked before every round; what it cuts is no worse than `start`. Of targets
    that are frames of a motion too early to be near rest it is `start` itself."""
    study, how = how.study, replace(how, objective=how.objective.at_rest)
    if any(target.time is not None for target in how.objective.targets):
        return MoreRobust(start, np.inf, 0.0)

    def judged(one: Start, doubled: int) -> MoreRobust:
        scatter = Scatter(how, *one[0].decode(one[1]))
        return MoreRobust(one, *mean_and_yield(scatter.values(scatter.normals(3)[:JUDGED]), tolerance), doubled)

    space = replace(start[0], vary_positions=study.positions)
    start = space, space.encode(*start[0].decode(start[1]))
    best = judged(start, 0)
    moved = judged(descend(how, start, going=going), 0)
    best = moved if moved.gains_on(best, how) else best
    most = study.muscles.most if study.muscles is not None and study.positions else 0
    current, failed = best, 0
    while current.muscles < most and failed < PATIENCE and going():
        if how.robust.choose == "yield" and best.yielded >= ENOUGH:
            break
        wider = _doubled(how, current.start)
        if wider is None:
            break
        current = judged(descend(how, wider, going=going), current.doubled + 1)
        if current.gains_on(best, how):
            best, failed = current, 0
        else:
            failed += 1
    return best


def _doubled(how: Scattering, start: Start) -> Start | None:
    """Return that of the layouts with one muscle laid as two whose copies are nearest in the mean; None where none
    fits."""
    count = len(start[0].design.muscles)
    starts = [option for k in range(count) for share in SHARES if (option := doubled(start, k, share)) is not None]
    if not starts:
        return None
    shapes = how.objective.shapes(how.forward, [space.decode(x) for space, x in starts])
    nearest = np.argsort(how.objective.values(shapes))[:TRIED]
    means = []
    for space, x in (starts[i] for i in nearest):
        copies = Copies(how, space)
        means += copies.together.values(copies.shapes([x]))
    return starts[nearest[int(np.argmin(means))]]

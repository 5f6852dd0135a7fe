"""A descent from a layout to one whose copies come nearer: a local search of the mean value over copies that stay the
same.

Sample average approximation (Shapiro, Dentcheva, Ruszczynski, Lectures on Stochastic Programming, 2009, chapter 5): the
scatter is drawn once, each copy moves along with the layout, and the mean over the copies is an objective like any
other, with every copy a pose of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.column import Column, Jacobians, corner_or_still, pressure
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.search_terms import Robust
from fabdesign.study_files.study_file import Study
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.local_search import LocalSearch
from optimize.search.objective import Objective, Poses, refined
from optimize.search.starts import Start
from optimize.search.step import LinearShape
from studies.layouts.robustness import normals
from studies.layouts.scatter import Scatter

Array = NDArray[np.float64]

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
        """The mean over the copies."""
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
            *(corner_or_still(m, k, way) for m, k in corners for way in ((1.0, 0.0), (0.0, 1.0))),
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
        values = [together.value(one) for one in shapes]
        results = [(v if np.isfinite(v) else np.inf, one) for v, one in zip(values, shapes, strict=True)]
        search.accept(together, xs, results, [])
    return space, search.x

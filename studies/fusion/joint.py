"""All cameras' poses and clocks together, from the moving cloth: Gauss-Newton on point-to-plane distances.

A clock that is late shifts each point by its speed along the normal. Cameras of one face must agree; a camera of the
other face lies the cloth's thickness behind (Chen, Medioni 1992, "Object modelling by registration of multiple range
images"). The cloth at rest anchors every pose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fabdesign.depth.sensor import Sensor
from fabdesign.nouns.array import Array
from studies.fusion.cleaning import Cleaned
from studies.fusion.moving import Clock, StampedView, view_at
from studies.fusion.reference import Pose, moved

REST = -1  # the frame number of the reference
REACH = 0.006  # m, between corresponding points, and as much more as the faces lie apart
PAIR_NOISE = 1.0e-3  # m, of one point-to-plane distance: the depth noise of a point and of a plane
INDEPENDENT = 3.0  # distances that count as one
ROUNDS = 3
FACING = 0.7  # least cosine between corresponding normals
SAMPLE = 900  # points of a cloud that are compared
LEAST_OVERLAP = 60  # points
DISAGREE = 0.003  # m, median distance between sensors that is no noise
EACH = 8  # unknowns of a camera: turn, shift, offset of its clock, drift
HELD = 1e18  # information of what does not change
DRIFT = 1e-4  # standard deviation of a clock's drift


@dataclass(frozen=True, eq=False)
class SensorView:
    """The view of one frame by one camera."""

    frame: int
    camera: int
    cloud: Cleaned
    velocity: Array | None = None  # (n, 3) m/s of the points in the camera's frame; None: at rest, or without a clock
    stamp: float = 0.0  # s on the camera's clock, from its middle

    def placed(self, matrix: Array, step: int = 1) -> tuple[Array, Array]:
        """Return every `step`-th point (n, 3) m and its normal, in the world."""
        turn = matrix[:3, :3].T
        return self.cloud.points[::step] @ turn + matrix[:3, 3], self.cloud.normals[::step] @ turn


class Gaps(NamedTuple):
    """Signed distances (n,) m of points from planes, less what they should be."""

    distance: Array
    points: Array  # (n, 3) m
    planes: Array  # (n, 3), their normals
    speeds: Array  # (2, n) m/s, of points and planes along these


class Alignment(NamedTuple):
    """The poses (4, 4), changes of clocks (cameras, 2), and the standard deviation of offsets (cameras,) s, by the
    distances' noise."""

    poses: list[Array]
    clocks: Array
    spread: Array


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where cameras stand, which face each looks at, and how far [m] the faces lie apart."""

    poses: Sequence[Array]  # (4, 4) camera_to_world
    sides: Sequence[str]
    thickness: float

    def gaps(self, one: SensorView, other: SensorView) -> Gaps:
        """Return the gaps between one view's points and another view's planes."""
        step = max(1, len(one.cloud.points) // SAMPLE)
        points, normals = one.placed(self.poses[one.camera], step)
        same = self.sides[one.camera] == self.sides[other.camera]
        expected = 0.0 if same else -self.thickness  # the other face lies behind the planes
        to_world = self.poses[other.camera]
        seen = (points - to_world[:3, 3]) @ to_world[:3, :3]
        distance, nearest = other.cloud.tree.query(seen, distance_upper_bound=REACH + abs(expected))
        close = np.isfinite(distance)
        points, nearest, taken = points[close], nearest[close], np.arange(len(one.cloud.points))[::step][close]
        planes = other.cloud.points[nearest] @ to_world[:3, :3].T + to_world[:3, 3]
        normal = other.cloud.normals[nearest] @ to_world[:3, :3].T
        agree = np.einsum("ni,ni->n", normals[close], normal) * (1.0 if same else -1.0) > FACING
        between = points - planes
        along = np.einsum("ni,ni->n", between, normal)
        aside = np.linalg.norm(between - along[:, None] * normal, axis=1)
        keep = agree & (aside < REACH / 2)
        normal, speeds = normal[keep], np.zeros((2, int(keep.sum())))
        for k, (view, which) in enumerate(((one, taken[keep]), (other, nearest[keep]))):
            if view.velocity is not None:
                velocity = view.velocity[which] @ self.poses[view.camera][:3, :3].T
                speeds[k] = np.einsum("ni,ni->n", velocity, normal)
        return Gaps(along[keep] - expected, points[keep], normal, speeds)

    def gap(self, one: SensorView, other: SensorView) -> float:
        """Return the median distance [m] between two views; where they hardly overlap, one that is no noise."""
        distance = self.gaps(one, other).distance
        return float(np.median(np.abs(distance))) if len(distance) >= LEAST_OVERLAP else 2 * DISAGREE


@dataclass(frozen=True, eq=False)
class TimedViews:
    """Moving views of every camera, at instants of the axis that their clocks share."""

    views: Sequence[Sequence[StampedView]]  # of each camera
    clocks: Sequence[Clock]
    known: Sequence[float]  # s, how well each clock is known

    @cached_property
    def times(self) -> list[Array]:
        """Return the instants (images,) s of each camera's views."""
        each = zip(self.views, self.clocks, strict=True)
        return [clock.times(np.array([view.stamp for view in views])) for views, clock in each]

    @cached_property
    def speeds(self) -> list[Array]:
        """Return the mean speed (images,) m/s of the cloth in each camera's views; 0 where it is not known."""
        return [np.nan_to_num([view.mean_speed for view in views]) for views in self.views]

    def at(self, instants: Array, within: float = np.inf, steps: Sequence[float] = ()) -> list[SensorView]:
        """Return every camera's view at each instant [s] where it has an image so near [s]. steps: as of `view_at`."""
        taken = []
        for camera, (views, times) in enumerate(zip(self.views, self.times, strict=True)):
            for frame, instant in enumerate(instants):
                k = int(np.abs(times - instant).argmin())
                if abs(times[k] - instant) <= within:
                    cloud, velocity = view_at(views, times, float(instant), steps)
                    stamp = views[k].stamp - self.clocks[camera].middle
                    taken.append(SensorView(frame, camera, cloud, velocity, stamp))
        return taken

    def until(self, camera: int, instant: float) -> "TimedViews":
        """Return it with a camera's views up to an instant [s] alone."""
        views = [*self.views]
        views[camera] = views[camera][: int((self.times[camera] <= instant).sum())]
        return replace(self, views=views)

    def moved(self, small: Array) -> "TimedViews":
        """Return it with clocks after changes (cameras, 2) of offsets [s] and drifts."""
        clocks = [Clock(c.offset + o, c.drift + d, c.middle) for c, (o, d) in zip(self.clocks, small, strict=True)]
        return replace(self, clocks=clocks)


@dataclass(frozen=True, eq=False)
class Anchored:
    """Sensors that can be used, with what the cloth at rest says of their poses. A camera is an index into them."""

    sensors: tuple[Sensor, ...]
    anchors: tuple[Pose, ...]
    rest: tuple[SensorView, ...]  # of the reference
    start: Arrangement  # by the anchors


def align(views: Sequence[SensorView], anchors: Sequence[Pose], start: Arrangement) -> list[Array]:
    """Return the poses (4, 4) that agree best with one another over all views, and with their anchors."""
    return _aligned(lambda _: views, np.full((len(anchors), 2), HELD), anchors, start).poses


def align_timed(timed: TimedViews, instants: Array, anchored: Anchored) -> Alignment:
    """Return the poses and clocks that agree best over views at instants [s] and at rest."""
    certain = np.array([[max(s, 1e-12) ** -2, DRIFT**-2] for s in timed.known])
    certain[0] = HELD

    def views_of(change: Array) -> list[SensorView]:
        return [*anchored.rest, *timed.moved(change).at(instants)]

    return _aligned(views_of, certain, anchored.anchors, anchored.start)


def _aligned(
    views_of: Callable[[Array], Sequence[SensorView]], certain: Array, anchors: Sequence[Pose], start: Arrangement
) -> Alignment:
    """Return what agrees best. certain: (cameras, 2) information of what is known of clocks."""
    poses = [anchor.matrix for anchor in anchors]
    small = np.zeros((len(poses), EACH))  # from the anchors; its turns are small enough to add
    n = EACH * len(poses)
    views = views_of(small[:, 6:])
    for turn in range(ROUNDS + 2 * bool((certain < HELD).any())):
        normal, right = np.zeros((n, n)), np.zeros(n)
        for k, anchor in enumerate(anchors):
            information = np.zeros((EACH, EACH))
            information[:6, :6], information[6:, 6:] = anchor.information, np.diag(certain[k])
            block = slice(EACH * k, EACH * k + EACH)
            normal[block, block] += information
            right[block] -= information @ small[k]
        if turn:
            views = views_of(small[:, 6:])
        arranged = replace(start, poses=poses)
        for one, other in ((a, b) for a in views for b in views if a.frame == b.frame and a.camera != b.camera):
            distance, points, planes, speeds = arranged.gaps(one, other)
            if not len(distance):
                continue
            spread = max(PAIR_NOISE, 1.48 * float(np.median(np.abs(distance))))
            weight = 1.0 / (1.0 + (distance / (2.0 * spread)) ** 2) / (spread**2 * INDEPENDENT)
            rows = np.empty((len(distance), 2 * EACH))
            for k, (view, sign) in enumerate(((one, 1.0), (other, -1.0))):
                at = EACH * k
                rows[:, at : at + 3] = sign * np.cross(points - poses[view.camera][:3, 3], planes)
                rows[:, at + 3 : at + 6] = sign * planes
                rows[:, at + 6] = -sign * speeds[k]  # of a later clock the view is moved less far
                rows[:, at + 7] = -sign * speeds[k] * view.stamp
            both = np.concatenate([EACH * view.camera + np.arange(EACH) for view in (one, other)])
            weighted = (weight[:, None] * rows).T
            normal[np.ix_(both, both)] += weighted @ rows
            right[both] -= weighted @ distance
        small += np.linalg.solve(normal, right).reshape(-1, EACH)
        poses = [moved(anchor.matrix, s[:6]) for anchor, s in zip(anchors, small, strict=True)]
    deviation = np.sqrt(np.diag(np.linalg.inv(normal))).reshape(-1, EACH)[:, 6]
    return Alignment(poses, small[:, 6:], deviation)

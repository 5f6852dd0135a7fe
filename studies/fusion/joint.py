"""All cameras' poses and clocks together, from the moving cloth: Gauss-Newton on point-to-plane distances.

A clock that is late shifts each point by its speed along the normal. Cameras of one face must agree; a camera of the
other face lies the cloth's thickness behind (Chen, Medioni 1992, "Object modelling by registration of multiple range
images"). The cloth at rest anchors every pose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from studies.fusion.cleaning import Cleaned
from studies.fusion.clocks import Clock
from studies.fusion.moving import StampedView, view_at
from studies.fusion.reference import Pose, moved

REACH = 0.006  # m, between corresponding points, and as much more as the faces lie apart
PAIR_NOISE = 1.0e-3  # m, of one point-to-plane distance: the depth noise of a point and of a plane
INDEPENDENT = 3.0  # distances that count as one
ROUNDS = 3
KNOCKED = (np.radians(0.2), 0.001)  # rad and m that a pose may change from frame to frame
FACING = 0.7  # least cosine between corresponding normals
SAMPLE = 900  # points of a cloud that are compared
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


@dataclass(frozen=True, eq=False)
class Gaps:
    """Signed distances (n,) m of one view's points from another view's planes, less what they should be."""

    distance: Array
    at: Array  # (n, 3) m, the points
    normal: Array  # (n, 3) of the planes
    speeds: Array  # (2, n) m/s along the normal, of the points and of the planes


def gaps(one: SensorView, other: SensorView, poses: Sequence[Array], sides: Sequence[str], thickness: float) -> Gaps:
    """Distances of `one` from the planes of `other`, placed by `poses` (4, 4)."""
    step = max(1, len(one.cloud.points) // SAMPLE)
    points, normals = one.placed(poses[one.camera], step)
    same = sides[one.camera] == sides[other.camera]
    expected = 0.0 if same else -thickness  # the other face lies behind the planes
    to_world = poses[other.camera]
    seen = (points - to_world[:3, 3]) @ to_world[:3, :3]
    distance, nearest = other.cloud.tree.query(seen, distance_upper_bound=REACH + abs(expected))
    near = np.isfinite(distance)
    points, nearest, taken = points[near], nearest[near], np.arange(len(one.cloud.points))[::step][near]
    planes = other.cloud.points[nearest] @ to_world[:3, :3].T + to_world[:3, 3]
    normal = other.cloud.normals[nearest] @ to_world[:3, :3].T
    agree = np.einsum("ni,ni->n", normals[near], normal) * (1.0 if same else -1.0) > FACING
    between = points - planes
    along = np.einsum("ni,ni->n", between, normal)
    aside = np.linalg.norm(between - along[:, None] * normal, axis=1)
    keep = agree & (aside < REACH / 2)
    speeds = np.stack(
        [_speed(one, taken[keep], poses, normal[keep]), _speed(other, nearest[keep], poses, normal[keep])]
    )
    return Gaps(along[keep] - expected, points[keep], normal[keep], speeds)


def _speed(view: SensorView, points: NDArray[np.intp], poses: Sequence[Array], normal: Array) -> Array:
    if view.velocity is None:
        return np.zeros(len(points))
    return np.asarray(np.einsum("ni,ni->n", view.velocity[points] @ poses[view.camera][:3, :3].T, normal))


@dataclass(frozen=True, eq=False)
class TimedViews:
    """Moving views of every camera, at instants of the axis that their clocks share."""

    views: Sequence[Sequence[StampedView]]  # of each camera
    clocks: Sequence[Clock]
    known: Sequence[float]  # s, how well each clock is known

    def at(self, instants: Array, within: float = np.inf, steps: Sequence[float] = ()) -> list[SensorView]:
        """Return every camera's view at each instant [s] where it has an image so near [s]. steps: as of `view_at`."""
        taken = []
        for camera, (views, clock) in enumerate(zip(self.views, self.clocks, strict=True)):
            times = clock.times(np.array([view.stamp for view in views]))
            for frame, instant in enumerate(instants):
                k = int(np.abs(times - instant).argmin())
                if abs(times[k] - instant) <= within:
                    cloud, velocity = view_at(views, times, float(instant), steps)
                    taken.append(SensorView(frame, camera, cloud, velocity, views[k].stamp - clock.middle))
        return taken

    def moved(self, small: Array) -> "TimedViews":
        """Return it with clocks after changes (cameras, 2) of offsets [s] and drifts."""
        clocks = [Clock(c.offset + o, c.drift + d, c.middle) for c, (o, d) in zip(self.clocks, small, strict=True)]
        return replace(self, clocks=clocks)


def align(views: Sequence[SensorView], anchors: Sequence[Pose], sides: Sequence[str], thickness: float) -> list[Array]:
    """Return the poses (4, 4) that agree best with one another over all views, and with their anchors."""
    return _aligned(lambda _: views, np.full((len(anchors), 2), HELD), anchors, sides, thickness)[0]


def align_timed(
    timed: TimedViews,
    instants: Array,
    rest: Sequence[SensorView],
    anchors: Sequence[Pose],
    sides: Sequence[str],
    thickness: float,
) -> tuple[list[Array], TimedViews, Array]:
    """Return the poses and clocks that agree best over views at instants [s] and at rest, and how well the offsets are
    known (cameras,) [s] by the distances' noise."""
    certain = np.array([[max(s, 1e-12) ** -2, DRIFT**-2] for s in timed.known])
    certain[0] = HELD
    poses, small, spread = _aligned(
        lambda change: [*rest, *timed.moved(change).at(instants)], certain, anchors, sides, thickness
    )
    return poses, timed.moved(small), spread


def _aligned(
    views_of: Callable[[Array], Sequence[SensorView]],
    certain: Array,
    anchors: Sequence[Pose],
    sides: Sequence[str],
    thickness: float,
) -> tuple[list[Array], Array, Array]:
    """Poses, changes of clocks (cameras, 2), and the standard deviation of offsets.

    certain: (cameras, 2) information of what is known of clocks.
    """
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
        for one, other in _pairs(views):
            g = gaps(one, other, poses, sides, thickness)
            if not len(g.distance):
                continue
            spread = max(PAIR_NOISE, 1.48 * float(np.median(np.abs(g.distance))))
            weight = 1.0 / (1.0 + (g.distance / (2.0 * spread)) ** 2) / (spread**2 * INDEPENDENT)
            rows = np.empty((len(g.distance), 2 * EACH))
            for k, (view, sign) in enumerate(((one, 1.0), (other, -1.0))):
                at = EACH * k
                rows[:, at : at + 3] = sign * np.cross(g.at - poses[view.camera][:3, 3], g.normal)
                rows[:, at + 3 : at + 6] = sign * g.normal
                rows[:, at + 6] = -sign * g.speeds[k]  # of a later clock the view is moved less far
                rows[:, at + 7] = -sign * g.speeds[k] * view.stamp
            both = np.concatenate([EACH * view.camera + np.arange(EACH) for view in (one, other)])
            weighted = (weight[:, None] * rows).T
            normal[np.ix_(both, both)] += weighted @ rows
            right[both] -= weighted @ g.distance
        small += np.linalg.solve(normal, right).reshape(-1, EACH)
        poses = [moved(anchor.matrix, s[:6]) for anchor, s in zip(anchors, small, strict=True)]
    deviation = np.sqrt(np.diag(np.linalg.inv(normal))).reshape(-1, EACH)[:, 6]
    return poses, small[:, 6:], deviation


def align_frame(
    views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float
) -> list[Array]:
    """Poses for one frame on its own, close to the shared ones: cameras that were knocked in between."""
    turn, shift = KNOCKED
    information = np.diag(np.repeat([turn**-2, shift**-2], 3))
    return align(views, [Pose(pose, information) for pose in poses], sides, thickness)


def _pairs(views: Sequence[SensorView]) -> list[tuple[SensorView, SensorView]]:
    return [(a, b) for a in views for b in views if a.frame == b.frame and a.camera != b.camera]

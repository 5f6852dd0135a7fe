"""All cameras' poses together, from the moving cloth: Gauss-Newton on point-to-plane distances between cameras.

Cameras of one face must agree; a camera of the other face lies the cloth's thickness behind (Chen, Medioni 1992,
"Object modelling by registration of multiple range images"). The cloth at rest anchors every pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.fusion.cleaning import Cleaned
from studies.fusion.reference import Pose, moved

Array = NDArray[np.float64]
REACH = 0.006  # m, between corresponding points, and as much more as the faces lie apart
PAIR_NOISE = 1.0e-3  # m, of one point-to-plane distance: the depth noise of a point and of a plane
INDEPENDENT = 3.0  # distances that count as one
ROUNDS = 3
KNOCKED = (np.radians(0.2), 0.001)  # rad and m that a pose may change from frame to frame
FACING = 0.7  # least cosine between corresponding normals
SAMPLE = 900  # points of a cloud that are compared


@dataclass(frozen=True, eq=False)
class SensorView:
    """What one camera saw of one frame."""

    frame: int
    camera: int
    cloud: Cleaned

    def placed(self, matrix: Array, step: int = 1) -> tuple[Array, Array]:
        """Every `step`-th point (n, 3) m and its normal, in the world."""
        turn = matrix[:3, :3].T
        return self.cloud.points[::step] @ turn + matrix[:3, 3], self.cloud.normals[::step] @ turn


@dataclass(frozen=True, eq=False)
class Gaps:
    """Signed distances (n,) m of one view's points from another view's planes, less what they should be."""

    distance: Array
    at: Array  # (n, 3) m, the points
    normal: Array  # (n, 3) of the planes


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
    points, nearest = points[near], nearest[near]
    planes = other.cloud.points[nearest] @ to_world[:3, :3].T + to_world[:3, 3]
    normal = other.cloud.normals[nearest] @ to_world[:3, :3].T
    agree = np.einsum("ni,ni->n", normals[near], normal) * (1.0 if same else -1.0) > FACING
    between = points - planes
    along = np.einsum("ni,ni->n", between, normal)
    aside = np.linalg.norm(between - along[:, None] * normal, axis=1)
    keep = agree & (aside < REACH / 2)
    return Gaps(along[keep] - expected, points[keep], normal[keep])


def align(views: Sequence[SensorView], anchors: Sequence[Pose], sides: Sequence[str], thickness: float) -> list[Array]:
    """The poses (4, 4) that agree best with one another over all views, and with their anchors."""
    poses = [anchor.matrix for anchor in anchors]
    small = np.zeros((len(poses), 6))  # from the anchors; its turns are small enough to add
    n = 6 * len(poses)
    for _ in range(ROUNDS):
        normal, right = np.zeros((n, n)), np.zeros(n)
        for k, anchor in enumerate(anchors):
            block = slice(6 * k, 6 * k + 6)
            normal[block, block] += anchor.information
            right[block] -= anchor.information @ small[k]
        for one, other in _pairs(views):
            g = gaps(one, other, poses, sides, thickness)
            if not len(g.distance):
                continue
            spread = max(PAIR_NOISE, 1.48 * float(np.median(np.abs(g.distance))))
            weight = 1.0 / (1.0 + (g.distance / (2.0 * spread)) ** 2) / (spread**2 * INDEPENDENT)
            rows = np.zeros((len(g.distance), n))
            for view, sign in ((one, 1.0), (other, -1.0)):
                arm = g.at - poses[view.camera][:3, 3]
                rows[:, 6 * view.camera : 6 * view.camera + 3] = sign * np.cross(arm, g.normal)
                rows[:, 6 * view.camera + 3 : 6 * view.camera + 6] = sign * g.normal
            normal += rows.T @ (weight[:, None] * rows)
            right -= rows.T @ (weight * g.distance)
        small += np.linalg.solve(normal, right).reshape(-1, 6)
        poses = [moved(anchor.matrix, s) for anchor, s in zip(anchors, small, strict=True)]
    return poses


def align_frame(
    views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float
) -> list[Array]:
    """Poses for one frame on its own, close to the shared ones: cameras that were knocked in between."""
    turn, shift = KNOCKED
    information = np.diag(np.repeat([turn**-2, shift**-2], 3))
    return align(views, [Pose(pose, information) for pose in poses], sides, thickness)


def _pairs(views: Sequence[SensorView]) -> list[tuple[SensorView, SensorView]]:
    return [(a, b) for a in views for b in views if a.frame == b.frame and a.camera != b.camera]

"""Where a camera stands, from the cloth at rest: a flat rectangle of known size and thickness in the plane z = 0.

Depths lie on the rectangle's face (three degrees of freedom); which pixels meet the cloth and which pass it tell the
other three. Nothing aligns one face with the other.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fabdesign.depth.sensor import Sensor
from fabdesign.errors import InputError
from fabdesign.geometry.hung_cloth import at_rest
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.units import in_mm
from studies.fusion.cleaning import Cleaned, clean

OUTLINE_NOISE = (1e-3, 3e-4, 1e-4)  # m, softness of the cloth's border, round by round
HOLES, STRAYS = 0.05, 0.003  # shares of pixels without depth on the cloth, and with depth off it
PLANE_NOISE = 8e-4  # m
INDEPENDENT = 3.0  # depths that count as one: their errors and the cloth's unevenness go together over a few pixels
COARSE_REACH = 0.03  # m, more than nominal poses are off
NORMAL_RADIUS, NORMAL_NEIGHBOURS = 0.012, 30  # m
OFF_NOMINAL = (0.04, 8.0)  # m and degrees from the nominal pose: beyond, the cloud is another sensor's


@dataclass(frozen=True, eq=False)
class Pose:
    """camera_to_world (4, 4) m and the information (6, 6) of a small turn [rad] and shift [m] of it in the world."""

    matrix: Array
    information: Array

    @staticmethod
    def within(matrix: Array, turn: float, shift: float) -> "Pose":
        """Return a pose that is known to a turn [rad] and a shift [m] about each axis."""
        return Pose(matrix, np.diag(np.repeat([turn**-2, shift**-2], 3)))


def moved(matrix: Array, small: Array) -> Array:
    """Return a pose after a turn small[:3] rad about the world's axes through its position, and a shift small[3:] m."""
    out = matrix.copy()
    out[:3, :3] = Rotation.from_rotvec(small[:3]).as_matrix() @ matrix[:3, :3]
    out[:3, 3] += small[3:]
    return out


def off(a: Array, b: Array) -> tuple[float, float]:
    """Return the distance [m] and angle [degrees] between two poses."""
    turn = Rotation.from_matrix(a[:3, :3] @ b[:3, :3].T).magnitude()
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.degrees(turn))


def point_cloud(points: Array) -> Any:
    """Return points (n, 3) as Open3D has them."""
    import open3d as o3d  # here: half a second, and it may be absent

    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))


def normals_of(face: Array) -> Array:
    """Return (n, 3) unit normals of a face's points, of either sign."""
    import open3d as o3d

    cloud = point_cloud(face)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS, NORMAL_NEIGHBOURS))
    return np.asarray(cloud.normals)


def register_to_rest(sensor: Sensor, cloud: Array, fabric: Fabric, cleaned: Cleaned | None = None) -> Pose:
    """Return the sensor's pose from its reference cloud (n, 3) m. Raises InputError where it does not fit the cloth."""
    z = fabric.thickness / 2 if sensor.side == "front" else -fabric.thickness / 2
    start = _coarse(sensor, (cleaned or clean(cloud)).points, fabric, z)
    met, passed = _border(cloud)

    def residuals(small: Array, matrix: Array, root: Array, noise: float) -> Array:
        pose = moved(matrix, small)
        plane = root @ [*pose[2, :3], pose[2, 3] - z] / (PLANE_NOISE * np.sqrt(INDEPENDENT))
        inside = _surprise(-_outside(met, pose, fabric) / noise, STRAYS)
        return np.concatenate([plane, inside, _surprise(_outside(passed, pose, fabric) / noise, HOLES)])

    matrix = start
    for noise in OUTLINE_NOISE:
        world = cloud @ matrix[:3, :3].T + matrix[:3, 3]
        inner = cloud[(_beyond(world, fabric) < -0.004) & (np.abs(world[:, 2] - z) < 0.006)]
        if len(inner) < 50:
            raise InputError(f"reference: sensor {sensor.name} does not see the cloth at rest where its pose says")
        heights = np.concatenate([inner, np.ones((len(inner), 1))], axis=1)  # over z they are linear in the pose:
        root = np.linalg.qr(heights, mode="r")  # four rows have their sum of squares
        solved = least_squares(residuals, np.zeros(6), method="lm", x_scale=1e-3, args=(matrix, root, noise))
        matrix = moved(matrix, solved.x)
    distance, angle = off(matrix, sensor.camera_to_world)
    if distance > OFF_NOMINAL[0] or angle > OFF_NOMINAL[1]:
        raise InputError(
            f"reference: sensor {sensor.name} lies {in_mm(distance):.0f} mm and {angle:.1f} degrees off its nominal "
            "pose"
        )
    return Pose(matrix, solved.jac.T @ solved.jac)


def _coarse(sensor: Sensor, cleaned: Array, fabric: Fabric, z: float) -> Array:
    """Return the pose by point-to-plane and then point-to-point ICP onto an even sample of the face."""
    import open3d as o3d

    face = at_rest(fabric, 81, 81) + [0.0, 0.0, z]
    target = point_cloud(face)
    target.normals = o3d.utility.Vector3dVector(np.tile([0.0, 0.0, 1.0], (len(face), 1)))
    source = point_cloud(cleaned)
    matrix = sensor.camera_to_world
    icp = o3d.pipelines.registration
    for estimate in (icp.TransformationEstimationPointToPlane(), icp.TransformationEstimationPointToPoint()):
        matrix = icp.registration_icp(source, target, COARSE_REACH, matrix, estimate).transformation
    return np.array(matrix)


def _border(cloud: Array) -> tuple[Array, Array]:
    """Return ray slopes (n, 2) of pixels that meet the cloth next to its outline, and of their neighbours that pass
    it."""
    slope = cloud[:, :2] / cloud[:, 2:]
    tree = cKDTree(slope)
    nearest, _ = tree.query(slope, k=2)
    pixel = float(np.median(nearest[:, 1]))
    steps = pixel * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    around = (slope[:, None] + steps).reshape(-1, 2)
    gap, _ = tree.query(around)
    empty = around[gap > 0.6 * pixel]
    _, cell, count = np.unique(np.round(empty / (0.5 * pixel)), axis=0, return_inverse=True, return_counts=True)
    passed = np.stack([np.bincount(cell.ravel(), empty[:, i]) / count for i in range(2)], axis=1)
    closeness = tree.query_ball_point(passed, 1.6 * pixel, return_length=True)
    passed = passed[closeness <= 5]  # a hole has eight neighbours, a pixel off a straight border at most three or four
    distance, _ = cKDTree(passed).query(slope)
    return slope[distance < 2.5 * pixel], passed


def _surprise(agreement: Array, wrong: float) -> Array:
    """Return square roots of twice the negative log-likelihood of pixels that agree with the outline, in noise units.

    A share `wrong` of pixels says nothing of the outline.
    """
    likelihood = wrong + (1.0 - wrong) / (1.0 + np.exp(np.clip(-agreement, -50.0, 50.0)))
    return np.asarray(np.sqrt(-2.0 * np.log(likelihood)))


def _outside(slope: Array, pose: Array, fabric: Fabric) -> Array:
    """Return how far [m] a ray passes the cloth; negative inside. The hem counts: the nearer face decides."""
    rays = np.concatenate([slope, np.ones((len(slope), 1))], axis=1) @ pose[:3, :3].T
    closest = np.full(len(slope), np.inf)
    for z in (-fabric.thickness / 2, fabric.thickness / 2):
        at = pose[:3, 3] + rays * ((z - pose[2, 3]) / rays[:, 2])[:, None]
        closest = np.minimum(closest, _beyond(at, fabric))
    return closest


def _beyond(points: Array, fabric: Fabric) -> Array:
    """Return the distance [m] beyond the nearest border of the rectangle; negative inside."""
    x, y = points[:, 0], points[:, 1]
    return np.asarray(np.max([np.abs(x) - fabric.width / 2, y, -y - fabric.height], axis=0))

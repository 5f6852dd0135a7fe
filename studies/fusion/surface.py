"""The fused cloth of one frame: a grid-thinned cloud for each face."""

from collections.abc import Mapping, Sequence

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array

NORMAL_RADIUS, NORMAL_NEIGHBOURS = 0.012, 30  # m
SPARE = 1.13  # grid points over points that are asked for (the paper: about 3,800 over 3,362)
SHRINK = 0.92  # of the box, where there are too few


def point_cloud(points: Array) -> o3d.geometry.PointCloud:
    """Return points (n, 3) as Open3D has them."""
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))


def thin(faces: Mapping[str, Sequence[Array]], points: int, area: float) -> dict[str, Array]:
    """One point a grid box (the mean of what lies in it), face by face, so that the faces never mix.

    faces: clouds (n, 3) m of every sensor; area of the cloth in m^2. At least `points` points in all; raises
    InputError where the sensors saw fewer.
    """
    clouds = {side: point_cloud(np.concatenate(seen)) for side, seen in faces.items()}
    seen = sum(len(cloud.points) for cloud in clouds.values())
    if seen < points:
        raise InputError(f"{points} points asked for; the sensors saw {seen} of the cloth")
    box = (2.0 * area / (SPARE * points)) ** 0.5
    while True:
        thinned = {side: cloud.voxel_down_sample(box) for side, cloud in clouds.items()}
        if sum(len(cloud.points) for cloud in thinned.values()) >= points:
            return {side: np.asarray(cloud.points) for side, cloud in thinned.items()}
        box *= SHRINK


def normals(face: Array) -> Array:
    """Return (n, 3) unit normals of a face's points, of either sign."""
    cloud = point_cloud(face)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS, NORMAL_NEIGHBOURS))
    return np.asarray(cloud.normals)


def distances(points: Array, face: Array, face_normals: Array) -> Array:
    """Return distances (n,) m from the plane of the nearest point of the face, with the normals' sign."""
    _, nearest = cKDTree(face).query(points)
    return np.asarray(np.einsum("ni,ni->n", points - face[nearest], face_normals[nearest]))


def thickness(front: Array, back: Array, back_normals: Array) -> float:
    """Median distance [m] of the front face from the back face, where both were seen."""
    apart, nearest = cKDTree(back).query(front)
    over = apart < 2.0 * float(np.median(apart))
    along = np.einsum("ni,ni->n", front[over] - back[nearest[over]], back_normals[nearest[over]])
    return float(np.median(np.abs(along)))

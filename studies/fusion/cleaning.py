"""Cleaning of one depth cloud: flying pixels, edge ribbons and strays go."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
NEIGHBOURS = 12  # in the image, for the local plane
PLANE_ROUNDS = 3
OFF_PLANE = 4.0  # noise standard deviations, beyond which a depth is no measurement of the surface
LEAST_OFF = 0.003  # m
GRAZING = np.cos(np.radians(82.0))  # a surface seen flatter than this is a ribbon between two surfaces
NORMAL_RADIUS, NORMAL_NEIGHBOURS = 0.012, 30  # m
RASTER, RASTER_REACH = 0.005, 1.5  # of ray slope: a cell of clouds that are no images, and as far as they go
STRAY_NEIGHBOURS, STRAY_RATIO = 16, 3.0


@dataclass(frozen=True, eq=False)
class Cleaned:
    """Points (n, 3) m and unit normals towards the camera, in the camera's frame."""

    points: Array
    normals: Array
    dropped: int
    image_cells: NDArray[np.intp] | None = None  # (n, 2) row and column in a raster of its image; None: of no image

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    @cached_property
    def cells(self) -> NDArray[np.intp]:
        """(n, 2) the cell of each point's ray in a raster that all views of its camera share."""
        if self.image_cells is not None:
            return self.image_cells
        slopes = self.points[:, 1::-1] / self.points[:, 2:]
        return np.asarray(np.clip(np.floor((slopes + RASTER_REACH) / RASTER), 0, 2 * RASTER_REACH / RASTER), np.intp)


def clean(cloud: Array) -> Cleaned:
    """Return a camera's cloud (n, 3) m, z forward, without what is not a face of the cloth."""
    points = cloud[_on_local_plane(cloud)]
    pcd = point_cloud(points)
    pcd, _ = pcd.remove_statistical_outlier(STRAY_NEIGHBOURS, STRAY_RATIO)
    pcd.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS, NORMAL_NEIGHBOURS))
    pcd.orient_normals_towards_camera_location(np.zeros(3))
    points, normals = np.asarray(pcd.points), np.asarray(pcd.normals)
    ray = points / np.linalg.norm(points, axis=1, keepdims=True)
    faces = -np.einsum("ni,ni->n", ray, normals) > GRAZING
    return Cleaned(points[faces], normals[faces], len(cloud) - int(faces.sum()))


def point_cloud(points: Array) -> o3d.geometry.PointCloud:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))


def _on_local_plane(cloud: Array) -> NDArray[np.bool_]:
    """Return whether a pixel's depth agrees with the plane through its neighbours in the image.

    A plane is linear in the inverse depth over the image, so that each fit is a robust (Cauchy-weighted) linear one.
    """
    slope, inverse = cloud[:, :2] / cloud[:, 2:], 1.0 / cloud[:, 2]
    k = min(NEIGHBOURS + 1, len(cloud))
    _, near = cKDTree(slope).query(slope, k=k)
    local = slope[near] - slope[:, None]
    design = np.concatenate([np.ones((*near.shape, 1)), local / max(float(np.abs(local).max()), 1e-9)], axis=2)
    values = inverse[near] - np.median(inverse[near], axis=1, keepdims=True)
    weight = np.ones(near.shape)
    for _ in range(PLANE_ROUNDS):
        weighted = np.swapaxes(design * weight[..., None], 1, 2)
        fit = np.linalg.solve(weighted @ design + 1e-9 * np.eye(3), weighted @ values[..., None])
        residual = values - (design @ fit)[..., 0]
        spread = 1.48 * np.median(np.abs(residual), axis=1, keepdims=True) + 1e-6
        weight = 1.0 / (1.0 + (residual / (2.0 * spread)) ** 2)
    off = np.abs(residual[:, 0]) * cloud[:, 2] ** 2  # m, along the ray; a point is its own nearest neighbour
    noise = 1.48 * np.median(off)
    return np.asarray(off < max(OFF_PLANE * noise, LEAST_OFF))

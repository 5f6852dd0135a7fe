"""Distances between two clouds.

Chamfer here is always: mean nearest distance from each cloud to the other, both ways, *summed*. Two samples of one
surface are not at distance zero (`metrics.chamfer_floor`), and the measure is nearly blind in the plane.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.cells import Cells

Floats = NDArray[np.floating[Any]]


def nearest_distances(points: Floats, others: Floats) -> NDArray[np.float64]:
    """Return (n,) m: distance of each of `points` (n, 3) to the nearest of `others` (m, 3)."""
    return np.sqrt(Cells.of_points(others).nearest(points).squared)


def chamfer(a: Floats, b: Floats) -> float:
    """Return the Chamfer distance [m] of clouds (n, 3) and (m, 3): unsquared, each way the mean, both ways summed."""
    return float(nearest_distances(a, b).mean() + nearest_distances(b, a).mean())


class ChamferTo:
    """Chamfer distances of several clouds to one, which is sorted once. weights: of each of its points, which their
    distances count by, and those of the points that they are nearest to."""

    def __init__(self, cloud: Floats, weights: NDArray[np.float64] | None = None) -> None:
        self._cloud, self._cells, self._weights = cloud, Cells.of_points(cloud), weights

    def of(self, points: Floats) -> float:
        """Return `chamfer(points, cloud)` [m]."""
        nearest = self._cells.nearest(points)
        to_cloud, to_points = np.sqrt(nearest.squared), nearest_distances(self._cloud, points)
        if self._weights is None:
            return float(to_cloud.mean() + to_points.mean())
        one, other = self._weights[nearest.item], self._weights
        return float(one @ to_cloud / one.sum() + other @ to_points / other.sum())


def chamfer_squared(a: Floats, b: Floats) -> float:
    """Return the Chamfer distance [m^2] of squared nearest distances, each way the mean, both ways summed."""
    return float(np.square(nearest_distances(a, b)).mean() + np.square(nearest_distances(b, a)).mean())

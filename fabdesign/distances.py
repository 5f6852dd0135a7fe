"""Distances between two clouds.

Chamfer here is always: mean nearest distance from each cloud to the other, both ways, *summed*. Two samples of one
surface are not at distance zero (`metrics.chamfer_floor`), and the measure is nearly blind in the plane.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.cells import Cells

Floats = NDArray[np.floating[Any]]


def nearest_distances(points: Floats, others: Floats) -> NDArray[np.float64]:
    """(n,) m: distance of each of `points` (n, 3) to the nearest of `others` (m, 3)."""
    return np.sqrt(Cells.of_points(others).nearest(points).squared)


def chamfer(a: Floats, b: Floats) -> float:
    """Chamfer distance [m] of clouds (n, 3) and (m, 3): unsquared, each way the mean, both ways summed."""
    return float(nearest_distances(a, b).mean() + nearest_distances(b, a).mean())


class ChamferTo:
    """Chamfer distances of several clouds to one, which is sorted once."""

    def __init__(self, cloud: Floats) -> None:
        self._cloud, self._cells = cloud, Cells.of_points(cloud)

    def of(self, points: Floats) -> float:
        """`chamfer(points, cloud)` [m]."""
        return float(
            np.sqrt(self._cells.nearest(points).squared).mean() + nearest_distances(self._cloud, points).mean()
        )


def chamfer_squared(a: Floats, b: Floats) -> float:
    """Chamfer distance [m^2] of squared nearest distances, each way the mean, both ways summed."""
    return float(np.square(nearest_distances(a, b)).mean() + np.square(nearest_distances(b, a)).mean())

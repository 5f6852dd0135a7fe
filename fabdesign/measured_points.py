"""What every measured cloud must satisfy before anything computes with it."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError

_FAR = 10.0  # cloth sizes; a cloud so far off is in another unit, not badly placed
_CENTIMETRES = 100.0  # cloth sizes, below which hundredths are likelier than thousandths


def require_cloud(points: NDArray[np.float64], where: str, *, size: float | None = None) -> None:
    """Raise InputError unless `points` is an (n, 3) cloud in m with n > 0 and finite coordinates.

    size: the cloth's longer side [m], 1 m where it is not known; a cloud ten times as far away is taken to be in
    another unit.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{where}: points of shape {points.shape}; expected (n, 3)")
    if len(points) == 0:
        raise InputError(f"{where}: the cloud is empty; expected points")
    if within_reach(points, size=size):
        return
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(f"{where}: {int(bad.sum())} of {len(points)} points are not finite; expected metres")
    distance = float(np.median(np.linalg.norm(points, axis=1)))
    if distance > _FAR * (size or 1.0):
        unit = "centimetres" if size is not None and distance < _CENTIMETRES * size else "millimetres"
        raise InputError(
            f"{where}: points lie {distance:.0f} m from the cloth's top edge; expected metres (is it in {unit}?)"
        )


def within_reach(points: NDArray[np.float64], *, size: float | None = None) -> bool:
    """Whether every point (n, 3) m is finite and so near that nothing of `require_cloud` can fail but their number."""
    largest = max(float(points.max(initial=0.0)), -float(points.min(initial=0.0)))  # NaN where a point has one
    return largest < _FAR * (size or 1.0) / 2  # of the three coordinates the root of three is the most

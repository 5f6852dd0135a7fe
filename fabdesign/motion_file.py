"""A motion's npz: what `simulate` and `predict` write."""

from dataclasses import dataclass
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.npz_file import NpzArrays, open_npz
from fabdesign.surface import face_triangles


@dataclass(frozen=True, eq=False)
class MotionData:
    """The frames of one motion, all with the same points."""

    time: NDArray[np.float64]  # (T,) s after rest
    points: NDArray[np.float32]  # (T, n, 3) m
    triangles: NDArray[np.intp] | None  # (m, 3), outer side off the sheet; None: not known


def write_motion(path: Path, time: NDArray[np.float64], points: NDArray[np.float32]) -> None:
    """Write `time` (T,) float64 s, `points` (T, 2 n^2, 3) float32 m (order: `ForwardModel.motions`) and `triangles`
    (m, 3) int32 over them."""
    triangles = square_triangles(points.shape[1])
    with path.open("wb") as stream:
        np.savez_compressed(
            stream,
            time=time.astype(np.float64),
            points=points.astype(np.float32),
            triangles=triangles.astype(np.int32),
        )


def read_motion(path: Path) -> MotionData:
    """A motion; the triangles of a file without them are those of two square faces, if its points can be that.

    Raises InputError for a damaged file, a missing array and one of another shape or type.
    """
    with open_npz(path, "a motion's arrays") as arrays:
        points, time = _points(arrays, path), arrays.get("time")
        triangles = arrays.get("triangles") if "triangles" in arrays else None
    count = points.shape[1]
    if time.shape != (len(points),) or time.dtype.kind not in "fiu":
        raise InputError(f"{path}: time is {time.shape} {time.dtype}; expected ({len(points)},) float64")
    time = time.astype(np.float64)
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise InputError(f"{path}: time does not rise frame by frame")
    if triangles is None:
        square = 2 * isqrt(count // 2) ** 2 == count and count >= 8
        return MotionData(time, points, square_triangles(count) if square else None)
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InputError(f"{path}: triangles is {triangles.shape} {triangles.dtype}; expected (m, 3) int32")
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < count:
        raise InputError(f"{path}: triangles name point {triangles.max()}; expected 0 to {count - 1}")
    return MotionData(time, points, triangles.astype(np.intp))


def square_triangles(count: int) -> NDArray[np.intp]:
    """Of two square faces that have `count` points together."""
    side = isqrt(count // 2)
    return face_triangles(side, side)


def _points(arrays: NpzArrays, path: Path) -> NDArray[np.float32]:
    points: NDArray[Any] = arrays.get("points")
    if points.ndim != 3 or points.shape[2] != 3 or not points.size or points.dtype.kind not in "fiu":
        raise InputError(f"{path}: points is {points.shape} {points.dtype}; expected (frames, points, 3) float32")
    bad = ~np.isfinite(points).all(axis=(1, 2))
    if bad.any():
        raise InputError(f"{path}: {int(bad.sum())} of {len(points)} frames are not finite; expected metres")
    return points.astype(np.float32)

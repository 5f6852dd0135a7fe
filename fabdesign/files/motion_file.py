"""A motion's npz, which `simulate` and `predict` write, and its frames as meshes."""

from dataclasses import dataclass
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.ply import ply_bytes
from fabdesign.errors import InputError
from fabdesign.formats.npz_file import NpzArrays, open_npz
from fabdesign.geometry.shape import LacedMuscles
from fabdesign.geometry.surface import face_triangles
from fabdesign.runtime.effort import LONGEST


@dataclass(frozen=True, eq=False)
class MotionData:
    """The frames of one motion, all with the same points."""

    time: NDArray[np.float64]  # (T,) s after rest
    points: NDArray[np.float32]  # (T, n, 3) m
    triangles: NDArray[np.intp] | None  # (m, 3), outer side off the sheet; None: not known
    size: tuple[float, float] | None = None  # m, width and height of the flat cloth; None: not known
    muscles: LacedMuscles | None = None  # None: not known
    band: NDArray[np.float64] | None = None  # (T, 3, 3) m, half-widths of 90 % intervals by region; None: not known


_FARTHEST = 100.0  # m, of what can be no cloth
# optional arrays of a motion's file, by the field of LacedMuscles
_OF_MUSCLES = {
    "points": "muscle_points",
    "begins": "muscle_begins",
    "sides": "muscle_sides",
    "diameters": "muscle_diameters",
    "contraction": "contraction",
    "tension": "tension",
}
_KNOWN_OF_SIMULATOR = ("contraction", "tension")


def write_motion(
    path: Path,
    time: NDArray[np.float64],
    points: NDArray[np.float32],
    *,
    size: tuple[float, float] | None = None,
    muscles: LacedMuscles | None = None,
    band: NDArray[np.float64] | None = None,
) -> None:
    """Write `time` (T,) float64 s, `points` (T, 2 n^2, 3) float32 m (order: `ForwardModel.motions`), `triangles`
    (m, 3) int32 over them, and, where given, `cloth_size` (2,) m, `band90` (T, 3, 3) float32 m and the arrays of the
    muscles (docs/files.md)."""
    arrays: dict[str, Any] = {} if size is None else {"cloth_size": np.array(size, np.float64)}
    if band is not None:
        arrays["band90"] = band.astype(np.float32)
    if muscles is not None:
        states = {name: getattr(muscles, field) for field, name in _OF_MUSCLES.items()}
        arrays |= {name: array for name, array in states.items() if array is not None}
    with path.open("wb") as stream:
        np.savez_compressed(
            stream,
            time=time.astype(np.float64),
            points=points.astype(np.float32),
            triangles=square_triangles(points.shape[1]).astype(np.int32),
            **arrays,
        )


def read_motion(path: Path) -> MotionData:
    """Return a motion; the triangles of a file without them are those of two square faces, if its points can be that.

    Raises InputError for a damaged file, a missing array and one of another shape or type.
    """
    with open_npz(path, "a motion's arrays") as arrays:
        points, time = _points(arrays, path), arrays.get("time")
        triangles = arrays.get("triangles") if "triangles" in arrays else None
        size, muscles = _size(arrays, path), _muscles(arrays, path, len(points))
    count = points.shape[1]
    if time.shape != (len(points),) or time.dtype.kind not in "fiu":
        raise InputError(f"{path}: time is {time.shape} {time.dtype}; expected ({len(points)},) float64")
    time = time.astype(np.float64)
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise InputError(f"{path}: time does not rise frame by frame")
    if time[-1] - time[0] > LONGEST:
        raise InputError(f"{path}: time spans {time[-1] - time[0]:g} s; expected at most {LONGEST:g} s (is it in ms?)")
    if triangles is None:
        square = 2 * isqrt(count // 2) ** 2 == count and count >= 8
        return MotionData(time, points, square_triangles(count) if square else None, size, muscles)
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InputError(f"{path}: triangles is {triangles.shape} {triangles.dtype}; expected (m, 3) int32")
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < count:
        raise InputError(f"{path}: triangles name point {triangles.max()}; expected 0 to {count - 1}")
    return MotionData(time, points, triangles.astype(np.intp), size, muscles)


def read_band(path: Path) -> NDArray[np.float64] | None:
    """Return (T, 3, 3) m of a file of `predict`; None where its model had no intervals."""
    with open_npz(path, "a motion's arrays") as arrays:
        band = arrays.get("band90") if "band90" in arrays else None
    if band is None:
        return None
    if band.ndim != 3 or band.shape[1:] != (3, 3) or band.dtype.kind not in "fiu" or not np.isfinite(band).all():
        raise InputError(f"{path}: band90 is {band.shape} {band.dtype}; expected (frames, 3, 3), finite")
    return band.astype(np.float64)


def square_triangles(count: int) -> NDArray[np.intp]:
    """Return the triangles of two square faces that have `count` points together."""
    side = isqrt(count // 2)
    return face_triangles(side, side)


def _points(arrays: NpzArrays, path: Path) -> NDArray[np.float32]:
    points: NDArray[Any] = arrays.get("points", becomes=np.float32)
    if points.ndim != 3 or points.shape[2] != 3 or not points.size or points.dtype.kind not in "fiu":
        raise InputError(f"{path}: points is {points.shape} {points.dtype}; expected (frames, points, 3) float32")
    bad = ~np.isfinite(points).all(axis=(1, 2))
    if bad.any():
        raise InputError(f"{path}: {int(bad.sum())} of {len(points)} frames are not finite; expected metres")
    farthest = float(np.abs(points).max())
    if farthest > _FARTHEST:
        raise InputError(f"{path}: points lie up to {farthest:.4g} m away; expected metres, at most {_FARTHEST:g}")
    return points.astype(np.float32, copy=False)


def _size(arrays: NpzArrays, path: Path) -> tuple[float, float] | None:
    if "cloth_size" not in arrays:
        return None
    size = arrays.get("cloth_size")
    if size.shape != (2,) or size.dtype.kind not in "fiu" or not (np.isfinite(size) & (size > 0)).all():
        raise InputError(f"{path}: cloth_size is {size.tolist()}; expected width and height in metres")
    return float(size[0]), float(size[1])


def _muscles(arrays: NpzArrays, path: Path, frames: int) -> LacedMuscles | None:
    if "muscle_points" not in arrays:
        return None
    states = {
        field: arrays.get(name)
        for field, name in _OF_MUSCLES.items()
        if name in arrays or field not in _KNOWN_OF_SIMULATOR
    }
    count, points = states["sides"].size, states["points"]
    most = points.shape[1] if points.ndim == 3 else 0
    shapes = {
        "points": (frames, most, 3),
        "begins": (count + 1,),
        "sides": (count,),
        "diameters": (count,),
        **dict.fromkeys(_KNOWN_OF_SIMULATOR, (frames, most - count)),
    }
    for field, array in states.items():
        kinds = "iu" if field in ("begins", "sides") else "fiu"
        if array.shape != shapes[field] or array.dtype.kind not in kinds or not np.isfinite(array).all():
            raise InputError(
                f"{path}: {_OF_MUSCLES[field]} is {array.shape} {array.dtype}; expected {shapes[field]}, finite"
            )
    begins = states["begins"]
    if begins[0] != 0 or begins[-1] != most or (np.diff(begins) < 2).any():
        raise InputError(f"{path}: muscle_begins is {begins.tolist()}; expected 0, ..., {most}, two points a muscle")
    return LacedMuscles(**states)


SUFFIXES = (".ply", ".obj")


def mesh_paths(path: Path, frames: int) -> list[Path]:
    """Return the files of `frames` frames: `path` itself for one frame, else NAME_0000.ply, NAME_0001.ply, ... beside
    it.

    Raises InputError where the name ends neither in .ply nor in .obj.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: expected a mesh to write, {' or '.join(SUFFIXES)}")
    return [path] if frames == 1 else [path.with_stem(f"{path.stem}_{k:04d}") for k in range(frames)]


def write_mesh(path: Path, points: NDArray[np.floating[Any]], triangles: NDArray[np.integer[Any]]) -> None:
    """Write points (n, 3) m and triangles (t, 3), as PLY (binary, float32) or OBJ (text, to the micrometre)."""
    if path.suffix.lower() == ".ply":
        path.write_bytes(ply_bytes(points, triangles))
        return
    lines = ["# metres", *("v {:.6f} {:.6f} {:.6f}".format(*point) for point in points)]
    lines += ["f {} {} {}".format(*corners) for corners in triangles + 1]
    path.write_text("\n".join([*lines, ""]), encoding="ascii", newline="\n")

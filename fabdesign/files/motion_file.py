"""Motions, their npz, which `simulate` and `predict` write, and their frames as meshes."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.ply import ply_bytes
from fabdesign.errors import InputError, needs
from fabdesign.formats.npz_file import NpzArrays, open_npz
from fabdesign.formats.result_tables import Columns, Summary, Tabled
from fabdesign.geometry.shape import LacedMuscles
from fabdesign.geometry.surface import face_triangles
from fabdesign.runtime.effort import LONGEST

if TYPE_CHECKING:
    import xarray

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
SUFFIXES = (".ply", ".obj")


@dataclass(frozen=True, eq=False)
class Motion(Tabled):
    """A motion: frames with the same points, of a cloth front face, then back face. A shape at rest has one frame, at
    the end of its pressures. band: how far 90 % of motions lie at most from it along its normal, in the mean of each of
    nine regions; None where the model has no intervals, or was not asked for them."""

    time: NDArray[np.float64]  # (T,) s after rest
    points: NDArray[np.float32]  # (T, n, 3) m
    triangles: NDArray[np.intp] | None = None  # (m, 3), outer side off the sheet; None: not known
    size: tuple[float, float] | None = None  # m, width and height of the flat cloth; None: not known
    muscles: LacedMuscles | None = None  # None: not known
    band: NDArray[np.float64] | None = None  # (T, 3, 3) m
    json_keys: ClassVar = ("frames", lambda of: len(of.time)), ("points", lambda of: of.points.shape[1])

    @property
    def faces(self) -> NDArray[np.float32]:
        """Return (T, face, row, column, 3) m: face 0 in front, 1 behind; rows from the top edge, columns from the left.

        >>> import numpy as np
        >>> Motion(np.zeros(5), np.zeros((5, 3362, 3), np.float32)).faces.shape
        (5, 2, 41, 41, 3)
        """
        side = round(float(np.sqrt(self.points.shape[1] / 2)))
        return self.points.reshape(len(self.points), 2, side, side, 3)

    @property
    def tension(self) -> NDArray[np.float32] | None:
        """Return (T, intervals) N, between the muscles' fixed points; `muscles.owners` says of which muscle each is.
        None where it is not known."""
        return None if self.muscles is None else self.muscles.tension

    @property
    def contraction(self) -> NDArray[np.float32] | None:
        """Return (T, intervals), 1 - l / l0 of the same intervals."""
        return None if self.muscles is None else self.muscles.contraction

    def to_array(self) -> xarray.DataArray:
        """Return `faces` with named axes: time [s], face, row, column, axis. Needs the extra `tables`."""
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise InputError(needs(error)) from None
        names = ("time", "face", "row", "column", "axis")
        places = {"time": self.time, "face": ["front", "back"], "axis": ["x", "y", "z"]}
        return xarray.DataArray(self.faces, dims=names, coords=places, name="points", attrs={"units": "m"})

    def summary(self) -> Summary:
        """Return the number of frames and points, what box holds them, and the cloth at three instants."""
        from fabdesign.drawings.oblique import wires_svg

        low, high = (end(self.points, axis=(0, 1)) for end in (np.min, np.max))
        head = (
            f"Motion: {len(self.time)} frames of {self.points.shape[1]} points, {self.time[0]:g} to {self.time[-1]:g} s"
        )
        instants = sorted({0, len(self.time) // 2, len(self.time) - 1})
        picture = wires_svg(self.faces[instants, 0])
        return Summary([head], {"axis": ["x", "y", "z"], "lowest m": low, "highest m": high}, [picture])

    def columns(self) -> Columns:
        """Return a row for every point of every frame: time [s], face, row, column, x, y, z [m]."""
        frames, faces, rows, columns, _ = self.faces.shape
        at = np.indices((frames, faces, rows, columns)).reshape(4, -1)
        x, y, z = self.points.reshape(-1, 3).T
        names = np.array(["front", "back"])
        return {"time": self.time[at[0]], "face": names[at[1]], "row": at[2], "column": at[3], "x": x, "y": y, "z": z}


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


def read_motion(path: Path) -> Motion:
    """Return a motion; the triangles of a file without them are those of two square faces, if its points can be that.

    Raises InputError for a damaged file, a missing array and one of another shape or type.
    """
    with open_npz(path, "a motion's arrays") as arrays:
        points = _points(arrays, path)
        frames, count = points.shape[:2]
        time = arrays.sound("time", f"({frames},) float64", lambda a: a.shape == (frames,)).astype(np.float64)
        triangles = None
        if "triangles" in arrays:
            triangles = arrays.sound("triangles", "(m, 3) int32", lambda a: a.ndim == 2 and a.shape[1] == 3, "iu")
        size, muscles = _size(arrays, path), _muscles(arrays, path, frames)
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise InputError(f"{path}: time does not rise frame by frame")
    if time[-1] - time[0] > LONGEST:
        raise InputError(f"{path}: time spans {time[-1] - time[0]:g} s; expected at most {LONGEST:g} s (is it in ms?)")
    if triangles is None:
        square = 2 * isqrt(count // 2) ** 2 == count and count >= 8
        return Motion(time, points, square_triangles(count) if square else None, size, muscles)
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < count:
        raise InputError(f"{path}: triangles name point {triangles.max()}; expected 0 to {count - 1}")
    return Motion(time, points, triangles.astype(np.intp), size, muscles)


def read_band(path: Path) -> NDArray[np.float64] | None:
    """Return (T, 3, 3) m of a file of `predict`; None where its model had no intervals."""
    with open_npz(path, "a motion's arrays") as arrays:
        if "band90" not in arrays:
            return None
        band = arrays.sound(
            "band90", "(frames, 3, 3), finite", lambda a: a.shape[1:] == (3, 3) and np.isfinite(a).all()
        )
    return band.astype(np.float64)


def square_triangles(count: int) -> NDArray[np.intp]:
    """Return the triangles of two square faces that have `count` points together."""
    side = isqrt(count // 2)
    return face_triangles(side, side)


def _points(arrays: NpzArrays, path: Path) -> NDArray[np.float32]:
    expected = "(frames, points, 3) float32"
    points = arrays.sound("points", expected, lambda a: a.ndim == 3 and a.shape[2] == 3 and a.size, becomes=np.float32)
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

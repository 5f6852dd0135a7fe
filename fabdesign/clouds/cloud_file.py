"""Clouds and meshes from files, whatever their kind: one strict reader for targets, recordings and `check`."""

import io
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.mcap_file import read_mcap
from fabdesign.clouds.measured_points import names_instants, require_cloud, require_one_instant, sound_cloud
from fabdesign.clouds.mesh_file import read_mesh
from fabdesign.clouds.pcd import read_pcd
from fabdesign.clouds.ply import read_ply
from fabdesign.clouds.xyz import read_pts, read_xyz
from fabdesign.errors import InputError
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.npz_file import open_npz, read_npy
from fabdesign.formats.toml_file import parsing, read_bytes, require_count
from fabdesign.geometry.placement import Unit
from fabdesign.geometry.surface import Surface

POINTS = 3362  # drawn on a mesh by default: as many as the simulator's faces have


@dataclass(frozen=True, eq=False)
class Geometry:
    """The content of a file, in the file's own unit and frame."""

    points: NDArray[np.float64]  # (n, 3), finite, n > 0; of a mesh its vertices
    triangles: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.intp))  # none of a cloud
    trial: bool = False  # a frame of a measured trial, in m
    time: float | None = None  # s after rest, of a frame
    frame: int | None = None  # from 0
    unit: Unit | None = None  # where the file itself names it

    @property
    def is_mesh(self) -> bool:
        return len(self.triangles) > 0

    def sample(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return a cloud's points as they are; of a mesh (count, 3) even draws."""
        return Surface(self.points, self.triangles).sample(count, rng)[0] if self.is_mesh else self.points


def read_geometry(path: Path | str, *, frame: int = -1) -> Geometry:
    """Read a cloud or a mesh: PLY, PCD, PTS, OBJ, STL, OFF, GLB, glTF, XYZ, CSV, an npy (n, 3), an npz with `points`
    (n, 3), or the given `frame` of a trial's npz, a C3D or an MCAP of one topic.

    Of a cloud what a depth sensor adds is left out and said (`measured_points`). Raises InputError, with one
    line, for a file that is not there, damaged, cut short, too large or of another kind, for no points, for a cloud
    less than half of which is sound, for a mesh with coordinates that are not finite or without area.
    """
    path = Path(path)
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: is of no kind that is read; expected a cloud or mesh ({', '.join(KINDS)})")
    geometry = read(path, frame)
    if geometry.is_mesh:
        require_cloud(geometry.points, str(path), size=np.inf)
        areas = Surface(geometry.points, geometry.triangles).areas
        if not np.isfinite(areas.sum()) or areas.sum() <= 0:
            raise InputError(f"{path}: its triangles have no area; expected a mesh")
        return Geometry(geometry.points, geometry.triangles[areas > 0])  # without those that are a line or a point
    if geometry.trial:
        return geometry
    return replace(geometry, points=sound_cloud(geometry.points, str(path), unit_known=False))


def read_cloud(path: Path | str, *, size: float | None = None) -> NDArray[np.float64]:
    """Return (n, 3) m of a file in metres that `read_geometry` takes; of a mesh POINTS even draws.

    size: the cloth's longer side [m], for the hint that a cloud is in millimetres. Raises InputError.
    """
    geometry = read_geometry(path)
    cloud = geometry.sample(POINTS, np.random.default_rng(0))
    if not geometry.is_mesh:
        return sound_cloud(cloud, str(path), size=size)
    require_cloud(cloud, str(path), size=size)
    return cloud


def _npz(path: Path, frame: int) -> Geometry:
    with open_npz(path, "points (n, 3)") as arrays:
        trial = "offsets" in arrays
        if not trial:
            if (beside := next((name for name in ("scale", "unit", "units") if name in arrays), None)) is not None:
                raise InputError(
                    f"{path}: has {beside} beside points, and no offsets as a trial has; expected points alone"
                )
            require_count(math.prod(arrays.shape("points")) // 3, path, "points")
            points = arrays.sound("points", "numbers (n, 3)", lambda a: a.ndim <= 2)
            require_one_instant({name: arrays.get(name) for name in filter(names_instants, arrays.names)}, str(path))
    if trial:
        data = read_trial(path, size=np.inf)
        index = _frame(frame, len(data.frames), path)
        return Geometry(data.frames[index], trial=True, time=float(data.time[index]), frame=index)
    return Geometry(points)


def _mesh(path: Path, _: int) -> Geometry:
    return Geometry(*read_mesh(path))


def _text(path: Path, _: int) -> Geometry:
    points, unit = read_xyz(path)
    return Geometry(points, unit=unit)


def _mcap(path: Path, frame: int) -> Geometry:
    topics = read_mcap(path)
    if len(topics) > 1:
        raise InputError(f"{path}: has clouds on {', '.join(topics)}; expected one topic, or a recording")
    ((clouds, _),) = topics.values()
    index = _frame(frame, len(clouds), path)
    return Geometry(clouds[index], frame=index, unit="m")


def _c3d(path: Path, frame: int) -> Geometry:
    """Return the markers of a C3D (motion capture), NaN where one was not seen, through the package c3d.

    Format: The C3D file format, www.c3d.org. A marker that was not seen has a negative residual.
    """
    try:
        import c3d
    except ImportError:
        raise InputError(f"{path}: a C3D needs the package c3d; pip install fabdesign[mocap]") from None
    content = read_bytes(path, "a C3D")
    with parsing(path, "cannot be read as a C3D ({})"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = c3d.Reader(io.BytesIO(content))
        frames = [points[:, :4] for _, points, _ in reader.read_frames(copy=True, check_nan=False)]
        declared = reader.last_frame - reader.first_frame + 1
        units = reader.get("POINT:UNITS")
        name = units.string_value.strip().lower() if units is not None else ""
    if not frames or not frames[0].size:
        raise InputError(f"{path}: has no markers; expected a C3D with some")
    if len(frames) != declared:
        raise InputError(f"{path}: has {len(frames)} of {declared} frames; expected a whole C3D")
    if name and name not in get_args(Unit):
        raise InputError(f"{path}: its unit is {name[:20]!r}; expected one of {', '.join(get_args(Unit))}, or none")
    index = _frame(frame, len(frames), path)
    markers = frames[index].astype(np.float64)
    points = np.where(markers[:, 3:] < 0, np.nan, markers[:, :3])
    return Geometry(points, frame=index, unit=next((unit for unit in get_args(Unit) if unit == name), None))


# by the ending of a file's name, in the order in which a message lists them
_READERS: Mapping[str, Callable[[Path, int], Geometry]] = {
    ".ply": lambda path, _: Geometry(*read_ply(path)),
    ".pcd": lambda path, _: Geometry(read_pcd(path)),
    ".pts": lambda path, _: Geometry(read_pts(path)),
    ".obj": _mesh,
    ".npy": lambda path, _: Geometry(read_npy(path)),
    ".npz": _npz,
    ".c3d": _c3d,
    ".mcap": _mcap,
    **dict.fromkeys((".xyz", ".csv", ".txt", ".tsv", ".asc"), _text),
    **dict.fromkeys((".stl", ".off", ".glb", ".gltf"), _mesh),
}
KINDS = tuple(_READERS)


def _frame(frame: int, count: int, path: Path) -> int:
    if not -count <= frame < count:
        raise InputError(f"{path}: frame {frame}; expected -{count} to {count - 1}")
    return frame % count

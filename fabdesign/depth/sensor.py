"""The sensors of a recording, the file that each one's depth images lie in, what of them is the cloth, and the target
that they all saw."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from fabdesign.depth.images import Triple, has_depth, read_depth_npz, read_image_folder, read_mcap_depth
from fabdesign.depth.realsense import read_realsense
from fabdesign.depth.stream import DepthStream
from fabdesign.errors import InputError
from fabdesign.formats.schema import ABOVE_0, FileUnit, Key, Metre, Within
from fabdesign.formats.table import Table
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric

_ORTHONORMAL = 1e-3
_BESIDE, _ABOVE, _AHEAD = 0.05, 0.02, 0.75  # m, m, and of the cloth's longer side: as far as a cloth reaches


def _pose(value: Any, table: Table) -> Array:
    """Return a matrix of a turn and a shift. Raises InputError for any other."""
    try:
        pose = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise table.bad("camera_to_world", "4 rows of 4 numbers") from None
    if pose.shape == (4, 4) and not np.allclose(pose[3], [0, 0, 0, 1], atol=1e-9):
        likely = " (is it transposed?)" if np.allclose(pose[:, 3], [0, 0, 0, 1], atol=1e-9) else ""
        raise table.bad("camera_to_world", f"0, 0, 0, 1 as the last row{likely}")
    turn = pose[:3, :3] if pose.shape == (4, 4) else np.zeros((3, 3))
    if np.abs(turn @ turn.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(turn) < 0:
        raise table.bad("camera_to_world", "a 4x4 matrix of a turn and a shift, metres")
    return pose


@dataclass(frozen=True, eq=False)
class Sensor:
    name: Annotated[str, "of its clouds' files"]
    camera_to_world: Annotated[Array, Key(read=_pose), "(4, 4) m, nominal: good to 10 mm and 2 degrees"]
    topic: Annotated[str | None, "of the recording's MCAP, where it has one"] = None
    bag: Annotated[str | None, "a .bag or .db3 of the RealSense SDK, in place of clouds"] = None
    serial: Annotated[str | None, "of the camera, where the bag has several"] = None
    images: Annotated[str | None, "a folder of 16-bit PNG or TIFF, or an npz stack, in place of clouds"] = None
    intrinsics: Annotated[str | None, "a JSON beside images: Open3D's, Azure Kinect's, or fx, fy, ppx, ppy"] = None
    stamps: Annotated[str | None, "a text with a number [s] for each of the images"] = None
    depth_unit: Annotated[float | None, FileUnit("m"), ABOVE_0, "of images that do not say it; absent: 1 mm"] = None

    @property
    def has_depth(self) -> bool:
        """Return whether depth images are named in place of clouds."""
        return self.bag is not None or self.images is not None

    @property
    def position(self) -> Array:
        return self.camera_to_world[:3, 3]

    @property
    def side(self) -> Literal["front", "back"]:
        """Return the face that the sensor looks at."""
        return "front" if self.position[2] > 0 else "back"

    def resolved(self, table: Table) -> "Sensor":
        """Raise InputError for two sources, and for keys of another source than the sensor's."""
        named = [key for key in ("topic", "bag", "images") if getattr(self, key) is not None]
        if len(named) > 1:
            raise table.error(f"sensor {self.name} has {' and '.join(named)}; expected one of them")
        for key, source in (("serial", "bag"), ("intrinsics", "images"), ("stamps", "images")):
            if getattr(self, key) is not None and getattr(self, source) is None:
                raise table.bad(key, f"{source} beside it")
        if self.bag is not None and Path(self.bag).suffix.lower() not in (".bag", ".db3"):
            raise table.bad("bag", "a file .bag or .db3")
        return self


@dataclass(frozen=True)
class Cut:
    """The cloth's place and colour; what is absent cuts nothing, but for the box."""

    box: Annotated[tuple[Triple, Triple] | None, "two corners, m in the world; absent: as far as the cloth reaches"] = (
        None
    )
    planes: Annotated[tuple[tuple[float, float, float, float], ...], "a, b, c, d: kept is a x + b y + c z >= d, m"] = ()
    colour: Annotated[
        tuple[Triple, Triple] | None, "hue [degrees], saturation, value: from, to; a hue may go on over 360"
    ] = None
    predicted: Annotated[Metre | None, ABOVE_0, "kept is what lies so near to the cloth as it is simulated"] = None

    def resolved(self, table: Table) -> "Cut":
        """Raise InputError for a box without inside and colours out of range."""
        if self.box is not None and not all(a < b for a, b in zip(*self.box, strict=True)):
            raise table.bad("box", "the lower corner, then the upper one")
        if self.colour is not None:
            (h0, *low), (h1, *high) = self.colour
            if not (0 <= h0 < h1 <= 720 and all(0 <= a <= b <= 1 for a, b in zip(low, high, strict=True))):
                raise table.bad("colour", "[hue 0 to 360, saturation 0 to 1, value 0 to 1], from and to")
        return self

    def corners(self, fabric: Fabric) -> Array:
        """Return (2, 3) m, the box's corners."""
        if self.box is not None:
            return np.array(self.box)
        ahead = _AHEAD * max(fabric.width, fabric.height)
        half = fabric.width / 2 + _BESIDE
        return np.array([[-half, -fabric.height - _BESIDE, -ahead], [half, _ABOVE, ahead]])


NO_CUT = Cut()


@dataclass(frozen=True)
class SeenTarget:
    """Where the target was recorded, and what it is; one of `sphere` and `square`."""

    folder: Annotated[str, "with a file of each sensor, named as its own one, that sees the target at several places"]
    sphere: Annotated[Metre | None, Within(above=0, most=0.5), "radius"] = None
    square: Annotated[Metre | None, Within(above=0, most=0.5), "side of a square of a ChArUco board"] = None
    marker: Annotated[Metre | None, Within(above=0, most=0.5), "side of its markers"] = None
    size: Annotated[tuple[int, int], "squares across and down"] = (5, 7)
    dictionary: Annotated[str, "of its markers, as OpenCV names it"] = "DICT_4X4_50"

    def resolved(self, table: Table) -> "SeenTarget":
        """Raise InputError for none or both, and for a board without its markers' size."""
        if (self.sphere is None) == (self.square is None):
            raise table.error("expected sphere (a radius) or square (of a board)")
        if self.square is not None and (self.marker is None or self.marker >= self.square):
            raise table.bad("marker", "the side of the markers, less than square")
        return self


def depth_stream(sensor: Sensor, folder: Path, mcap: Path | None) -> DepthStream | None:
    """Return the depth images of a sensor of the recording in a folder; None where it has clouds. Raises InputError."""
    if sensor.bag is not None:
        return read_realsense(folder / sensor.bag, serial=sensor.serial or "")
    if mcap is not None and sensor.topic is not None:
        return read_mcap_depth(mcap, sensor.topic, unit=sensor.depth_unit) if has_depth(mcap, sensor.topic) else None
    if sensor.images is None:
        return None
    images = folder / sensor.images
    intrinsics = None if sensor.intrinsics is None else folder / sensor.intrinsics
    if images.suffix.lower() == ".npz":
        return read_depth_npz(images, unit=sensor.depth_unit, intrinsics=intrinsics)
    if intrinsics is None:
        raise InputError(f"sensor {sensor.name}: images without intrinsics; expected a JSON beside them")
    stamps = None if sensor.stamps is None else folder / sensor.stamps
    return read_image_folder(images, intrinsics, unit=sensor.depth_unit, stamps=stamps)

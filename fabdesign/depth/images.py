"""Depth streams of 16-bit images: a folder of PNG or TIFF with a JSON of intrinsics (Open3D's, Azure Kinect's, or the
RealSense SDK's names), or an npz stack."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.intrinsics import Intrinsics, intrinsics_of, intrinsics_of_json
from fabdesign.depth.png import colour_image, depth_image
from fabdesign.depth.stream import MOST_FRAMES, DepthStream
from fabdesign.errors import InputError
from fabdesign.formats.npz_file import open_npz
from fabdesign.formats.toml_file import read_bytes, read_text

_ENDINGS = (".png", ".tif", ".tiff")
_COLOUR_ENDINGS = (*_ENDINGS, ".jpg", ".jpeg")
_NUMBER = re.compile(r"\d+")
_MM = 1e-3  # m of a depth unit where nothing else is said: Open3D, Azure Kinect, ROS
_NPZ = "depth (n, rows, columns), and stamps, unit, intrinsics"


def read_image_folder(
    folder: Path, intrinsics: Path, *, unit: float | None = None, stamps: Path | None = None
) -> DepthStream:
    """Return the stream of a folder of depth images, in the order of the numbers in their names.

    unit: m of a depth step, 1 mm where absent. stamps: a text with a number [s] for each image. Colour images of the
    same numbers lie in a folder `color` or `colour` beside it. Raises InputError.
    """
    files = _numbered(folder, _ENDINGS)
    if not files:
        raise InputError(f"{folder}: no images; expected 16-bit PNG or TIFF with numbers in their names")
    first = depth_image(read_bytes(files[0], "a depth image"), str(files[0]))
    camera = read_intrinsics(intrinsics, (first.shape[1], first.shape[0]))
    times = _stamps(stamps, len(files)) if stamps is not None else np.arange(len(files), dtype=np.float64)
    beside = next((folder.parent / name for name in ("color", "colour") if (folder.parent / name).is_dir()), None)
    colours = _numbered(beside, _COLOUR_ENDINGS) if beside is not None else []

    def read(index: int) -> NDArray[np.uint16]:
        return depth_image(read_bytes(files[index], "a depth image"), str(files[index]))

    def colour(index: int) -> NDArray[np.uint8]:
        return colour_image(read_bytes(colours[index], "an image"), str(colours[index]))

    return DepthStream(
        str(folder),
        camera,
        unit or _MM,
        times,
        read,
        "device" if stamps is not None else "none",
        numbers=_numbers(files),
        colour=colour if len(colours) == len(files) else None,
        colour_camera=camera if len(colours) == len(files) else None,
    )


def read_intrinsics(path: Path, size: tuple[int, int] | None = None) -> Intrinsics:
    """Return the intrinsics of a JSON for images of a size (width, height). Raises InputError."""
    text = read_text(path, "a JSON of intrinsics", largest=1_000_000)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is no JSON; expected intrinsics") from None
    return intrinsics_of_json(content, size, str(path))


def read_depth_npz(path: Path, *, unit: float | None = None, intrinsics: Path | None = None) -> DepthStream:
    """Return the stream of an npz: `depth` (n, rows, columns) of 16 bits, and, where they are there, `stamps` (n,) s,
    `unit` m, `intrinsics` (3, 3). Raises InputError."""
    with open_npz(path, _NPZ) as arrays:
        shape = arrays.shape("depth")
        if len(shape) != 3 or not all(shape):
            raise InputError(f"{path}: depth is {shape}; expected (n, rows, columns)")
        depth = arrays.get("depth", np.uint16)
        others = {name: arrays.get(name) for name in ("stamps", "unit", "intrinsics") if name in arrays}
    if depth.dtype != np.uint16:
        raise InputError(f"{path}: depth is {depth.dtype}; expected uint16")
    if others.get("stamps", np.zeros(shape[0])).shape != (shape[0],):
        raise InputError(f"{path}: stamps are {others['stamps'].shape}; expected ({shape[0]},), one an image")
    size = shape[2], shape[1]
    if intrinsics is not None:
        camera = read_intrinsics(intrinsics, size)
    else:
        camera = _camera_of(others.get("intrinsics"), size, path)
    default = float(others["unit"]) if "unit" in others and others["unit"].size == 1 else _MM
    times = others["stamps"].astype(np.float64) if "stamps" in others else np.arange(shape[0], dtype=np.float64)
    clock = "device" if "stamps" in others else "none"
    return DepthStream(str(path), camera, unit or default, times, depth.__getitem__, clock)


def _camera_of(matrix: Any, size: tuple[int, int], path: Path) -> Intrinsics:
    if matrix is None or matrix.shape != (3, 3) or matrix.dtype.kind not in "fiu":
        raise InputError(f"{path}: no intrinsics; expected an array intrinsics (3, 3), or a JSON of the sensor")
    return intrinsics_of(size, (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]), "none", (), str(path))


def _numbered(folder: Path, endings: tuple[str, ...]) -> list[Path]:
    """Return the images of a folder by the numbers in their names, then by name."""
    try:
        files = [file for file in folder.iterdir() if file.suffix.lower() in endings and _NUMBER.search(file.stem)]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read as a folder of images ({error.strerror})") from None
    if len(files) > MOST_FRAMES:
        raise InputError(f"{folder}: {len(files)} images; expected at most {MOST_FRAMES}")
    return sorted(files, key=lambda file: ([int(n[:18]) for n in _NUMBER.findall(file.stem)], file.name))


def _numbers(files: list[Path]) -> NDArray[np.int64] | None:
    """Return the last number of each name where these rise: a frame that is missing among them was lost."""
    numbers = [int(_NUMBER.findall(file.stem)[-1][:18]) for file in files]
    return np.array(numbers, dtype=np.int64) if (np.diff(numbers) > 0).all() else None


def _stamps(path: Path, count: int) -> NDArray[np.float64]:
    """Return the first number of each line. Raises InputError."""
    lines = read_text(path, "a text of stamps", largest=10_000_000).splitlines()
    words = [re.split(r"[,;\s]+", line.strip()) for line in lines if line.strip() and not line.startswith("#")]
    try:
        values = np.array([float(row[0]) for row in words])
    except ValueError:
        raise InputError(f"{path}: a line does not begin with a number; expected a stamp [s] a line") from None
    if len(values) != count:
        raise InputError(f"{path}: {len(values)} stamps; expected {count}, one an image")
    return values

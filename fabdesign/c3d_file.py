"""Markers of a C3D recording (motion capture), through the package c3d.

Format: The C3D file format, www.c3d.org. A marker that was not seen has a negative residual.
"""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from fabdesign.bounded_file import read_bytes
from fabdesign.errors import InputError
from fabdesign.placement import Unit


@dataclass(frozen=True, eq=False)
class Markers:
    frames: NDArray[np.float64]  # (T, n, 3) in the file's unit and frame; NaN where a marker was not seen
    rate: float  # Hz
    unit: Unit | None  # as the file says


def read_c3d(path: Path | str) -> Markers:
    """All markers of a C3D. Raises InputError, also where the package is not there."""
    path = Path(path)
    try:
        import c3d
    except ImportError:
        raise InputError(f"{path}: a C3D needs the package c3d; pip install fabdesign[mocap]") from None
    content = read_bytes(path, "a C3D")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader = c3d.Reader(io.BytesIO(content))
            frames = [points[:, :4] for _, points, _ in reader.read_frames(copy=True, check_nan=False)]
            rate, declared = float(reader.point_rate), reader.last_frame - reader.first_frame + 1
            units = reader.get("POINT:UNITS")
            name = units.string_value.strip().lower() if units is not None else ""
    except Exception as error:  # c3d raises whatever its parser meets
        raise InputError(f"{path}: cannot be read as a C3D ({type(error).__name__})") from None
    if not frames or not frames[0].size:
        raise InputError(f"{path}: has no markers; expected a C3D with some")
    if len(frames) != declared:
        raise InputError(f"{path}: has {len(frames)} of {declared} frames; expected a whole C3D")
    table = np.array(frames, dtype=np.float64)
    points = np.where(table[:, :, 3:] < 0, np.nan, table[:, :, :3])
    return Markers(points, rate, next((unit for unit in get_args(Unit) if unit == name), None))

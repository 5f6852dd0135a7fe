"""A trial's npz: the arrays of `fabdesign.measurement-set/1`."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from fabdesign.clouds.measured_points import note_removed, require_room, sound_points
from fabdesign.errors import InputError
from fabdesign.formats.lab_table import require_measured_pressures, require_seconds
from fabdesign.formats.npz_file import NpzArrays, open_npz
from fabdesign.formats.toml_file import require_count
from fabdesign.nouns.array import Array
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.output import atomic_file
from fabdesign.runtime.effort import LONGEST
from fabdesign.units import from_kpa, in_kpa

SCALE = 1e-4  # m, of a unit in which points are written


@dataclass(frozen=True, eq=False)
class TrialData:
    """The arrays measured in one motion."""

    time: Array  # (T,) s after rest
    pressure: Array  # (T, channels) Pa, set point during the interval that ends at that frame
    frames: tuple[Array, ...]  # T clouds (n_t, 3) m, unordered, both faces

    @cached_property
    def program(self) -> PressureProgram:
        return program_of(self.time, self.pressure)


def read_trial(path: Path, *, size: float | None = None) -> TrialData:
    """Return all arrays of a trial. size: the cloth's longer side [m], for the check that the clouds are in metres.

    What a depth sensor adds to a frame is left out and said (`clouds.measured_points`). Raises InputError for a
    damaged file, a missing array, one of another shape or type, and an empty or odd cloud.
    """
    with open_npz(path, "a trial's arrays") as arrays:
        time, pressure = _time_and_pressure(arrays, path)
        points = arrays.sound("points", "(n, 3) int16 or float", lambda a: a.ndim == 2 and a.shape[1] == 3)
        expected = f"({len(time) + 1},) int64, frames and one"
        offsets = arrays.sound("offsets", expected, lambda a: a.shape == (len(time) + 1,), "iu")
        scale = arrays.get("scale")
    if scale.shape != () or scale.dtype.kind not in "fiu" or not (np.isfinite(scale) and scale > 0):
        raise InputError(f"{path}: scale has shape {scale.shape}; expected one number above 0, metres per unit")
    if offsets[0] != 0 or offsets[-1] != len(points) or (np.diff(offsets.astype(np.int64)) < 0).any():
        raise InputError(f"{path}: offsets do not rise from 0 to the number of points, {len(points)}")
    require_count(int(np.diff(offsets.astype(np.int64)).max()), path, "points in a frame")
    require_room(points, str(path))
    frames: list[Array] = []
    removed, hit = np.zeros(3, dtype=np.intp), 0
    for t, (a, b) in enumerate(pairwise(offsets)):  # one at a time, or all points would lie here three times
        metres = points[a:b].astype(np.float64) * float(scale)
        frame, without = sound_points(metres, f"{path} frame {t}", size=size)
        frames.append(frame)
        removed, hit = removed + without, hit + bool(without.any())
    note_removed(removed, len(points), f"{path}, {hit} of {len(frames)} frames")
    return TrialData(time, pressure, tuple(frames))


def read_trial_pressures(path: Path) -> tuple[Array, Array]:
    """Return `time` (T,) s and `pressure` (T, channels) Pa of a trial, without its clouds. Raises InputError."""
    with open_npz(path, "a trial's arrays") as arrays:
        return _time_and_pressure(arrays, path)


def program_of(time: Array, pressure: Array) -> PressureProgram:
    """Return the program of a trial's arrays: row k holds until time[k], the first from 0."""
    start = np.concatenate([[0.0], time[:-1]])
    if len(time) > 1 and time[0] == 0:  # a frame at rest: its row holds for no time
        start, pressure = start[1:], pressure[1:]
    return PressureProgram.of_rows(start, pressure, duration=float(time[-1]))


def write_trial(data: TrialData, path: Path) -> None:
    """Write a trial, its points as int16 in units of SCALE. Raises InputError where they do not fit."""
    units = np.rint(np.concatenate(data.frames) / SCALE)
    farthest, most = np.abs(units).max() * SCALE, np.iinfo(np.int16).max * SCALE
    if farthest > most:
        raise InputError(
            f"trial {path.stem}: points {farthest:.3g} m from the middle of the top edge; expected at most {most:.3g} m"
        )
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(
            stream,
            time=data.time.astype(np.float64),
            pressure=in_kpa(data.pressure).astype(np.float32),
            points=units.astype(np.int16),
            scale=np.float64(SCALE),
            offsets=np.cumsum([0, *(len(frame) for frame in data.frames)], dtype=np.int64),
        )


def _time_and_pressure(arrays: NpzArrays, path: Path) -> tuple[Array, Array]:
    for name in ("time", "pressure"):
        require_count(math.prod(arrays.shape(name)), path, f"values of {name}")
    seconds = arrays.sound("time", "(T,) float64", lambda a: a.ndim == 1 and len(a)).astype(np.float64)
    if not np.isfinite(seconds).all() or seconds[0] < 0 or (np.diff(seconds) <= 0).any():
        raise InputError(f"{path}: time does not rise from 0 s or later, frame by frame")
    require_seconds(seconds, str(path))
    if seconds[-1] > LONGEST:
        raise InputError(f"{path}: time goes to {seconds[-1]:g} s; expected at most {LONGEST:g} s")
    rows = f"({len(seconds)}, channels) float32, kPa"
    kilopascal = arrays.sound("pressure", rows, lambda a: a.ndim == 2 and len(a) == len(seconds))
    # a tenth of a pascal, a thousandth of the regulator's step: takes off what float32 adds
    pressure = np.round(from_kpa(kilopascal.astype(np.float64)), 1)
    require_measured_pressures(pressure, str(path))
    return seconds, pressure

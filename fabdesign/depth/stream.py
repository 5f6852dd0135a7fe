"""A depth recording: what every kind of file becomes. One camera's depth images with intrinsics, unit and stamps; and
which images or clouds of several cameras belong to one frame, by their stamps: a lost message shifts nothing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.intrinsics import Intrinsics
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array

MOST_FRAMES = 100_000
_UNITS = (1e-6, 0.1)  # m: of a depth unit
_SHORTEST = 1e6  # ns between frames; what lies closer is no stamp of a camera
_REPEATED = 0.5  # of the interval: a message that follows so soon repeats the one before
_TOGETHER = 0.75  # of the interval: farther apart, two clouds are not of one frame


@dataclass(frozen=True, eq=False)
class DepthStream:
    """The depth images of one camera, read one by one. Stamps are seconds on the clock that they name."""

    where: str  # the file, and the stream in it, for messages
    camera: Intrinsics
    unit: float  # m of one step of depth
    stamps: Array  # (n,) s, of every image, in the order of the file
    read: Callable[[int], NDArray[np.uint16]]  # (height, width) of one image; 0: no depth there. Raises InputError
    clock: str = "device"  # "device", "global" (of the computer, shared by its cameras), or "none": no stamps
    numbers: NDArray[np.int64] | None = None  # (n,) the camera's frame counter
    colour: Callable[[int], NDArray[np.uint8]] | None = None  # (rows, columns, 3) beside an image, where it was kept
    colour_camera: Intrinsics | None = None
    depth_to_colour: Array | None = None  # (3, 4) turn and shift [m] of points; None: the images lie on each other
    serial: str = ""
    gravity: Array | None = None  # (3,) m/s^2 in the camera's frame, where an accelerometer says it

    def __post_init__(self) -> None:
        """Raise InputError for no images, too many, and another unit than a camera's."""
        if not len(self.stamps):
            raise InputError(f"{self.where}: no depth images; expected some")
        if len(self.stamps) > MOST_FRAMES:
            raise InputError(f"{self.where}: {len(self.stamps)} images; expected at most {MOST_FRAMES}")
        if not np.isfinite(self.stamps).all():
            raise InputError(f"{self.where}: a stamp is not finite; expected seconds")
        if not _UNITS[0] <= self.unit <= _UNITS[1]:
            raise InputError(f"{self.where}: a depth unit of {self.unit:g} m; expected {_UNITS[0]:g} to {_UNITS[1]:g}")

    def depth(self, index: int) -> NDArray[np.uint16]:
        """Return an image (height, width) in units of `unit`. Raises InputError for another size than the camera's."""
        image = self.read(index)
        size = self.camera.height, self.camera.width
        if image.shape != size:
            raise InputError(
                f"{self.where}, image {index}: is {image.shape[1]} x {image.shape[0]}; expected {size[1]} x {size[0]}"
            )
        return image

    def cloud(self, index: int) -> Array:
        """Return the points (n, 3) m of an image in the camera's frame, z forward and y down."""
        return cloud_of(self.depth(index) * self.unit, self.camera.slopes)


def cloud_of(depth: NDArray[np.floating[Any]], slopes: Array) -> Array:
    """Return the points (n, 3) m of the pixels that have a depth [m], by the slopes of their rays."""
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns, None]
    return np.asarray(np.concatenate([slopes[rows, columns] * z, z], axis=1))


def paired_as_stamped(
    streams: Sequence[DepthStream], rate: float | None, where: str
) -> tuple[tuple[DepthStream, ...], NDArray[np.intp]]:
    """Return the streams with stamps in s and (T, streams) which images make a frame by the stamps as they are.

    First images of clocks that are the cameras' own are taken to be of one instant: `fuse` finds how they differ.
    rate: Hz, of images without stamps. Raises InputError where that is absent.
    """
    if any(s.clock == "none" for s in streams) and rate is None:
        raise InputError(f"{where}: images without stamps and no frame_rate; expected one of them")
    timed = tuple(replace(s, stamps=s.stamps / (rate or 1.0)) if s.clock == "none" else s for s in streams)
    shared = all(s.clock == "global" for s in timed)
    first = [timed[0].stamps.min() if shared else s.stamps.min() for s in timed]
    pairs = pair_frames([np.round(1e9 * (s.stamps - t)).astype(np.int64) for s, t in zip(timed, first, strict=True)])
    if pairs is not None and pairs.complete.any():
        return timed, pairs.clouds[pairs.complete]
    count = min(len(s.stamps) for s in timed)
    return timed, np.tile(np.arange(count)[:, None], (1, len(timed)))


@dataclass(frozen=True, eq=False)
class FramePairs:
    """The frames of a recording in the order of their stamps."""

    clouds: NDArray[np.intp]  # (T, sensors) the number of each sensor's cloud; -1: it has none of this frame
    time: Array  # (T,) s after the first frame
    repeated: int  # messages that were left out since they repeat the one before
    interval: float  # s between frames, the median

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Return (T,) whether every sensor has a cloud."""
        return np.asarray((self.clouds >= 0).all(axis=1))


def pair_frames(stamps: Sequence[NDArray[np.int64]]) -> FramePairs | None:
    """Pair clouds by their stamps [ns], an array for each sensor in the order of its messages.

    None where the stamps say nothing: too few, alike, or of clocks that do not agree.
    """
    if min(map(len, stamps)) < 2:
        return None
    first = min(int(times.min()) for times in stamps)
    seconds = [times - first for times in stamps]
    gaps = np.concatenate([np.diff(np.unique(times)) for times in seconds])
    interval = float(np.median(gaps)) if len(gaps) else 0.0
    if interval < _SHORTEST:
        return None
    kept = []
    for times in seconds:
        numbers: list[int] = []
        for number in np.argsort(times, kind="stable"):
            if not numbers or times[number] - times[numbers[-1]] > _REPEATED * interval:
                numbers.append(int(number))
        kept.append(numbers)
    reference = int(np.argmax([len(numbers) for numbers in kept]))
    at = seconds[reference][kept[reference]]
    frames = [{reference: number} for number in kept[reference]]
    unpaired: list[dict[int, int]] = []
    for sensor, numbers in enumerate(kept):
        if sensor == reference:
            continue
        times = seconds[sensor][numbers]
        nearest = _nearest(times, at)
        mutual = _nearest(at, times)[nearest] == np.arange(len(times))
        paired = mutual & (np.abs(times - at[nearest]) < _TOGETHER * interval)
        for number, frame, both in zip(numbers, nearest, paired, strict=True):
            if both:
                frames[frame][sensor] = number
            else:
                unpaired.append({sensor: number})
    if len(stamps) > 1 and 2 * sum(len(frame) == len(stamps) for frame in frames) < len(frames):
        return None
    frames = sorted(frames + unpaired, key=lambda frame: min(seconds[s][n] for s, n in frame.items()))
    clouds = np.array([[frame.get(sensor, -1) for sensor in range(len(stamps))] for frame in frames])
    time = np.array([np.mean([seconds[s][n] for s, n in frame.items()]) for frame in frames]) * 1e-9
    repeated = sum(map(len, stamps)) - sum(map(len, kept))
    return FramePairs(clouds, np.round(time - time[0], 6), repeated, interval * 1e-9)


def _nearest(of: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return of each stamp the number of the nearest of others. Both rise."""
    after = np.clip(np.searchsorted(among, of), 1, max(len(among) - 1, 1))
    after = np.minimum(after, len(among) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(of - among[before] <= among[after] - of, before, after)


def left_out_line(pairs: FramePairs, topics: Sequence[str], times: Array, where: str) -> str:
    """Return a line on the frames that are left out since a sensor lost them, and on what stands twice; "" for none."""
    lost = [f"{topics[column]} at {times[k]:.3g} s" for k, column in np.argwhere(pairs.clouds < 0)]
    shown = f" (no cloud on {', '.join(lost[:3])}{', ...' * (len(lost) > 3)})" if lost else ""
    counts = f"{int((~pairs.complete).sum())} of {len(times)} frames are left out{shown}"
    line = f"{where}: by the stamps {counts}, and {pairs.repeated} clouds that repeat the one before"
    return line if lost or pairs.repeated else ""

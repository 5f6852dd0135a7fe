"""A depth recording: what every kind of file becomes. One camera's depth images with intrinsics, unit and stamps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.frame_pairs import pair_frames
from fabdesign.depth.intrinsics import Intrinsics
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array

MOST_FRAMES = 100_000
_UNITS = (1e-6, 0.1)  # m: of a depth unit


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
        return cloud_of(self.depth(index), self.unit, self.camera)


def cloud_of(image: NDArray[np.uint16], unit: float, camera: Intrinsics) -> Array:
    """Return the points (n, 3) m of the pixels that have a depth."""
    rows, columns = np.nonzero(image)
    z = image[rows, columns] * unit
    slopes = camera.slopes[rows, columns]
    return np.concatenate([slopes * z[:, None], z[:, None]], axis=1)


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
    if pairs is not None and pairs.whole.any():
        return timed, pairs.clouds[pairs.whole]
    count = min(len(s.stamps) for s in timed)
    return timed, np.tile(np.arange(count)[:, None], (1, len(timed)))

"""Depth streams of recordings of the RealSense SDK and its Viewer: `.bag` (ROS 1) and `.db3` (ROS 2, SQLite), through
the package rosbags (the extra `realsense`).

Formats: librealsense, src/media/ros (topics of file version 2 and later); wiki.ros.org/Bags/Format/2.0. A `.bag` has
raw images, whose stamp is the frame's, and metadata as key and value; a `.db3` has 16-bit PNG behind 12 bytes, and
metadata as "key=value;...". In both the messages of a frame have one log time.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.png import colour_image
from fabdesign.depth.realsense_info import (
    BagStream,
    camera_of,
    depth_to_colour,
    depth_unit,
    gravity_of,
    metadata_of,
    serial_of,
)
from fabdesign.depth.ros_image import COLOUR, bound_chunks, cdr_stamp, depth_of, plain_image, ros1_image, ros1_stamp
from fabdesign.depth.stream import MOST_FRAMES, DepthStream
from fabdesign.errors import InputError

LARGEST = 64_000_000_000  # bytes of a file, of which one chunk at a time is read
_TOPIC = re.compile(r"/device_(\d+)/sensor_(\d+)/(Depth|Color)_(\d+)/(.*)")
_GLOBAL = ("global time", "system time")


def read_realsense(path: Path | str, *, serial: str = "") -> DepthStream:
    """Return the depth stream of a recording; `serial`: of that camera, where the file has several.

    Raises InputError for a file that is not there, damaged, not indexed, too large, or without depth images, and
    where the package is not there.
    """
    path = Path(path)
    reader = _opened(path)
    try:
        streams = _streams(reader.connections)
        depths = {key: stream for key, stream in streams.items() if key[1] == "Depth"}
        devices = {key: serial_of(reader, key[0]) for key in depths}
        chosen = [key for key in depths if not serial or devices[key] == serial]
        if len(chosen) != 1:
            held = ", ".join(devices[key] or f"device {key[0]}" for key in depths) or "none"
            raise InputError(
                f"{path}: depth streams of {held}; expected "
                + (f"one of the camera {serial[:40]!r}" if serial else "one, or a serial that chooses")
            )
        colour = next((stream for key, stream in streams.items() if key[:2] == (chosen[0][0], "Color")), None)
        return _stream(reader, path, depths[chosen[0]], colour, devices[chosen[0]])
    except InputError:
        raise
    except Exception as error:  # rosbags raises whatever its parsers meet
        raise _unreadable(path, error) from None


def _opened(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(
            f"{path}: a RealSense recording needs {error.name}; pip install fabdesign[realsense]"
        ) from None
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such file" if not path.exists() else f"{path}: is no plain file")
        if (size := path.stat().st_size) > LARGEST:
            raise InputError(f"{path}: has {size / 1e9:.0f} GB; expected at most {LARGEST / 1e9:.0f} GB")
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except InputError:
        raise
    except Exception as error:
        if "index" in str(error):
            raise InputError(
                f"{path}: has no index, its recorder did not end; expected a whole one (`rosbag reindex` mends it)"
            ) from None
        raise _unreadable(path, error) from None
    if path.suffix.lower() == ".bag":
        bound_chunks(reader.readers[0], path)
    return reader


def _streams(connections: Sequence[Any]) -> dict[tuple[int, str, int], BagStream]:
    streams: dict[tuple[int, str, int], dict[str, Any]] = {}
    for connection in connections:
        if matched := _TOPIC.fullmatch(connection.topic):
            key = int(matched[1][:9]), matched[3], int(matched[4][:9])
            streams.setdefault(key, {})[matched[5]] = connection
    return {key: BagStream(key[0], parts) for key, parts in streams.items() if _image_part(parts) is not None}


def _image_part(parts: Mapping[str, Any]) -> str | None:
    """Return which connection of a stream has its images."""
    return next((p for p in ("image/data", "image/data/compressedDepth", "image/data/compressed") if p in parts), None)


def _stream(reader: Any, path: Path, depth: BagStream, colour: BagStream | None, serial: str) -> DepthStream:
    where = f"{path}: depth"
    camera = camera_of(reader, depth, where)
    images = depth.parts[str(_image_part(depth.parts))]
    if images.msgcount > MOST_FRAMES:
        raise InputError(f"{where}: {images.msgcount} images; expected at most {MOST_FRAMES}")
    metadata = metadata_of(reader, depth)
    times, stamps, numbers = _counted(reader, images, metadata)
    domains = {each["timestamp_domain"].strip().lower() for each in metadata.values() if "timestamp_domain" in each}
    clock = "global" if domains and domains <= set(_GLOBAL) else "device"
    units = [float(each["depth_units"]) for each in metadata.values() if "depth_units" in each]
    unit = units[0] if units else depth_unit(reader, depth)
    read = _reader(reader, images, times, where)
    shown = None
    if colour is not None:
        shown = _colours(reader, colour.parts[str(_image_part(colour.parts))], times, f"{path}: colour")
    return DepthStream(
        where,
        camera,
        unit,
        stamps,
        read,
        clock,
        numbers,
        shown,
        None if colour is None else camera_of(reader, colour, f"{path}: colour"),
        None if colour is None else depth_to_colour(reader, depth, colour),
        serial,
        gravity_of(reader, depth),
    )


class _Counted(NamedTuple):
    """The log time [ns] of every image, and the frame's own stamp [s] and number; None where nothing says it."""

    times: list[int]
    stamps: NDArray[np.float64]
    numbers: NDArray[np.int64] | None


def _counted(reader: Any, images: Any, metadata: Mapping[int, Mapping[str, str]]) -> _Counted:
    """Return what is known of every image: of a `.db3` by the metadata, of a `.bag` by how the message begins."""
    times, stamps, counters = [], [], []
    for _, time, raw in reader.messages(connections=[images]):
        if len(raw) < 16:
            raise InputError(f"{reader.paths[0]}: an image of {len(raw)} bytes; expected a header")
        times.append(time)
        stamps.append(cdr_stamp(raw) if reader.is2 else ros1_stamp(raw))
        counters.append(None if reader.is2 else str(struct.unpack_from("<I", raw)[0]))

    def said(key: str) -> list[str | None]:
        return [metadata.get(time, {}).get(key) for time in times]

    milliseconds, numbers = said("timestamp"), said("Frame number")
    if None not in milliseconds:
        stamps = [1e-3 * float(str(each)) for each in milliseconds]
    numbers = counters if None in numbers else numbers
    counts = None if None in numbers else np.array([int(str(n)) for n in numbers], np.int64)
    return _Counted(times, np.array(stamps), counts)


def _message(reader: Any, images: Any, time: int, repeat: int, where: str) -> Any:
    """Return the image at a log time, the `repeat`-th of several. Raises InputError."""
    try:
        for k, (_, _, raw) in enumerate(reader.messages(connections=[images], start=time, stop=time + 1)):
            if k == repeat:
                return reader.deserialize(raw, images.msgtype) if reader.is2 else ros1_image(bytes(raw), where)
    except InputError:
        raise
    except Exception as error:
        raise _unreadable(where, error) from None
    raise InputError(f"{where}: an image is gone; has the file changed?")


def _reader(reader: Any, images: Any, times: Sequence[int], where: str) -> Callable[[int], NDArray[np.uint16]]:
    places = [(time, sum(1 for t in times[max(0, k - 8) : k] if t == time)) for k, time in enumerate(times)]

    @lru_cache(maxsize=2)
    def read(index: int) -> NDArray[np.uint16]:
        what = f"{where}, image {index}"
        return depth_of(_message(reader, images, *places[index], what), what)

    return read


def _colours(reader: Any, images: Any, times: Sequence[int], where: str) -> Callable[[int], NDArray[np.uint8]]:
    """Return what reads the colour image that was logged nearest to a depth image."""
    logged = np.array([time for _, time, _ in reader.messages(connections=[images])], dtype=np.int64)

    def read(index: int) -> NDArray[np.uint8]:
        what = f"{where} beside image {index}"
        if not len(logged):
            raise InputError(f"{what}: no images")
        message = _message(reader, images, int(logged[np.abs(logged - times[index]).argmin()]), 0, what)
        return colour_image(bytes(message.data), what) if reader.is2 else plain_image(message, COLOUR, what)

    return read


def _unreadable(path: Path | str, error: Exception) -> InputError:
    return InputError(f"{path}: cannot be read as a RealSense recording ({type(error).__name__})")

"""Depth streams of recordings of the RealSense SDK and its Viewer: `.bag` (ROS 1) and `.db3` (ROS 2, SQLite), through
the package rosbags (the extra `realsense`).

Formats: librealsense, src/media/ros (topics of file version 2 and later); wiki.ros.org/Bags/Format/2.0. A `.bag` has
raw images, whose stamp is the frame's, and metadata as key and value; a `.db3` has 16-bit PNG behind 12 bytes, and
metadata as "key=value;...". In both the messages of a frame have one log time.
"""

import bz2
import re
import struct
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.images import COLOUR, cdr_stamp, colour_image, depth_of, plain_image, ros1_image
from fabdesign.depth.realsense_info import BagStream, depth_to_colour, depth_unit, gravity_of, serial_of
from fabdesign.depth.stream import MOST_FRAMES, DepthStream
from fabdesign.errors import InputError
from fabdesign.formats.toml_file import parsing

LARGEST = 64_000_000_000  # bytes of a file, of which one chunk at a time is read
LARGEST_CHUNK = 256_000_000  # bytes of a chunk, unpacked
_TOPIC = re.compile(r"/device_(\d+)/sensor_(\d+)/(Depth|Color)_(\d+)/(.*)")
_IMAGES = ("image/data", "image/data/compressedDepth", "image/data/compressed")
_GLOBAL = {"global time", "system time"}
_UNREADABLE = "cannot be read as a RealSense recording ({})"


def read_realsense(path: Path | str, *, serial: str = "") -> DepthStream:
    """Return the depth stream of a recording; `serial`: of that camera, where the file has several.

    Raises InputError for a file that is not there, damaged, not indexed, too large, or without depth images, and
    where the package is not there.
    """
    path = Path(path)
    reader = _opened(path)
    with parsing(path, _UNREADABLE):
        streams = _streams(reader)
        depths = [stream for (_, kind, _), stream in streams.items() if kind == "Depth"]
        serials = [serial_of(stream) for stream in depths]
        chosen = [stream for stream, its in zip(depths, serials, strict=True) if not serial or its == serial]
        if len(chosen) != 1:
            named = [its or f"device {stream.device}" for stream, its in zip(depths, serials, strict=True)]
            raise InputError(
                f"{path}: depth streams of {', '.join(named) or 'none'}; expected "
                + (f"one of the camera {serial[:40]!r}" if serial else "one, or a serial that chooses")
            )
        (depth,) = chosen
        beside = (each for key, each in streams.items() if key[:2] == (depth.device, "Color"))
        return _stream(depth, next(beside, None), path, serials[depths.index(depth)])


def _opened(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(
            f"{path}: a RealSense recording needs {error.name}; pip install fabdesign[realsense]"
        ) from None
    with parsing(path, _UNREADABLE):
        if not path.is_file():
            raise InputError(f"{path}: no such file" if not path.exists() else f"{path}: is no plain file")
        if (size := path.stat().st_size) > LARGEST:
            raise InputError(f"{path}: has {size / 1e9:.0f} GB; expected at most {LARGEST / 1e9:.0f} GB")
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        try:
            reader.open()
        except Exception as error:
            if "index" not in str(error):
                raise
            raise InputError(
                f"{path}: has no index, its recorder did not end; expected a whole one (`rosbag reindex` mends it)"
            ) from None
    if path.suffix.lower() == ".bag":
        _bound_chunks(reader.readers[0], path, min(size, LARGEST_CHUNK))
    return reader


def _bound_chunks(reader: Any, path: Path, most: int) -> None:
    """Make every chunk unpack to a limit at most, and refuse chunks of over `most` bytes."""
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as rosbag1

    def unpack(make: Callable[[], Any], content: bytes) -> bytes:
        machine = make()
        unpacked = machine.decompress(content, max_length=LARGEST_CHUNK)
        if not machine.eof:
            raise InputError(f"{path}: a chunk unpacks to over {LARGEST_CHUNK / 1e6:.0f} MB, or is cut short")
        return bytes(unpacked)

    machines = {"bz2": bz2.BZ2Decompressor, "lz4": LZ4FrameDecompressor}
    bounded = {rosbag1.decompressors[name]: partial(unpack, make) for name, make in machines.items()}
    for place, chunk in reader.chunks.items():
        if chunk.datasize > most:
            raise InputError(
                f"{path}: a chunk of {chunk.datasize / 1e6:.0f} MB; expected at most {LARGEST_CHUNK / 1e6:.0f}"
            )
        reader.chunks[place] = chunk._replace(decompressor=bounded.get(chunk.decompressor, chunk.decompressor))


def _streams(reader: Any) -> dict[tuple[int, str, int], BagStream]:
    """Return the streams that have images by device, kind and number."""
    streams: dict[tuple[int, str, int], BagStream] = {}
    for connection in reader.connections:
        if matched := _TOPIC.fullmatch(connection.topic):
            key = int(matched[1][:9]), matched[3], int(matched[4][:9])
            streams.setdefault(key, BagStream(reader, key[0])).parts[matched[5]] = connection
    return {key: stream for key, stream in streams.items() if not stream.parts.keys().isdisjoint(_IMAGES)}


def _images(stream: BagStream) -> Any:
    return next(stream.parts[part] for part in _IMAGES if part in stream.parts)


def _stream(depth: BagStream, colour: BagStream | None, path: Path, serial: str) -> DepthStream:
    where, of_colour = f"{path}: depth", f"{path}: colour"
    camera, images = depth.camera(where), _images(depth)
    if images.msgcount > MOST_FRAMES:
        raise InputError(f"{where}: {images.msgcount} images; expected at most {MOST_FRAMES}")
    times, stamps, counters = [], list[float](), list[int | None]()
    for _, time, raw in depth.reader.messages(connections=[images]):
        if len(raw) < 16:
            raise InputError(f"{path}: an image of {len(raw)} bytes; expected a header")
        number, seconds, nanoseconds = struct.unpack_from("<III", raw)
        times.append(time)
        stamps.append(cdr_stamp(raw) if depth.reader.is2 else float(seconds + 1e-9 * nanoseconds))
        counters.append(None if depth.reader.is2 else number)
    metadata = depth.metadata()

    def values_of(key: str) -> list[str | None]:
        return [metadata.get(time, {}).get(key) for time in times]

    if None not in (milliseconds := values_of("timestamp")):
        stamps = [1e-3 * float(str(each)) for each in milliseconds]
    if None not in (numbers := values_of("Frame number")):
        counters = [int(str(number)) for number in numbers]
    domains = {each["timestamp_domain"].strip().lower() for each in metadata.values() if "timestamp_domain" in each}
    units = [float(each["depth_units"]) for each in metadata.values() if "depth_units" in each]
    return DepthStream(
        where,
        camera,
        units[0] if units else depth_unit(depth),
        np.array(stamps),
        _depths(depth, images, times, where),
        "global" if domains and domains <= _GLOBAL else "device",
        None if None in counters else np.array(counters, np.int64),
        None if colour is None else _colours(colour, times, of_colour),
        None if colour is None else colour.camera(of_colour),
        None if colour is None else depth_to_colour(depth, colour),
        serial,
        gravity_of(depth),
    )


def _message(reader: Any, images: Any, time: int, repeat: int, where: str) -> Any:
    """Return the image at a log time, the `repeat`-th of several. Raises InputError."""
    with parsing(where, _UNREADABLE):
        for k, (_, _, raw) in enumerate(reader.messages(connections=[images], start=time, stop=time + 1)):
            if k == repeat:
                return reader.deserialize(raw, images.msgtype) if reader.is2 else ros1_image(bytes(raw), where)
    raise InputError(f"{where}: an image is gone; has the file changed?")


def _depths(depth: BagStream, images: Any, times: Sequence[int], where: str) -> Callable[[int], NDArray[np.uint16]]:
    @lru_cache(maxsize=2)
    def read(index: int) -> NDArray[np.uint16]:
        what, repeat = f"{where}, image {index}", times[max(0, index - 8) : index].count(times[index])
        return depth_of(_message(depth.reader, images, times[index], repeat, what), what)

    return read


def _colours(colour: BagStream, times: Sequence[int], where: str) -> Callable[[int], NDArray[np.uint8]]:
    """Return what reads the colour image that was logged nearest to a depth image."""
    reader, images = colour.reader, _images(colour)
    logged = np.array([time for _, time, _ in reader.messages(connections=[images])], dtype=np.int64)

    def read(index: int) -> NDArray[np.uint8]:
        what = f"{where} beside image {index}"
        if not len(logged):
            raise InputError(f"{what}: no images")
        message = _message(reader, images, int(logged[np.abs(logged - times[index]).argmin()]), 0, what)
        return colour_image(bytes(message.data), what) if reader.is2 else plain_image(message, COLOUR, what)

    return read

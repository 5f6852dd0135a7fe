"""Images in messages of ROS: sensor_msgs/Image of ROS 1 as the RealSense SDK writes it, sensor_msgs/msg/Image of ROS 2;
and the chunks of a ROS 1 bag, which unpack to a limit."""

import bz2
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.intrinsics import Intrinsics, intrinsics_of
from fabdesign.depth.png import depth_image
from fabdesign.errors import InputError

_COMPRESSED_DEPTH = 12  # bytes before the PNG of a compressedDepth message
_ENCODINGS = {"16UC1": ("u2", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3)}
DEPTH, COLOUR, METRES = ("16UC1", "mono16"), ("rgb8", "bgr8"), ("32FC1",)
LARGEST_CHUNK = 256_000_000  # bytes of a chunk, unpacked


def bound_chunks(reader: Any, path: Path) -> None:
    """Make every chunk unpack to a limit at most, and refuse chunks that are larger than the file."""
    from lz4.frame import LZ4FrameDecompressor

    def bounded(make: Callable[[], Any]) -> Callable[[bytes], bytes]:
        def unpack(content: bytes) -> bytes:
            machine = make()
            unpacked = machine.decompress(content, max_length=LARGEST_CHUNK)
            if not machine.eof:
                raise InputError(f"{path}: a chunk unpacks to over {LARGEST_CHUNK / 1e6:.0f} MB, or is cut short")
            return bytes(unpacked)

        return unpack

    kinds = {"bz2": bounded(bz2.BZ2Decompressor), "lz4": bounded(LZ4FrameDecompressor)}
    from rosbags.rosbag1 import reader as rosbag1

    names = {function: name for name, function in rosbag1.decompressors.items()}
    size = path.stat().st_size
    for place, chunk in reader.chunks.items():
        if chunk.datasize > min(size, LARGEST_CHUNK):
            raise InputError(
                f"{path}: a chunk of {chunk.datasize / 1e6:.0f} MB; expected at most {LARGEST_CHUNK / 1e6:.0f}"
            )
        name = names.get(chunk.decompressor, "none")
        reader.chunks[place] = chunk._replace(decompressor=kinds.get(name, chunk.decompressor))


def ros1_stamp(raw: bytes) -> float:
    """Return the stamp [s] of a message of ROS 1 that begins with a header."""
    seconds, nanoseconds = struct.unpack_from("<II", raw, 4)
    return float(seconds + 1e-9 * nanoseconds)


def cdr_stamp(raw: bytes) -> float:
    """Return the stamp [s] of a message in CDR that begins with a header."""
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    return float(seconds + 1e-9 * nanoseconds)


def ros1_image(raw: bytes, where: str) -> Any:
    """Return the fields of a sensor_msgs/Image, which the SDK writes longer than ROS, so that rosbags refuses it."""

    def text(at: int) -> tuple[str, int]:
        (length,) = struct.unpack_from("<I", raw, at)
        if length > 200 or at + 4 + length > len(raw):
            raise InputError(f"{where}: a text of {length} bytes; expected a name")
        return raw[at + 4 : at + 4 + length].decode("ascii", "replace"), at + 4 + length

    _, at = text(12)
    rows, columns = struct.unpack_from("<II", raw, at)
    encoding, at = text(at + 8)
    big, step, length = struct.unpack_from("<BII", raw, at)
    data = memoryview(raw)[at + 9 : at + 9 + length]
    return SimpleNamespace(height=rows, width=columns, encoding=encoding, is_bigendian=big, step=step, data=data)


def depth_of(message: Any, where: str) -> NDArray[np.uint16]:
    """Return (rows, columns) of a sensor_msgs/msg/Image of 16 bits, or of a CompressedImage, bare or as
    `compressedDepth`. Raises InputError."""
    if not hasattr(message, "format"):
        return plain_image(message, DEPTH, where)
    skip = _COMPRESSED_DEPTH if "compresseddepth" in str(message.format).lower() else 0
    return depth_image(bytes(message.data)[skip:], where)


def camera_of_info(message: Any, where: str, name: str = "CameraInfo") -> Intrinsics:
    """Return the intrinsics of a CameraInfo of ROS 1 or 2. Raises InputError."""
    k: Any = getattr(message, "K", getattr(message, "k", ()))
    d: Any = getattr(message, "D", getattr(message, "d", ()))
    if len(k) != 9:
        raise InputError(f"{where}: {name} has {len(k)} numbers k; expected 9")
    model = str(getattr(message, "distortion_model", ""))
    return intrinsics_of((int(message.width), int(message.height)), (k[0], k[4], k[2], k[5]), model, tuple(d), where)


def plain_image(message: Any, encodings: tuple[str, ...], where: str) -> NDArray[Any]:
    """Return (rows, columns), of colours (rows, columns, 3), of a sensor_msgs/Image. Raises InputError."""
    rows, columns, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(bytes(message.data), np.uint8)
    encoding = str(message.encoding)
    if encoding not in encodings:
        raise InputError(f"{where}: encoding {encoding[:20]!r}; expected {' or '.join(encodings)}")
    number, channels = _ENCODINGS[encoding]
    size = int(number[1]) * channels
    if len(data) != rows * step or columns * size > step:
        raise InputError(f"{where}: {rows} x {columns} pixels have {len(data)} bytes; expected {rows} rows of {step}")
    lines = np.ascontiguousarray(data.reshape(rows, step)[:, : columns * size])
    values = lines.view((">" if message.is_bigendian else "<") + number).astype(number)
    image = values if channels == 1 else values.reshape(rows, columns, channels)
    return image[..., ::-1] if encoding == "bgr8" else image

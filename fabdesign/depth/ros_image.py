"""Images in messages of ROS: sensor_msgs/Image of ROS 1 as the RealSense SDK writes it, sensor_msgs/msg/Image of ROS 2;
and depth streams of an MCAP: images of 16 bits (or 32FC1, m), or CompressedImage as `compressedDepth`, with the
CameraInfo whose topic is nearest."""

import struct
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.mcap_file import messages_of
from fabdesign.depth.images import depth_image
from fabdesign.depth.intrinsics import Intrinsics, intrinsics_of
from fabdesign.depth.stream import DepthStream
from fabdesign.errors import InputError

IMAGES = tuple(f"sensor_msgs/{part}{name}" for name in ("Image", "CompressedImage") for part in ("msg/", ""))
_INFO = ("sensor_msgs/msg/CameraInfo", "sensor_msgs/CameraInfo")
_MM, _FINE = 1e-3, 1e-4  # m of a depth unit: of ROS, and of what stands in m
_COMPRESSED_DEPTH = 12  # bytes before the PNG of a compressedDepth message
_ENCODINGS = {"16UC1": ("u2", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3)}
COLOUR, _DEPTH, _METRES = ("rgb8", "bgr8"), ("16UC1", "mono16"), ("32FC1",)


def read_mcap_depth(path: Path, topic: str, *, unit: float | None = None) -> DepthStream:
    """Return the depth stream on a topic. Raises InputError for none there, and what `messages_of` does."""
    stamps, images, infos = [], [], dict[str, Any]()
    for name, record, message, schema in messages_of(path, (*IMAGES, *_INFO), "depth images"):
        if schema in _INFO:
            infos.setdefault(name, message)
        elif name == topic:
            stamps.append(cdr_stamp(record.data))
            images.append(message)
    if not images:
        raise InputError(f"{path}: no depth images on {topic}; expected sensor_msgs/msg/Image or CompressedImage")
    where, parts = f"{path}: {topic}", topic.split("/")
    if not infos:
        raise InputError(f"{where}: no CameraInfo; expected one beside the images")

    def shared(name: str) -> int:
        """Return how many parts a topic has in common with the images' one from their beginning."""
        return len([*takewhile(lambda pair: pair[0] == pair[1], zip(name.split("/"), parts, strict=False))])

    nearest = max(infos, key=shared)
    camera = camera_of_info(infos[nearest](), where, f"CameraInfo of {nearest}")
    fine = str(getattr(images[0](), "encoding", "")) in _METRES

    def read(index: int) -> NDArray[np.uint16]:
        message, what = images[index](), f"{where}, image {index}"
        if getattr(message, "encoding", "") not in _METRES:
            return depth_of(message, what)
        steps = np.nan_to_num(plain_image(message, _METRES, what) / _FINE, nan=0.0, posinf=0.0, neginf=0.0)
        return np.asarray(np.where((steps < 0) | (steps >= 2**16), 0, steps).round().astype(np.uint16))

    clock = "global" if any(stamps) else "none"
    return DepthStream(where, camera, _FINE if fine else unit or _MM, np.array(stamps), read, clock)


def has_depth(path: Path, topic: str) -> bool:
    """Return whether a topic holds images rather than clouds. Raises InputError."""
    return any(name == topic for name, *_ in messages_of(path, IMAGES, None))


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
        return plain_image(message, _DEPTH, where)
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

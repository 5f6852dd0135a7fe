"""Depth streams of an MCAP: sensor_msgs/msg/Image of 16 bits (or 32FC1, m), or CompressedImage as `compressedDepth`,
with the CameraInfo whose topic is nearest."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.mcap_file import messages_of
from fabdesign.depth.intrinsics import Intrinsics
from fabdesign.depth.ros_image import METRES, camera_of_info, cdr_stamp, depth_of, plain_image
from fabdesign.depth.stream import DepthStream
from fabdesign.errors import InputError

IMAGES = tuple(f"sensor_msgs/{part}{name}" for name in ("Image", "CompressedImage") for part in ("msg/", ""))
_INFO = ("sensor_msgs/msg/CameraInfo", "sensor_msgs/CameraInfo")
_MM, _FINE = 1e-3, 1e-4  # m of a depth unit: of ROS, and of what stands in m


def read_mcap_depth(path: Path, topic: str, *, unit: float | None = None) -> DepthStream:
    """Return the depth stream on a topic. Raises InputError for none there, and what `messages_of` does."""
    records: list[tuple[float, Any]] = []
    infos: dict[str, Any] = {}
    kind = ""
    for name, record, message, schema in messages_of(path, (*IMAGES, *_INFO), "depth images"):
        if schema in _INFO:
            infos.setdefault(name, message)
        elif name == topic:
            records.append((cdr_stamp(record.data), message))
            kind = kind or str(getattr(message(), "encoding", ""))
    if not records:
        raise InputError(f"{path}: no depth images on {topic}; expected sensor_msgs/msg/Image or CompressedImage")
    where = f"{path}: {topic}"
    camera = _camera(infos, topic, where)
    fine = kind == METRES[0]

    def read(index: int) -> NDArray[np.uint16]:
        return _image(records[index][1](), f"{where}, image {index}")

    stamps = np.array([stamp for stamp, _ in records])
    clock = "global" if stamps.any() else "none"
    return DepthStream(where, camera, _FINE if fine else unit or _MM, stamps, read, clock)


def has_depth(path: Path, topic: str) -> bool:
    """Return whether a topic holds images rather than clouds. Raises InputError."""
    listed = messages_of(path, IMAGES, "", required=False)
    return any(name == topic for name, _, _, _ in listed)


def _camera(infos: dict[str, Any], topic: str, where: str) -> Intrinsics:
    """Return the intrinsics of the CameraInfo that has most of the topic's beginning."""
    if not infos:
        raise InputError(f"{where}: no CameraInfo; expected one beside the images")
    nearest = max(infos, key=lambda name: _shared(name, topic))
    return camera_of_info(infos[nearest](), where, f"CameraInfo of {nearest}")


def _shared(name: str, other: str) -> int:
    """Return how many parts two topics have in common from their beginning."""
    parts = zip(name.split("/"), other.split("/"), strict=False)
    return next((k for k, (a, b) in enumerate(parts) if a != b), 99)


def _image(message: Any, where: str) -> NDArray[np.uint16]:
    if getattr(message, "encoding", "") != METRES[0]:
        return depth_of(message, where)
    steps = np.nan_to_num(plain_image(message, METRES, where) / _FINE, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(np.where((steps < 0) | (steps >= 2**16), 0, steps).round().astype(np.uint16))

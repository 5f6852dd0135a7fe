"""The content of a RealSense recording beside images: intrinsics, poses, serial numbers, units, metadata."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.depth.intrinsics import Intrinsics, intrinsics_of
from fabdesign.depth.ros_image import camera_of_info
from fabdesign.errors import InputError

_SAMPLES = 100  # of an accelerometer: 0.4 to 1.6 s


@dataclass(frozen=True)
class BagStream:
    """The connections of one stream of images by what they hold."""

    device: int
    parts: Mapping[str, Any]  # the rest of a topic -> connection


def messages(reader: Any, connection: Any) -> Iterator[tuple[int, Any]]:
    for connection_, time, raw in reader.messages(connections=[connection]):
        yield time, reader.deserialize(raw, connection_.msgtype)


def serial_of(reader: Any, device: int) -> str:
    """Return a device's serial number."""
    for connection in reader.connections:
        if connection.topic == f"/device_{device}/info":
            for _, message in messages(reader, connection):
                pairs = pairs_of(message)
                if "Serial Number" in pairs:
                    return pairs["Serial Number"]
    return ""


def pairs_of(message: Any) -> dict[str, str]:
    """Return keys and values of a message: a KeyValue, or a text of them."""
    if hasattr(message, "key"):
        return {str(message.key): str(message.value)}
    parts = (part.partition("=") for part in str(message.data).split(";"))
    return {key.strip(): value for key, sign, value in parts if sign}


def camera_of(reader: Any, stream: BagStream, where: str) -> Intrinsics:
    """Return the intrinsics: the SDK's own text of a `.db3`, which names its model, or a CameraInfo."""
    for part in ("camera_info", "info/camera_info", "image/camera_info"):
        for _, message in messages(reader, stream.parts[part]) if part in stream.parts else ():
            if hasattr(message, "height"):
                return camera_of_info(message, where)
            pairs = pairs_of(message)
            try:
                size = int(pairs["width"]), int(pairs["height"])
                matrix = [float(pairs[key]) for key in ("fx", "fy", "ppx", "ppy")]
                coefficients = [float(c) for c in pairs.get("coeffs", "").split(",") if c]
            except (KeyError, ValueError):
                raise InputError(f"{where}: its intrinsics lack width, height, fx, fy, ppx or ppy") from None
            return intrinsics_of(size, matrix, pairs.get("model", "none"), coefficients, where)
    raise InputError(f"{where}: no intrinsics; expected camera_info beside the images")


def depth_to_colour(reader: Any, depth: BagStream, colour: BagStream) -> NDArray[np.float64] | None:
    """Return the turn and shift (3, 4) m from the depth camera's frame to the colour camera's; None where not said."""
    of_depth, of_colour = _placed(reader, depth), _placed(reader, colour)
    if of_depth is None or of_colour is None:
        return None
    return np.asarray((of_colour @ np.linalg.inv(of_depth))[:3])


def gravity_of(reader: Any, depth: BagStream) -> NDArray[np.float64] | None:
    """Return where gravity points in the depth camera's frame, (3,) m/s^2, by its accelerometer in the recording's
    beginning, when nothing moves; None where there is none."""
    accel: dict[str, Any] = {}
    for connection in reader.connections:
        if matched := re.fullmatch(rf"/device_{depth.device}/sensor_\d+/Accel_\d+/(.*)", connection.topic):
            accel[matched[1]] = connection
    samples = islice(messages(reader, accel["imu/data"]), _SAMPLES) if "imu/data" in accel else ()
    felt = [(each.x, each.y, each.z) for each in (message.linear_acceleration for _, message in samples)]
    if not felt or not np.isfinite(felt).all():
        return None
    turn = np.eye(3)
    of_depth, of_accel = _placed(reader, depth), _placed(reader, BagStream(depth.device, accel))
    if of_depth is not None and of_accel is not None:
        turn = of_depth[:3, :3] @ of_accel[:3, :3].T
    return np.asarray(-turn @ np.median(felt, axis=0))


def _placed(reader: Any, stream: BagStream) -> NDArray[np.float64] | None:
    """Return the turn and shift (4, 4) from the frame that the file's streams share to a stream's own."""
    part = next((name for name in stream.parts if name.startswith("tf/")), None)
    for _, message in messages(reader, stream.parts[part]) if part is not None else ():
        placed = np.eye(4)
        if hasattr(message, "rotation"):
            q, t = message.rotation, message.translation
            placed[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
            placed[:3, 3] = t.x, t.y, t.z
        else:
            pairs = {key: [float(x) for x in text.split(",")] for key, text in pairs_of(message).items()}
            placed[:3, :3] = np.reshape(pairs["rotation"], (3, 3)).T  # column by column
            placed[:3, 3] = pairs["translation"]
        return placed
    return None


def metadata_of(reader: Any, stream: BagStream) -> dict[int, dict[str, str]]:
    """Return by log time what stands beside each image."""
    beside: dict[int, dict[str, str]] = {}
    if "image/metadata" in stream.parts:
        for time, message in messages(reader, stream.parts["image/metadata"]):
            beside.setdefault(time, {}).update(pairs_of(message))
    return beside


def depth_unit(reader: Any, stream: BagStream) -> float:
    """Return the option of the sensor that has the unit; 1 mm where there is none."""
    for connection in reader.connections:
        matched = re.fullmatch(rf"/device_{stream.device}/sensor_\d+/option/Depth_Units/value", connection.topic)
        for _, message in messages(reader, connection) if matched else ():
            return float(message.data)
    return 1e-3

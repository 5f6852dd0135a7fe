"""The content of a RealSense recording beside images: intrinsics, poses, serial numbers, units, metadata."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.depth.images import camera_of_info
from fabdesign.depth.intrinsics import Intrinsics, intrinsics_of
from fabdesign.errors import InputError
from fabdesign.formats.toml_file import parsing

_SAMPLES = 100  # of an accelerometer: 0.4 to 1.6 s


@dataclass(frozen=True, eq=False)
class BagStream:
    """The connections of one stream by what they hold."""

    reader: Any
    device: int
    parts: dict[str, Any] = field(default_factory=dict)  # the rest of a topic -> connection

    def messages(self, part: str) -> Iterator[tuple[int, Any]]:
        """Yield log times [ns] and messages of a connection, where it is there."""
        return _messages(self, [self.parts[part]] if part in self.parts else [])

    def camera(self, where: str) -> Intrinsics:
        """Return the intrinsics: the SDK's own text of a `.db3`, which names its model, or a CameraInfo."""
        for part in ("camera_info", "info/camera_info", "image/camera_info"):
            for _, message in self.messages(part):
                if hasattr(message, "height"):
                    return camera_of_info(message, where)
                pairs = _pairs(message)
                with parsing(where, "its intrinsics lack width, height, fx, fy, ppx or ppy"):
                    size = int(pairs["width"]), int(pairs["height"])
                    matrix = [float(pairs[key]) for key in ("fx", "fy", "ppx", "ppy")]
                    coefficients = [float(c) for c in pairs.get("coeffs", "").split(",") if c]
                return intrinsics_of(size, matrix, pairs.get("model", "none"), coefficients, where)
        raise InputError(f"{where}: no intrinsics; expected camera_info beside the images")

    def placed(self) -> NDArray[np.float64] | None:
        """Return the turn and shift (4, 4) from the frame that the file's streams share to the stream's."""
        for _, message in self.messages(next((name for name in self.parts if name.startswith("tf/")), "")):
            placed = np.eye(4)
            if hasattr(message, "rotation"):
                q, t = message.rotation, message.translation
                placed[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
                placed[:3, 3] = t.x, t.y, t.z
            else:
                pairs = {key: [float(x) for x in text.split(",")] for key, text in _pairs(message).items()}
                placed[:3, :3] = np.reshape(pairs["rotation"], (3, 3)).T  # column by column
                placed[:3, 3] = pairs["translation"]
            return placed
        return None

    def metadata(self) -> dict[int, dict[str, str]]:
        """Return by log time what stands beside each image."""
        beside: dict[int, dict[str, str]] = {}
        for time, message in self.messages("image/metadata"):
            beside.setdefault(time, {}).update(_pairs(message))
        return beside


def _messages(stream: BagStream, connections: Iterable[Any]) -> Iterator[tuple[int, Any]]:
    for each in connections:
        for _, time, raw in stream.reader.messages(connections=[each]):
            yield time, stream.reader.deserialize(raw, each.msgtype)


def _of_device(stream: BagStream, topic: str) -> dict[str, Any]:
    """Return the connections of a stream's device whose topics match a pattern, by the group in it."""
    pattern = re.compile(rf"/device_{stream.device}/{topic}")
    matches = ((pattern.fullmatch(each.topic), each) for each in stream.reader.connections)
    return {matched[1]: each for matched, each in matches if matched}


def _pairs(message: Any) -> dict[str, str]:
    """Return keys and values of a message: a KeyValue, or a text of them."""
    if hasattr(message, "key"):
        return {str(message.key): str(message.value)}
    parts = (part.partition("=") for part in str(message.data).split(";"))
    return {key.strip(): value for key, sign, value in parts if sign}


def serial_of(stream: BagStream) -> str:
    """Return the serial number of a stream's device."""
    pairs = (_pairs(message) for _, message in _messages(stream, _of_device(stream, "(info)").values()))
    return next((each["Serial Number"] for each in pairs if "Serial Number" in each), "")


def depth_unit(stream: BagStream) -> float:
    """Return the option of the sensor that has the unit; 1 mm where there is none."""
    options = _of_device(stream, r"(sensor_\d+)/option/Depth_Units/value").values()
    return next((float(message.data) for _, message in _messages(stream, options)), 1e-3)


def depth_to_colour(depth: BagStream, colour: BagStream) -> NDArray[np.float64] | None:
    """Return the turn and shift (3, 4) m from the depth camera's frame to the colour camera's; None where not said."""
    of_depth, of_colour = depth.placed(), colour.placed()
    if of_depth is None or of_colour is None:
        return None
    return np.asarray((of_colour @ np.linalg.inv(of_depth))[:3])


def gravity_of(depth: BagStream) -> NDArray[np.float64] | None:
    """Return where gravity points in the depth camera's frame, (3,) m/s^2, by its accelerometer in the recording's
    beginning, when nothing moves; None where there is none."""
    accel = BagStream(depth.reader, depth.device, _of_device(depth, r"sensor_\d+/Accel_\d+/(.*)"))
    samples = (message.linear_acceleration for _, message in islice(accel.messages("imu/data"), _SAMPLES))
    felt = [(each.x, each.y, each.z) for each in samples]
    if not felt or not np.isfinite(felt).all():
        return None
    turn, of_depth, of_accel = np.eye(3), depth.placed(), accel.placed()
    if of_depth is not None and of_accel is not None:
        turn = of_depth[:3, :3] @ of_accel[:3, :3].T
    return np.asarray(-turn @ np.median(felt, axis=0))

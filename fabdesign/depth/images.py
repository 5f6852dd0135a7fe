"""Depth and colour images: from PNG and TIFF bytes, whose size is checked before a pixel is unpacked, and from messages
of ROS: sensor_msgs/Image of ROS 1 as the RealSense SDK writes it, sensor_msgs/msg/Image of ROS 2. And streams of them:
a folder of 16-bit images with a JSON of intrinsics (Open3D's, Azure Kinect's, or the RealSense SDK's names), an npz
stack, or an MCAP: images of 16 bits (or 32FC1, m), or CompressedImage as `compressedDepth`, with the CameraInfo whose
topic is nearest."""

import io
import json
import re
import struct
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.mcap_file import messages_of
from fabdesign.depth.intrinsics import MOST_PIXELS, Intrinsics, intrinsics_of, intrinsics_of_json
from fabdesign.depth.stream import MOST_FRAMES, DepthStream
from fabdesign.errors import InputError
from fabdesign.formats.npz_file import open_npz
from fabdesign.formats.toml_file import parsing, read_bytes, read_text

_DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
_COLOUR_MODES = ("RGB", "L", "RGBA", "P")
_ENDINGS = (".png", ".tif", ".tiff")
_NUMBER = re.compile(r"\d+")
Triple = tuple[float, float, float]
_MM = 1e-3  # m of a depth unit where nothing else is said: Open3D, Azure Kinect, ROS
IMAGES = tuple(f"sensor_msgs/{part}{name}" for name in ("Image", "CompressedImage") for part in ("msg/", ""))
_INFO = ("sensor_msgs/msg/CameraInfo", "sensor_msgs/CameraInfo")
_FINE = 1e-4  # m of a depth unit, of what stands in m
_COMPRESSED_DEPTH = 12  # bytes before the PNG of a compressedDepth message
_ENCODINGS = {"16UC1": ("u2", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3)}
COLOUR, _DEPTH, _METRES = ("rgb8", "bgr8"), ("16UC1", "mono16"), ("32FC1",)


def depth_image(content: bytes, where: str) -> NDArray[np.uint16]:
    """Return (rows, columns) of a 16-bit PNG or TIFF. Raises InputError."""
    values = _pixels(content, where, _DEPTH_MODES, "16 bits, one channel (is it colour?)", None)
    if values.dtype != np.uint16 and values.size and not 0 <= values.min() <= values.max() < 2**16:
        raise InputError(f"{where}: depths from {values.min()} to {values.max()}; expected 16 bits")
    return np.asarray(values.astype(np.uint16))


def colour_image(content: bytes, where: str) -> NDArray[np.uint8]:
    """Return (rows, columns, 3) of a PNG, TIFF or JPEG with 8 bits a channel. Raises InputError."""
    return _pixels(content, where, _COLOUR_MODES, "red, green and blue of 8 bits", "RGB")


def _pixels(content: bytes, where: str, modes: tuple[str, ...], expected: str, mode: str | None) -> NDArray[Any]:
    """Return an image's pixels, converted to a mode of PIL. Raises InputError."""
    from PIL import Image

    with parsing(where, "cannot be read as an image ({})", "a whole PNG or TIFF"):
        opened: Any = Image.open(io.BytesIO(content), formats=("PNG", "TIFF", "JPEG"))
        with opened as image:
            width, height = image.size
            if width * height > MOST_PIXELS:
                most = f"{MOST_PIXELS / 1e6:.1f} million"
                raise InputError(f"{where}: {width} x {height} pixels; expected at most {most}")
            if getattr(image, "n_frames", 1) != 1:
                raise InputError(f"{where}: holds {image.n_frames} images; expected one")
            if image.mode not in modes:
                raise InputError(f"{where}: an image of kind {image.mode}; expected {expected}")
            return np.asarray(image if mode is None else image.convert(mode))


def of_colour(image: NDArray[np.uint8], colour: tuple[Triple, Triple]) -> NDArray[np.bool_]:
    """Return (rows, columns) whether a pixel (.., 3) of red, green and blue lies in the range."""
    rgb = image.astype(np.float64) / 255.0
    value, least = rgb.max(axis=-1), rgb.min(axis=-1)
    spread = value - least
    safe = np.where(spread > 0, spread, 1.0)
    r, g, b = np.moveaxis(rgb, -1, 0)
    hue = np.select([value == r, value == g], [((g - b) / safe) % 6, (b - r) / safe + 2], (r - g) / safe + 4) * 60
    saturation = spread / np.where(value > 0, value, 1.0)
    (h0, s0, v0), (h1, s1, v1) = colour
    in_hue = ((hue >= h0) & (hue <= h1)) | ((hue + 360 >= h0) & (hue + 360 <= h1))
    return np.asarray(in_hue & (saturation >= s0) & (saturation <= s1) & (value >= v0) & (value <= v1))


def read_image_folder(
    folder: Path, intrinsics: Path, *, unit: float | None = None, stamps: Path | None = None
) -> DepthStream:
    """Return the stream of a folder of depth images, in the order of the numbers in their names.

    unit: m of a depth step, 1 mm where absent. stamps: a text with a number [s] for each image. Colour images of the
    same numbers lie in a folder `color` or `colour` beside it. Raises InputError.
    """
    files = _numbered(folder, _ENDINGS)
    if not files:
        raise InputError(f"{folder}: no images; expected 16-bit PNG or TIFF with numbers in their names")
    beside = next((folder.parent / name for name in ("color", "colour") if (folder.parent / name).is_dir()), None)
    colours = [] if beside is None else _numbered(beside, (*_ENDINGS, ".jpg", ".jpeg"))

    def read(index: int) -> NDArray[np.uint16]:
        return depth_image(read_bytes(files[index], "a depth image"), str(files[index]))

    def colour(index: int) -> NDArray[np.uint8]:
        return colour_image(read_bytes(colours[index], "an image"), str(colours[index]))

    camera = read_intrinsics(intrinsics, read(0).shape[::-1])
    times = np.arange(len(files), dtype=np.float64) if stamps is None else _stamps(stamps, len(files))
    clock, coloured = "none" if stamps is None else "device", len(colours) == len(files)
    last = np.array([int(_NUMBER.findall(file.stem)[-1][:18]) for file in files], dtype=np.int64)
    numbers = last if (np.diff(last) > 0).all() else None  # one that is missing among them was lost
    shown = (colour, camera) if coloured else (None, None)
    return DepthStream(str(folder), camera, unit or _MM, times, read, clock, numbers, *shown)


def read_intrinsics(path: Path, size: tuple[int, ...]) -> Intrinsics:
    """Return the intrinsics of a JSON for images of a size (width, height). Raises InputError."""
    text = read_text(path, "a JSON of intrinsics", largest=1_000_000)
    with parsing(path, "is no JSON", "intrinsics"):
        content = json.loads(text)
    return intrinsics_of_json(content, size, str(path))


def read_depth_npz(path: Path, *, unit: float | None = None, intrinsics: Path | None = None) -> DepthStream:
    """Return the stream of an npz: `depth` (n, rows, columns) of 16 bits, and, where they are there, `stamps` (n,) s,
    `unit` m, `intrinsics` (3, 3). Raises InputError."""
    with open_npz(path, "depth (n, rows, columns), and stamps, unit, intrinsics") as arrays:
        shape = arrays.shape("depth")
        if len(shape) != 3 or not all(shape):
            raise InputError(f"{path}: depth is {shape}; expected (n, rows, columns)")
        depth = arrays.get("depth", np.uint16)
        others = {name: arrays.get(name) for name in ("stamps", "unit", "intrinsics") if name in arrays}
    if depth.dtype != np.uint16:
        raise InputError(f"{path}: depth is {depth.dtype}; expected uint16")
    times = others.get("stamps", np.arange(shape[0], dtype=np.float64))
    if times.shape != (shape[0],):
        raise InputError(f"{path}: stamps are {times.shape}; expected ({shape[0]},), one an image")
    size, matrix = (shape[2], shape[1]), others.get("intrinsics")
    if intrinsics is not None:
        camera = read_intrinsics(intrinsics, size)
    elif matrix is None or matrix.shape != (3, 3) or matrix.dtype.kind not in "fiu":
        raise InputError(f"{path}: no intrinsics; expected an array intrinsics (3, 3), or a JSON of the sensor")
    else:
        camera = intrinsics_of(size, (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]), "none", (), str(path))
    default = float(others["unit"]) if "unit" in others and others["unit"].size == 1 else _MM
    clock = "device" if "stamps" in others else "none"
    return DepthStream(str(path), camera, unit or default, times.astype(np.float64), depth.__getitem__, clock)


def _numbered(folder: Path, endings: tuple[str, ...]) -> list[Path]:
    """Return the images of a folder by the numbers in their names, then by name."""
    try:
        files = [file for file in folder.iterdir() if file.suffix.lower() in endings and _NUMBER.search(file.stem)]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read as a folder of images ({error.strerror})") from None
    if len(files) > MOST_FRAMES:
        raise InputError(f"{folder}: {len(files)} images; expected at most {MOST_FRAMES}")
    return sorted(files, key=lambda file: ([int(n[:18]) for n in _NUMBER.findall(file.stem)], file.name))


def _stamps(path: Path, count: int) -> NDArray[np.float64]:
    """Return the first number of each line. Raises InputError."""
    lines = read_text(path, "a text of stamps", largest=10_000_000).splitlines()
    words = [re.split(r"[,;\s]+", line.strip()) for line in lines if line.strip() and not line.startswith("#")]
    with parsing(path, "a line does not begin with a number", "a stamp [s] a line"):
        values = np.array([float(row[0]) for row in words])
    if len(values) != count:
        raise InputError(f"{path}: {len(values)} stamps; expected {count}, one an image")
    return values


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

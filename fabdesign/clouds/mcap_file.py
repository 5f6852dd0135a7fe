"""Clouds of an MCAP, a recording of ROS 2: messages sensor_msgs/msg/PointCloud2, through the packages mcap and
mcap_ros2 (the extra `ros`).

Format: mcap.dev/spec; the message: docs.ros2.org, sensor_msgs/msg/PointCloud2. It holds `height` rows of `width`
points, a row every `row_step` bytes and a point every `point_step`; `fields` say at which byte of a point a value
begins, and its type.
"""

import io
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.formats.toml_file import parsing, read_bytes
from fabdesign.nouns.array import Array

LARGEST = 600_000_000  # bytes of the file, and of its points: some hundred clouds of four sensors
_SCHEMAS = ("sensor_msgs/msg/PointCloud2", "sensor_msgs/PointCloud2")
_CHUNK_SIZE = 25  # bytes into a chunk's record, where its unpacked size stands: as its index may not say
_ENCAPSULATION = 4  # bytes before a message in CDR; a cloud's stamp follows: seconds and nanoseconds
_TYPES = {7: "f4", 8: "f8"}  # of a field, that coordinates may have
_UNREADABLE = "cannot be read as an MCAP of ROS 2 ({})"


class McapTopic(NamedTuple):
    """The clouds on a topic, in the order in which they were logged."""

    clouds: tuple[Array, ...]  # (n, 3) m, as ROS has them
    stamps: NDArray[np.int64]  # ns


def read_mcap(path: Path) -> Mapping[str, McapTopic]:
    """Return the clouds by topic. One without a stamp has the instant at which it was logged, less the delay of the
    topic's others.

    Raises InputError for a file that is not there, damaged, cut short, too large, or without such clouds, and where
    the packages are not there.
    """
    clouds_of: dict[str, list[Array]] = {}
    stamps_of: dict[str, list[tuple[int, int]]] = {}
    frames: dict[str, str] = {}  # by topic, in which its points stand
    size = 0
    for topic, record, message, _ in messages_of(path, _SCHEMAS, "clouds"):
        content = message()
        cloud = points_of(content, f"{path}: {topic}")
        frame = getattr(getattr(content, "header", None), "frame_id", "")
        if frames.setdefault(topic, frame) != frame:
            raise InputError(
                f"{path}: {topic}: clouds of the frames {frames[topic][:40]!r} and {frame[:40]!r}; expected one sensor"
            )
        size += cloud.nbytes
        if size > LARGEST:
            raise InputError(f"{path}: its clouds have over {LARGEST / 1e6:.0f} MB; expected fewer or smaller ones")
        clouds_of.setdefault(topic, []).append(cloud)
        seconds, rest = struct.unpack_from("<iI" if record.data[1] & 1 else ">iI", record.data, _ENCAPSULATION)
        stamps_of.setdefault(topic, []).append((seconds * 10**9 + rest, record.log_time))
    topics = {}
    for topic, listed in stamps_of.items():
        stamp, logged = np.array(listed, dtype=np.int64).T
        late, known = logged - stamp, stamp != 0
        stamps = np.where(known, stamp, logged - (int(np.median(late[known])) if known.any() else 0))
        topics[topic] = McapTopic(tuple(clouds_of[topic]), stamps)
    return topics


def messages_of(
    path: Path, schemas: Sequence[str], what: str | None
) -> Iterator[tuple[str, Any, Callable[[], Any], str]]:
    """Yield topic and record of every message of these schemas, what decodes it, and its schema's name.

    what: is said to be expected where there is none; None: none is. Raises InputError.
    """
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InputError(f"{path}: an MCAP needs the package {error.name}; pip install fabdesign[ros]") from None
    content = read_bytes(path, "an MCAP", largest=LARGEST)
    count, held = 0, "nothing"
    with parsing(path, _UNREADABLE):
        reader = make_reader(io.BytesIO(content), validate_crcs=True)
        summary = reader.get_summary()
        if summary is None:
            raise InputError(f"{path}: has no summary; expected a whole MCAP (`mcap recover` mends one cut short)")
        kinds = {key: schema.name for key, schema in summary.schemas.items()}
        named = {f"{c.topic} ({kinds.get(c.schema_id, 'no schema')})" for c in summary.channels.values()}
        held = ", ".join(sorted(named)[:5]) or held
        topics = [c.topic for c in summary.channels.values() if kinds.get(c.schema_id) in schemas]
        _require_bounded(content, summary, topics, path)
        factory = DecoderFactory()
        for schema, channel, record in reader.iter_messages(topics=topics) if topics else ():
            with redirect_stderr(io.StringIO()):  # it prints what it meets in a schema
                decode = factory.decoder_for(channel.message_encoding, schema)
            if decode is None or len(record.data) < _ENCAPSULATION + 8:
                raise ValueError(channel.message_encoding)
            count += 1

            def message(decode: Callable[[bytes], Any] = decode, data: bytes = record.data) -> Any:
                with parsing(path, _UNREADABLE):
                    return decode(data)

            yield channel.topic, record, message, kinds[channel.schema_id]
    if not count and what is not None:
        raise InputError(f"{path}: holds {held}; expected {what}, {schemas[0]}")


def _require_bounded(content: bytes, summary: Any, topics: list[str], path: Path) -> None:
    """Raise InputError where the chunks of these topics unpack to too much, before any is unpacked."""
    numbers = {number for number, channel in summary.channels.items() if channel.topic in topics}
    size = sum(
        max(index.uncompressed_size, *struct.unpack_from("<Q", content, index.chunk_start_offset + _CHUNK_SIZE))
        for index in summary.chunk_indexes
        if not index.message_index_offsets or numbers & index.message_index_offsets.keys()
    )
    if size > LARGEST:
        raise InputError(f"{path}: its clouds unpack to {size / 1e6:.0f} MB; expected at most {LARGEST / 1e6:.0f} MB")


def points_of(message: Any, what: str) -> Array:
    """Return (n, 3) of a PointCloud2. Raises InputError, `what` it is of in its message."""
    sizes = [getattr(message, name, -1) for name in ("height", "width", "point_step", "row_step")]
    listed: Any = getattr(message, "fields", None)
    content: Any = getattr(message, "data", None)
    of_kind = isinstance(listed, list) and isinstance(content, bytes) and hasattr(message, "is_bigendian")
    if not of_kind or not all(map(_is_size, sizes)):
        raise InputError(f"{what}: is no cloud as {_SCHEMAS[0]} has it; expected height, width, steps and bytes")
    rows, columns, point_step, row_step = sizes
    if not rows * columns:
        return np.zeros((0, 3))
    names = [getattr(field, "name", None) for field in listed]
    if not {"x", "y", "z"} <= {*names}:
        shown = ", ".join(map(str, dict.fromkeys(names))) or "no fields"
        raise InputError(f"{what}: a cloud has {shown}; expected x, y and z")
    fields = [listed[names.index(name)] for name in "xyz"]
    if any(names.count(name) > 1 for name in "xyz") or any(getattr(f, "count", -1) not in (0, 1) for f in fields):
        raise InputError(f"{what}: a cloud has x, y or z more than once; expected one number each")
    offsets, kinds = ([getattr(field, key, -1) for field in fields] for key in ("offset", "datatype"))
    if not all(map(_is_size, offsets)) or not all(kind in tuple(_TYPES) for kind in kinds):
        raise InputError(f"{what}: coordinates of type {kinds[0]}; expected FLOAT32 (7) or FLOAT64 (8)")
    formats = [np.dtype((">" if message.is_bigendian else "<") + _TYPES[kind]) for kind in kinds]
    data = np.frombuffer(content, np.uint8)
    within = columns * point_step <= row_step
    within &= max(at + kind.itemsize for at, kind in zip(offsets, formats, strict=True)) <= point_step
    if not within or len(data) != rows * row_step:
        raise InputError(
            f"{what}: a cloud of {rows} x {columns} points has {len(data)} bytes; expected {rows} rows of {row_step}"
        )
    kind = np.dtype({"names": [*"xyz"], "formats": formats, "offsets": offsets, "itemsize": point_step})
    packed = data.reshape(rows, row_step)[:, : columns * point_step]
    points = np.ascontiguousarray(packed).reshape(-1).view(kind)
    return np.stack([points[name].astype(np.float64) for name in "xyz"], axis=-1)


def _is_size(value: Any) -> bool:
    return isinstance(value, int) and value >= 0

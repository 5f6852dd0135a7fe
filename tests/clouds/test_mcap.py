"""Clouds of ROS 2 recordings (MCAP): what was written by the format's own writer reads back."""

import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fabdesign.clouds.cloud_file import read_geometry
from fabdesign.clouds.mcap_file import points_of, read_mcap
from fabdesign.clouds.recording import Recording, Sensor, read_recording, write_recording
from fabdesign.errors import InputError
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from studies.check.files import inspect

pytest.importorskip("mcap_ros2", reason="the extra ros is not installed")

SCHEMA = """std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count
"""


def message(points: np.ndarray, *, kind: str = "<f4", pad: int = 4) -> dict:
    """A PointCloud2 of (rows, columns, 3) m, with a colour between the coordinates and `pad` bytes after each row."""
    size = np.dtype(kind).itemsize
    packed = np.zeros(points.shape[:2], np.dtype([("x", kind), ("y", kind), ("rgb", "<u4"), ("z", kind)]))
    for k, name in enumerate("xyz"):
        packed[name] = points[..., k]
    rows = [row.tobytes() + b"\xff" * pad for row in packed]
    number = {4: 7, 8: 8}[size]
    offsets = {"x": 0, "y": size, "rgb": 2 * size, "z": 2 * size + 4}
    fields = [
        {"name": name, "offset": at, "datatype": 6 if name == "rgb" else number, "count": 1}
        for name, at in offsets.items()
    ]
    return {
        "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "camera"}, "height": len(rows),
        "width": points.shape[1], "fields": fields, "is_bigendian": kind.startswith(">"),
        "point_step": packed.dtype.itemsize, "row_step": len(rows[0]), "data": b"".join(rows), "is_dense": False,
    }  # fmt: skip


def write(path: Path, clouds: list[tuple[str, dict]], *, name: str = "sensor_msgs/msg/PointCloud2") -> Path:
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(name, SCHEMA)
        for k, (topic, content) in enumerate(clouds):
            writer.write_message(topic, schema, content, log_time=k)
        writer.finish()
    return path


POINTS = np.random.default_rng(2).uniform(-0.1, 0.3, (3, 5, 4, 3))  # three clouds of 5 rows


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8"])
def test_clouds_read_back(kind: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [("/left", message(cloud, kind=kind)) for cloud in POINTS])
    ((clouds, _),) = read_mcap(path).values()
    np.testing.assert_allclose(clouds, POINTS.reshape(3, 20, 3), atol=1e-7)
    target = read_geometry(path, frame=1)
    assert (target.frame, target.unit) == (1, "m")
    np.testing.assert_array_equal(target.points, clouds[1])
    write(path, [(topic, message(POINTS[0])) for topic in ("/left", "/right")])
    with pytest.raises(InputError, match=r"has clouds on /left, /right; expected one topic"):
        read_geometry(path)


def test_what_is_no_cloud_is_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [("/left", message(POINTS[0]))])
    mcap = path.read_bytes()
    assert inspect(path).problems == ()
    for content in (b"", mcap[:-40], mcap[: len(mcap) // 2], mcap.replace(b"MSG:", b"MSG!"), b"\x89MCAP0\r\n" * 9):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"a\.mcap: .*an? (whole )?MCAP"):
            read_mcap(path)
    write(path, [("/left", message(POINTS[0]))], name="sensor_msgs/msg/Image")
    with pytest.raises(InputError, match=r"holds /left \(sensor_msgs/msg/Image\); expected clouds"):
        read_mcap(path)
    for wrong, problem in (
        ({"data": b"123"}, "has 3 bytes; expected 5 rows"),
        ({"point_step": 8}, r"has \d+ bytes; expected 5 rows"),
        ({"fields": []}, "has no fields; expected x, y and z"),
    ):
        content = message(POINTS[0]) | wrong
        content["fields"] = [SimpleNamespace(**field) for field in content["fields"]]
        with pytest.raises(InputError, match=problem):
            points_of(SimpleNamespace(**content), "a")


def test_clouds_of_two_sensors_on_one_topic_are_refused(tmp_path: Path) -> None:
    other = message(POINTS[1])
    other["header"] = {**other["header"], "frame_id": "second"}
    with pytest.raises(InputError, match="clouds of the frames 'camera' and 'second'; expected one sensor"):
        read_mcap(write(tmp_path / "a.mcap", [("/left", message(POINTS[0])), ("/left", other)]))


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """Two cameras, three frames, as a folder of PLY."""
    poses = {"left": np.eye(4), "right": np.diag([1.0, -1.0, -1.0, 1.0])}
    sensors = [Sensor(name, pose) for name, pose in poses.items()]
    clouds = [{s.name: cloud.reshape(-1, 3) + [0, 0, 1 + k] for k, s in enumerate(sensors)} for cloud in POINTS]
    folder, times = tmp_path / "plain", np.array([0.1, 0.2, 0.3])
    design = build("cross", muscles=2)
    write_recording(folder, design, constant_program([1e5, 0.0], 0.3), times, sensors, clouds, clouds[0])
    return read_recording(folder)


def test_a_recording_lies_in_an_mcap(recording: Recording, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(recording.folder, other, ignore=shutil.ignore_patterns("frames"))
    every = [(sensor, k) for k in range(len(recording.times)) for sensor in recording.sensors]
    write(other / "r.mcap", [(f"/{s.name}/points", message(recording.frame(s, k)[None])) for s, k in every])
    file = other / "recording.toml"
    text = re.sub(r'(name = "(left|right)"\n)', r'\1topic = "/\2/points"\n', file.read_text())
    file.write_text(text.replace("times =", 'mcap = "r.mcap"\ntimes =', 1))
    mcap_recording = read_recording(other)
    for sensor, k in every:
        same = next(one for one in mcap_recording.sensors if one.name == sensor.name)
        np.testing.assert_allclose(mcap_recording.frame(same, k), recording.frame(sensor, k), atol=1e-6)
    assert inspect(file).problems == ()
    rated = re.sub(r"times = \[.*?\]", "frame_rate = 10.0", file.read_text(), flags=re.DOTALL)
    file.write_text(rated)
    np.testing.assert_allclose(read_recording(other).times, recording.times)
    file.write_text(rated.replace("/right/points", "/nowhere"))
    (line, *_) = inspect(file).problems
    assert "no clouds on /nowhere; expected one of /left/points, /right/points" in line
    file.write_text(text)
    with pytest.raises(InputError, match='expected mcap = "FILE", where a sensor has a topic'):
        read_recording(other)


def test_a_coordinate_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    sound = message(POINTS[0])
    x = sound["fields"][0]
    for fields in ([*sound["fields"], x | {"offset": 4}], [x | {"count": 3}, *sound["fields"][1:]]):
        path = write(tmp_path / "a.mcap", [("/left", sound | {"fields": fields})])
        with pytest.raises(InputError, match="x, y or z more than once"):
            read_mcap(path)


def test_chunks_that_unpack_to_gigabytes_are_refused_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.mcap", [("/left", message(POINTS[0]))])
    content = bytearray(path.read_bytes())
    at = content.index(b"zstd") - 16  # the length of the name, a checksum and the unpacked size stand before it
    content[at : at + 8] = (2_000_000_000).to_bytes(8, "little")  # the index still says the sound one
    path.write_bytes(content)
    monkeypatch.setattr("mcap.reader.breakup_chunk", lambda *_, **__: pytest.fail("it was unpacked"))
    with pytest.raises(InputError, match="clouds unpack to 2000 MB; expected at most 600 MB"):
        read_mcap(path)

"""Depth images of laboratories: RealSense recordings, folders, npz stacks, MCAP; deprojection and hostile files."""

import io
import json
import re
import shutil
import sqlite3
import struct
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fabdesign.depth.images import depth_image, of_colour, read_depth_npz, read_image_folder, read_mcap_depth
from fabdesign.depth.intrinsics import Intrinsics, intrinsics_of, intrinsics_of_json
from fabdesign.depth.realsense import read_realsense
from fabdesign.errors import InputError
from tests.conftest import ROOT

SAMPLES = ROOT / "tests" / "data" / "realsense"
COEFFICIENTS = (0.1, -0.05, 0.001, 0.002, 0.01)
# slopes of the pixel (100, 400) by the SDK's rs2_deproject_pixel_to_point (2.56.5 and 2.59.1), focal 425, 424, centre
# 420, 241; of the last two, whose deprojection is no inverse of its projection there, what it projects to that pixel
BY_THE_SDK = {
    "none": (-0.75294117, 0.37500000),
    "brown_conrady": (-0.72214374, 0.35841925),
    "inverse_brown_conrady": (-0.72227972, 0.35848630),
    "kannala_brandt4": (-0.93158918, 0.46397507),
}


@pytest.mark.parametrize("model", BY_THE_SDK)
def test_pixels_are_deprojected_as_the_sdk_does(model: str) -> None:
    camera = intrinsics_of((848, 480), (425.0, 424.0, 420.0, 241.0), model, COEFFICIENTS, "here")
    np.testing.assert_allclose(camera.slopes_of(np.array([100.0, 400.0])), BY_THE_SDK[model], atol=1e-6)
    assert camera.slopes.shape == (480, 848, 2)


@pytest.mark.parametrize("model", [*BY_THE_SDK, "modified_brown_conrady", "ftheta"])
def test_deprojection_against_the_sdk_itself(model: str) -> None:
    rs = pytest.importorskip("pyrealsense2", reason="the SDK's wheel is not installed")
    theirs = rs.intrinsics()
    theirs.width, theirs.height, theirs.fx, theirs.fy, theirs.ppx, theirs.ppy = 848, 480, 425.0, 424.0, 420.0, 241.0
    theirs.model, theirs.coeffs = getattr(rs.distortion, model), list(COEFFICIENTS)
    ours = Intrinsics(848, 480, (425.0, 424.0), (420.0, 241.0), model, COEFFICIENTS)  # type: ignore[arg-type]
    for pixel in np.random.default_rng(0).uniform([0, 0], [848, 480], (100, 2)):
        slope = ours.slopes_of(pixel)
        np.testing.assert_allclose(rs.rs2_project_point_to_pixel(theirs, [*slope, 1.0]), pixel, atol=1e-3)
        if model in BY_THE_SDK:
            np.testing.assert_allclose(rs.rs2_deproject_pixel_to_point(theirs, [*pixel], 1.0)[:2], slope, atol=1e-6)


@pytest.mark.parametrize("model", ["modified_brown_conrady", "ftheta", "equidistant", "rational_polynomial"])
def test_projection_and_deprojection_are_inverse(model: str) -> None:
    camera = intrinsics_of((640, 576), (504.0, 503.0, 320.0, 330.0), model, COEFFICIENTS, "here")
    pixels = np.random.default_rng(1).uniform([0, 0], [640, 576], (50, 2))
    np.testing.assert_allclose(camera.pixels_of(camera.slopes_of(pixels)), pixels, atol=1e-5)


@pytest.mark.parametrize("ending", ["bag", "db3"])
def test_a_recording_of_the_sdk_is_read(ending: str) -> None:
    """Written by scripts/write_realsense.py: 4 images, one lost between the second and the third."""
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    stream = read_realsense(SAMPLES / f"sample.{ending}")
    np.testing.assert_allclose(stream.stamps - 100, np.array([0, 1, 3, 4]) / 30, atol=1e-6)
    assert stream.numbers is not None
    assert stream.numbers.tolist() == [7, 8, 10, 11]
    assert (stream.serial, stream.clock, stream.camera.model) == ("123456789012", "device", "brown_conrady")
    assert stream.unit == pytest.approx(1e-3)
    np.testing.assert_allclose(stream.camera.coefficients, COEFFICIENTS, atol=1e-8)
    assert [int(stream.depth(k)[1, 1]) for k in (3, 0, 2, 1)] == [103, 100, 102, 101]  # in any order
    cloud = stream.cloud(0)
    assert len(cloud) == 24 * 32 - 1  # one pixel has no depth
    assert stream.colour is not None
    assert stream.colour(2)[0, 1].tolist() == [1, 2, 3]
    assert stream.depth_to_colour is not None
    np.testing.assert_allclose(stream.depth_to_colour[:, 3], [-0.015, 0.002, 0.003], atol=1e-6)
    np.testing.assert_allclose(
        stream.depth_to_colour[:2, :2], [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]], atol=1e-6
    )
    assert read_realsense(SAMPLES / f"sample.{ending}", serial="123456789012").serial == "123456789012"
    with pytest.raises(InputError, match="depth streams of 123456789012; expected one of the camera '7'"):
        read_realsense(SAMPLES / f"sample.{ending}", serial="7")


@pytest.mark.parametrize("ending", ["bag", "db3"])
def test_the_accelerometer_says_where_gravity_points(ending: str) -> None:
    """Written by scripts/write_realsense.py; a D435i at rest feels 9.8 m/s^2 upwards, -y of its axes."""
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    gravity = read_realsense(SAMPLES / f"accel.{ending}").gravity
    np.testing.assert_allclose(gravity, [-0.5, 9.7, -1.2], atol=0.02)
    assert read_realsense(SAMPLES / f"sample.{ending}").gravity is None


def test_what_the_sdk_writes_now_is_read(tmp_path: Path) -> None:
    pytest.importorskip("pyrealsense2", reason="the SDK's wheel is not installed")
    pytest.importorskip("rosbags")
    depth = np.random.default_rng(0).integers(1, 900, (3, 24, 32), dtype=np.uint16)
    optics = {"pinhole": [30, 31, 15, 11], "model": "none", "coefficients": np.zeros(5)}
    np.savez(tmp_path / "a.npz", depth=depth, stamps=[5.0, 5.033, 5.066], numbers=[1, 2, 3], unit=1e-4, **optics)
    out = tmp_path / ("a.bag" if version("pyrealsense2").startswith("2.56") else "a.db3")
    subprocess.run([sys.executable, ROOT / "scripts/write_realsense.py", tmp_path / "a.npz", out], check=True)
    stream = read_realsense(out)
    assert stream.unit == pytest.approx(1e-4)
    assert all(np.array_equal(stream.depth(k), depth[k]) for k in range(3))


@pytest.mark.parametrize("ending", ["bag", "db3"])
def test_hostile_recordings_are_one_line(ending: str, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    recording = (SAMPLES / f"sample.{ending}").read_bytes()
    path = tmp_path / f"a.{ending}"
    rng = np.random.default_rng(0)
    spoilt = [b"", recording[:100], recording[: len(recording) // 2], b"#ROSBAG V2.0\n" + bytes(200)]
    for _ in range(12):
        content = bytearray(recording)
        for at in rng.integers(0, len(content), 12):
            content[at] = int(rng.integers(256))
        spoilt.append(bytes(content))
    for content in spoilt:
        path.write_bytes(content)
        try:
            stream = read_realsense(path)
            for k in range(min(len(stream.stamps), 4)):
                stream.depth(k)
        except InputError as error:
            assert "\n" not in str(error), str(error)
    with pytest.raises(InputError, match="no such file"):
        read_realsense(tmp_path / "none.bag")


def test_a_bag_whose_chunk_unpacks_to_gigabytes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    monkeypatch.setattr("fabdesign.depth.realsense.LARGEST_CHUNK", 500)
    with pytest.raises(InputError, match=r"chunk (unpacks to|of)"):
        read_realsense(SAMPLES / "sample.bag").depth(0)


def test_a_bag_that_was_not_ended_is_named(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    content = bytearray((SAMPLES / "sample.bag").read_bytes())
    at = content.index(b"index_pos=") + 10
    content[at : at + 8] = bytes(8)
    (tmp_path / "a.bag").write_bytes(content)
    with pytest.raises(InputError, match="has no index, its recorder did not end"):
        read_realsense(tmp_path / "a.bag")


def png(values: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(values).save(out, "PNG")
    return out.getvalue()


DEPTH = np.random.default_rng(3).integers(400, 900, (3, 12, 16), dtype=np.uint16)
PINHOLE = {"width": 16, "height": 12, "fx": 14.0, "fy": 15.0, "ppx": 7.5, "ppy": 5.5, "model": "none", "coeffs": []}


def test_folders_of_images_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "depth"
    folder.mkdir()
    for k, image in enumerate(DEPTH):
        if k == 2:
            Image.fromarray(image).save(folder / "frame_10.tiff")
        else:
            (folder / f"frame_{k + 1}.png").write_bytes(png(image))
    (tmp_path / "camera.json").write_text(json.dumps(PINHOLE))
    (tmp_path / "stamps.txt").write_text("# s\n1.0 frame_1\n1.033 frame_2\n1.3 frame_10\n")
    stream = read_image_folder(folder, tmp_path / "camera.json", stamps=tmp_path / "stamps.txt")
    assert all(np.array_equal(stream.depth(k), DEPTH[k]) for k in range(3))  # by number, not by name
    assert stream.stamps.tolist() == [1.0, 1.033, 1.3]
    assert stream.numbers is not None
    assert stream.numbers.tolist() == [1, 2, 10]
    point = stream.cloud(0).reshape(12, 16, 3)[5, 3]
    np.testing.assert_allclose(point, DEPTH[0, 5, 3] * 1e-3 * np.array([(3 - 7.5) / 14, (5 - 5.5) / 15, 1]))
    (tmp_path / "stamps.txt").write_text("1.0\n")
    with pytest.raises(InputError, match="1 stamps; expected 3"):
        read_image_folder(folder, tmp_path / "camera.json", stamps=tmp_path / "stamps.txt")
    (folder / "frame_11.png").write_bytes(png(np.zeros((12, 16, 3), np.uint8)))
    with pytest.raises(InputError, match=r"frame_11\.png: an image of kind RGB; expected 16 bits"):
        read_image_folder(folder, tmp_path / "camera.json").depth(3)


def test_intrinsics_of_open3d_and_azure_kinect() -> None:
    matrix = [504.0, 0, 0, 0, 503.0, 0, 320.0, 330.0, 1]
    pinhole = intrinsics_of_json({"width": 640, "height": 576, "intrinsic_matrix": matrix}, None, "a.json")
    assert (pinhole.focal, pinhole.centre) == ((504.0, 503.0), (320.0, 330.0))
    p = [0.5, 0.5, 0.49, 0.49, 0.3, 0.2, 0.01, 0.6, 0.3, 0.05, 0, 0, 1e-4, 2e-4, 0]
    depth = {"Purpose": "CALIBRATION_CameraPurposeDepth", "Intrinsics": {"ModelParameters": p}}
    raw = {"CalibrationInformation": {"Cameras": [{"Purpose": "Color"}, depth]}}
    camera = intrinsics_of_json(raw, (640, 576), "a.json")
    assert camera.focal[0] == pytest.approx(0.49 * 1024)
    assert camera.centre == pytest.approx((512 - 192 - 0.5, 512 - 180 - 0.5))
    assert camera.coefficients == (0.3, 0.2, 2e-4, 1e-4, 0.01, 0.6, 0.3, 0.05)
    for wrong in ({}, [], {"width": 1}, {**PINHOLE, "fx": "x"}, {**PINHOLE, "width": 10**9}, {**PINHOLE, "fx": 0}):
        with pytest.raises(InputError, match=r"a\.json"):
            intrinsics_of_json(wrong, None, "a.json")
    with pytest.raises(InputError, match="distortion model 'fish'; expected one of none, brown_conrady"):
        intrinsics_of_json({**PINHOLE, "model": "fish"}, None, "a.json")


def test_npz_stacks_are_read(tmp_path: Path) -> None:
    matrix = np.array([[14.0, 0, 7.5], [0, 15.0, 5.5], [0, 0, 1]])
    np.savez(tmp_path / "a.npz", depth=DEPTH, stamps=[1.0, 2.0, 3.0], unit=2e-4, intrinsics=matrix)
    stream = read_depth_npz(tmp_path / "a.npz")
    assert (stream.unit, stream.clock) == (2e-4, "device")
    assert np.array_equal(stream.depth(2), DEPTH[2])
    for wrong, message in (
        ({"depth": DEPTH[0]}, r"depth is \(12, 16\); expected"),
        ({"depth": DEPTH.astype(float)}, "depth is float64; expected uint16"),
        ({"depth": DEPTH}, "no intrinsics"),
        ({"depth": DEPTH, "intrinsics": matrix, "stamps": [1.0]}, "stamps are"),
        ({"depth": DEPTH, "intrinsics": matrix, "stamps": [1.0, np.nan, 2.0]}, "a stamp is not finite"),
        ({"depth": DEPTH, "intrinsics": matrix, "unit": 5.0}, "a depth unit of 5 m"),
    ):
        np.savez(tmp_path / "b.npz", **wrong)
        with pytest.raises(InputError, match=message):
            read_depth_npz(tmp_path / "b.npz")


def test_images_that_claim_to_be_huge_are_refused_before() -> None:
    content = bytearray(png(DEPTH[0]))
    content[16:24] = struct.pack(">II", 60_000, 60_000)
    with pytest.raises(InputError, match=r"60000 x 60000 pixels; expected at most|cannot be read as an image"):
        depth_image(bytes(content), "a.png")
    for cut in (0, 20, 60):
        with pytest.raises(InputError, match=r"a\.png: cannot be read as an image"):
            depth_image(png(DEPTH[0])[:cut], "a.png")


IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
"""
INFO = """std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
"""
HEADER = f"""{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


def write_mcap(path: Path, images: list[dict], info: dict | None) -> Path:
    from mcap_ros2.writer import Writer

    def header(k: int) -> dict:
        return {"stamp": {"sec": 100 + k, "nanosec": 5}, "frame_id": "depth"}

    with path.open("wb") as stream:
        writer = Writer(stream)
        shown = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE + HEADER)
        optics = writer.register_msgdef("sensor_msgs/msg/CameraInfo", INFO + HEADER)
        if info is not None:
            writer.write_message("/left/depth/camera_info", optics, {"header": header(0), **info}, log_time=0)
            writer.write_message(
                "/right/depth/camera_info", optics, {"header": header(0), **info, "width": 5}, log_time=0
            )
        for k, image in enumerate(images):
            writer.write_message("/left/depth/image", shown, {"header": header(k), **image}, log_time=k)
        writer.finish()
    return path


def image_message(values: np.ndarray, encoding: str = "16UC1", pad: int = 2) -> dict:
    rows = [row.tobytes() + b"\0" * pad for row in values]
    return {
        "height": len(rows), "width": values.shape[1], "encoding": encoding, "is_bigendian": 0, "step": len(rows[0]),
        "data": b"".join(rows),
    }  # fmt: skip


def test_images_of_an_mcap_are_read(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="the extra ros is not installed")
    info = {
        "height": 12,
        "width": 16,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": [14, 0, 7.5, 0, 15, 5.5, 0, 0, 1],
    }
    path = write_mcap(tmp_path / "a.mcap", [image_message(image) for image in DEPTH], info)
    stream = read_mcap_depth(path, "/left/depth/image")
    assert all(np.array_equal(stream.depth(k), DEPTH[k]) for k in range(3))
    np.testing.assert_allclose(stream.stamps, [100, 101, 102], atol=1e-6)
    metres = np.where(DEPTH[0] > 800, np.nan, DEPTH[0] * 1e-3).astype(np.float32)
    path = write_mcap(tmp_path / "a.mcap", [image_message(metres, "32FC1", 4)], info)
    stream = read_mcap_depth(path, "/left/depth/image")
    np.testing.assert_allclose(stream.depth(0) * stream.unit, np.nan_to_num(metres), atol=1e-6)
    with pytest.raises(InputError, match="no depth images on /nowhere"):
        read_mcap_depth(path, "/nowhere")
    path = write_mcap(tmp_path / "a.mcap", [image_message(DEPTH[0]) | {"data": b"123"}], info)
    with pytest.raises(InputError, match=r"12 x 16 pixels have 3 bytes; expected 12 rows"):
        read_mcap_depth(path, "/left/depth/image").depth(0)
    path = write_mcap(tmp_path / "a.mcap", [image_message(DEPTH[0])], None)
    with pytest.raises(InputError, match="no CameraInfo"):
        read_mcap_depth(path, "/left/depth/image")


def test_colours_are_told_apart() -> None:
    image = np.array([[[255, 0, 0], [250, 10, 60], [0, 255, 0], [10, 10, 10]]], dtype=np.uint8)
    red = of_colour(image, ((330.0, 0.5, 0.3), (380.0, 1.0, 1.0)))  # over the end of the circle
    assert red.tolist() == [[True, True, False, False]]


def test_a_db3_of_something_else_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    connection = sqlite3.connect(tmp_path / "a.db3")
    connection.execute("create table t (a int)")
    connection.commit()
    connection.close()
    with pytest.raises(InputError, match=re.escape(str(tmp_path / "a.db3"))):
        read_realsense(tmp_path / "a.db3")


def test_a_sphere_says_where_cameras_stand(tmp_path: Path) -> None:
    """Four cameras see a sphere of 30 mm at four places, with noise; nominal poses are 10 mm and 2 degrees off."""
    from fabdesign.clouds.recording import read_recording
    from studies.fusion.reference import off
    from studies.fusion.targets import solve, sphere_middle, with_target_poses
    from studies.rig.cameras import CAMERAS
    from tests.recorded_sheet import PINHOLE, SIZE, cameras, write

    made = {name: cameras()[name] for name in CAMERAS}
    folder = write(tmp_path, made, more='[target]\nfolder = "sphere"\nsphere = 0.03\n')
    (folder / "sphere").mkdir()
    rng = np.random.default_rng(2)
    optics = Intrinsics(SIZE[1], SIZE[0], PINHOLE[:2], PINHOLE[2:])
    ray = np.concatenate([optics.slopes, np.ones((*SIZE, 1))], axis=2)
    for name, camera in made.items():
        images = []
        for place in np.random.default_rng(3).uniform([-0.08, -0.18, -0.05], [0.08, -0.02, 0.05], (4, 3)):
            middle = (place - camera.pose[:3, 3]) @ camera.pose[:3, :3]
            a, b = (ray**2).sum(axis=2), ray @ middle
            inside = b**2 - a * (middle @ middle - 0.03**2)
            z = (b - np.sqrt(np.maximum(inside, 0))) / a + rng.normal(0, 5e-4, SIZE)
            z = np.where(inside > 0, z, np.where(rng.random(SIZE) < 0.004, 1.2, 0))  # a wall with few matches
            images += [(z / 2e-4).astype(np.uint16)] * 3  # held still, between two that may move
        matrix = np.array([[PINHOLE[0], 0, PINHOLE[2]], [0, PINHOLE[1], PINHOLE[3]], [0, 0, 1]])
        np.savez(folder / "sphere" / f"{name}.npz", depth=images, stamps=np.arange(12.0), unit=2e-4, intrinsics=matrix)
    recording = read_recording(folder)
    placed, residuals = with_target_poses(recording)
    assert max(residuals.values()) < 1e-3
    first = made["front_left"].pose
    for sensor in placed.sensors:  # to each other: the world's frame stays that of the nominal poses as a whole
        to_first = np.linalg.inv(placed.sensors[0].camera_to_world) @ sensor.camera_to_world
        distance, angle = off(to_first, np.linalg.inv(first) @ made[sensor.name].pose)
        assert distance < 3e-3
        assert angle < 0.4
    assert sphere_middle(rng.uniform(-0.1, 0.1, (500, 3)) + [0, 0, 0.6], 0.03, 1 / 106.0, rng) is None
    square = {(k, 0): rng.normal(size=3) for k in range(4)}
    with pytest.raises(InputError, match="sensor a has 1 places in common"):
        solve([square, {(0, 0): np.zeros(3)}], [np.eye(4), np.eye(4)], ["a", "b"])


def test_a_charuco_board_is_seen() -> None:
    cv2 = pytest.importorskip("cv2", reason="the extra board is not installed")
    from fabdesign.depth.sensor import SeenTarget
    from fabdesign.depth.stream import DepthStream
    from studies.fusion.targets import target_points

    target = SeenTarget("calibration", square=0.03, marker=0.022)
    board = cv2.aruco.CharucoBoard((5, 7), 0.03, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    drawn = board.generateImage((400, 560), marginSize=0)  # 80 pixels a square
    image = np.full((700, 640, 3), 255, np.uint8)
    image[60:620, 100:500] = drawn[..., None]
    camera = Intrinsics(640, 700, (1600.0, 1600.0), (319.5, 349.5))  # at 0.6 m a square of 30 mm is 80 pixels
    stream = DepthStream("a", camera, 1e-3, np.zeros(1), lambda k: np.zeros((700, 640), np.uint16))
    stream = DepthStream(
        "a", camera, 1e-3, np.zeros(1), stream.read, colour=lambda k: image, colour_camera=camera
    )  # fmt: skip
    seen = target_points(stream, [0], target)
    assert len(seen) == 4 * 6
    points = np.array([seen[0, k] for k in range(24)]).reshape(6, 4, 3)
    np.testing.assert_allclose(points[..., 2], 0.6, atol=5e-3)
    np.testing.assert_allclose(np.diff(points[..., 0], axis=1), 0.03, atol=3e-4)


def test_a_recording_of_bags_is_read(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra realsense is not installed")
    from fabdesign.clouds.recording import read_recording
    from tests.recorded_sheet import cameras, write

    folder = write(tmp_path / "recording", {"front_left": cameras()["front_left"], "back_left": cameras()["back_left"]})
    for ending in ("bag", "db3"):
        shutil.copy(SAMPLES / f"sample.{ending}", folder)
    text = (folder / "recording.toml").read_text()
    text = text.replace('images = "front_left.npz"', 'bag = "sample.bag"\nserial = "123456789012"')
    (folder / "recording.toml").write_text(text.replace('images = "back_left.npz"', 'bag = "sample.db3"'))
    recording = read_recording(folder)
    np.testing.assert_allclose(recording.times, np.array([0, 1, 3, 4]) / 30, atol=1e-5)
    front, back = recording.sensors
    np.testing.assert_allclose(recording.frame(front, 2), recording.frame(back, 2), atol=1e-6)

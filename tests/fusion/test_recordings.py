"""Recordings of cameras that stamp their images: clocks, poses, losses and the pressure's log, against what is true."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

pytest.importorskip("open3d", exc_type=Exception)

from fabdesign.clouds.recording import read_recording
from fabdesign.depth.intrinsics import Intrinsics
from fabdesign.depth.sensor import Cut
from fabdesign.depth.stream import DepthStream
from fabdesign.errors import InputError
from fabdesign.files.measurement_set import read_set
from fabdesign.geometry.surface import Surface
from studies.check.files import inspect
from studies.fusion.cleaning import Cleaned, clean, clean_image
from studies.fusion.cutting import Cutter
from studies.fusion.fuse import fuse
from studies.fusion.input import shifted_sensor
from studies.fusion.joint import Arrangement, SensorView
from studies.fusion.moving import losses, view_at, with_speeds
from studies.fusion.reference import off
from studies.fusion.ripple import ripple_of
from studies.fusion.stamped import StampedFrames, stamped_frames
from studies.fusion.targets import felt_gravity, upright
from studies.measured.splits import Tolerance
from studies.rig.cameras import StereoCamera
from tests.recorded_sheet import (
    CAMERA,
    DESIGN,
    DURATION,
    OFFSETS,
    PINHOLE,
    SIZE,
    STEPS,
    Camera,
    cameras,
    faces,
    images,
    write,
)

NAMES = ("front_left", "front_right", "back_left", "back_right")


@pytest.fixture(autouse=True)
def ten_instants(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses and clocks by fewer instants: quick."""
    monkeypatch.setattr("studies.fusion.stamped.JOINT", 10)


def frames_of(folder: Path, made: dict[str, Camera], **given: str) -> StampedFrames:
    return stamped_frames(read_recording(write(folder / "recording", made, **given)), Tolerance(True))


def clock_errors(seen: StampedFrames, made: dict[str, Camera]) -> list[float]:
    """Return by how much [s] each camera's clock against the first one's is off."""
    sensors = seen.timing.sensors
    return [sensors[name].offset - (OFFSETS[NAMES.index(name)] - OFFSETS[0]) for name in sensors]


def test_a_recording_becomes_a_set(tmp_path: Path) -> None:
    """Lost images, a repeated one and clocks that are apart shift nothing; the log joins by its steps."""
    made = dict(cameras())
    made["front_right"] = made["front_right"].without(20, 30)
    made["back_left"] = made["back_left"].without(25)
    camera = made["front_left"]
    again = np.insert(np.arange(len(camera.true)), 15, 14)  # its image stands twice, with the stamp of the next one
    stamps = np.insert(camera.stamps, 15, camera.stamps[14] + 0.016)
    made["front_left"] = Camera(camera.nominal, camera.pose, camera.true[again], stamps, camera.depth[again])
    report = fuse(write(tmp_path / "recording", made), tmp_path / "set", points=1200)
    assert report.timing is not None
    timing = report.timing.sensors
    assert {name: (t.lost, t.repeated) for name, t in timing.items()} == {
        "front_left": (0, 1), "front_right": (2, 0), "back_left": (1, 0), "back_right": (0, 0),
    }  # fmt: skip
    for name, offset in zip(NAMES, OFFSETS, strict=True):
        assert timing[name].offset == pytest.approx(offset - OFFSETS[0], abs=3e-3)
    for sensor in report.sensors:
        distance, angle = off(np.array(sensor.camera_to_world), made[sensor.name].pose)
        assert distance < 1e-3
        assert angle < 0.1
    data = read_set(tmp_path / "set").trials[0].load()
    squares = [Surface(*faces(t)).distance(points) ** 2 for t, points in zip(data.time, data.frames, strict=True)]
    assert np.sqrt(np.concatenate(squares).mean()) < 8e-4  # m, at the set's own times
    assert data.pressure[0].tolist() == [3e5, 0.0]
    assert data.pressure[-1].tolist() == [0.0, 2e5]
    assert (np.diff(data.time) < 0.04).all()  # no frame is missing: each side has another camera
    assert read_set(tmp_path / "set").recording["000"].sensors["front_right"].lost == 2
    page = (tmp_path / "set" / "report.html").read_text()
    assert "clock ahead, ms" in page
    assert json.loads((tmp_path / "set" / "fusion.json").read_text())["timing"]["steps"] >= 1


def test_a_camera_that_was_moved_is_named_with_its_frame(tmp_path: Path) -> None:
    made = dict(cameras())
    camera = made["back_right"]
    moved = camera.pose.copy()
    moved[:3, 3] += [0.0, 0.0, 0.008]
    since = 24
    depth = camera.depth.copy()
    depth[since:] = images(moved, camera.true[since:], np.random.default_rng(0))
    made["back_right"] = replace(camera, depth=depth)
    recording = read_recording(write(tmp_path / "recording", made))
    tolerance = Tolerance(True)
    seen = stamped_frames(recording, tolerance)
    (line,) = tolerance.skipped
    assert re.match(r"sensor back_right: its view leaves the others' from frame 2[345] on, .*; was it moved\?", line)
    assert len(seen.timed.views[3]) <= since + 1
    assert seen.timed.times is seen.timed.times and len(seen.timed.times[3]) == len(seen.timed.views[3])
    assert len(seen.cutters[3].views) == len(camera.true)


def test_volts_on_another_clock_join_by_their_steps_and_bars_are_cut(tmp_path: Path) -> None:
    """The log begins 0.4 s before the first step; a bar before the cloth and a wall behind it are cut and counted."""
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 0.4 + DURATION, 0.01)
    at = [(time >= 0.4 + step).astype(float) for step in STEPS]
    volts = np.stack([1.0 + 3.0 * (at[0] - at[1]), 1.0 + 2.0 * at[1]], axis=1) + rng.normal(0, 0.004, (len(time), 2))
    rows = "\n".join(f"{7 + t:.3f},{a:.4f},{b:.4f}" for t, (a, b) in zip(time, volts, strict=True))
    log = f"t [s],p0 [V],p1 [V]\n{rows}\n"
    made = dict(cameras())
    camera = made["front_left"]
    depth = camera.depth.copy()
    depth[:, 5:15, :] = round(0.3 / CAMERA.unit)
    depth[:, 200:, 100:140] = round(1.5 / CAMERA.unit)
    made["front_left"] = replace(camera, depth=depth)
    more = "[cut]\nplanes = [[0, 1, 0, -0.5]]\n[pressure]\nper_volt = [100.0]\nzero = [1.0]\n"
    seen = frames_of(tmp_path, made, more=more, pressure=log)
    begins = seen.timing.pressure + camera.true[0]  # s, on the true axis
    assert begins == pytest.approx(-0.4, abs=0.012)  # rows are 10 ms apart
    assert seen.recording.program.at(np.array([0.6]))[0] == pytest.approx([3e5, 0.0], abs=5e3)
    assert max(map(abs, clock_errors(seen, made))) < 3e-3
    share = seen.cutters[0].shares["box"]
    assert share == pytest.approx(3200 / (3200 + np.count_nonzero(camera.depth[0])), abs=0.06)
    with pytest.raises(InputError, match="volts become -"):
        frames_of(tmp_path, made, more="[pressure]\nper_volt = [100.0]\nzero = [3.0]\n", pressure=log)


def test_cameras_whose_cloth_rests_are_taken_as_stamped(tmp_path: Path) -> None:
    """Without motion nothing says how clocks differ: it is said so, and not guessed."""
    still = {
        name: replace(c, true=c.true[:10], stamps=c.stamps[:10], depth=c.depth[:10]) for name, c in cameras().items()
    }
    seen = frames_of(tmp_path, still, pressure="time_s,channel_0,channel_1\n0,0,0\n1,0,0\n")
    assert [t.estimated for t in seen.timing.sensors.values()] == [True, False, False, False]


def spoil_stamp(camera: Camera) -> Camera:
    stamps = camera.stamps.copy()
    stamps[20] += 0.014
    return replace(camera, stamps=stamps)


@pytest.mark.parametrize(
    ("spoil", "lost", "repeated", "late"),
    [
        (lambda c: c, 0, 0, 0),
        (lambda c: c.without(12, 13, 30), 3, 0, 0),
        (spoil_stamp, 0, 0, 1),
    ],
)
def test_losses_are_seen_by_stamps(spoil: Callable[[Camera], Camera], lost: int, repeated: int, late: int) -> None:
    camera = spoil(cameras()["front_left"])
    strange = losses(camera.stamps, None, [False] * len(camera.stamps))
    assert (len(strange.lost), len(strange.repeated), len(strange.late)) == (lost, repeated, late)


def test_losses_are_seen_by_the_counter() -> None:
    stamps = np.arange(6) / 30
    strange = losses(stamps, np.array([1, 2, 3, 6, 7, 8]), [False, False, True, False, False, False])
    assert (len(strange.lost), strange.repeated) == (2, (2,))


def test_check_reads_a_recording_of_images(tmp_path: Path) -> None:
    folder = write(tmp_path / "recording", {name: cameras()[name] for name in NAMES})
    assert inspect(folder / "recording.toml").problems == ()
    text = (folder / "recording.toml").read_text()
    for wrong, message in (
        (text.replace('images = "front_left.npz"', 'images = "front_left.npz"\nbag = "a.bag"'), "expected one of them"),
        (text.replace('images = "front_left.npz"', 'bag = "a.zip"'), r"a file \.bag or \.db3"),
        (text.replace('images = "front_left.npz"', ""), "expected one kind"),
        (text.replace("[[sensors]]", "[cut]\nbox = [[1, 0, 0], [0, 1, 1]]\n[[sensors]]", 1), "the lower corner"),
        (text.replace("[[sensors]]", "[pressure]\nper_volt = [0.0]\n[[sensors]]", 1), "kPa per V"),
    ):
        (folder / "recording.toml").write_text(wrong)
        with pytest.raises(InputError, match=message) as refused:
            read_recording(folder)
        assert "\n" not in str(refused.value)


def test_a_shift_without_stamps_is_found_by_the_motion() -> None:
    """A cloud is lost in the middle: from there on a camera's frames are the others' next ones."""
    times = np.arange(8) / 30 + 0.01
    views, rng = [], np.random.default_rng(1)
    camera = Intrinsics(SIZE[1], SIZE[0], PINHOLE[:2], PINHOLE[2:])
    for k, name in enumerate(NAMES):
        lost = times + (1 / 30 if name == "front_right" else 0.0) * (np.arange(8) >= 2)
        for frame, image in enumerate(images(cameras()[name].pose, lost, rng)):
            cloud = clean_image(image * CAMERA.unit, camera.slopes, 0.003)
            views.append(SensorView(frame, k, cloud))
    poses = [cameras()[name].pose for name in NAMES]
    arranged = Arrangement(poses, ["front", "front", "back", "back"], 0.002)
    shifted = shifted_sensor(views, arranged)
    assert shifted is not None
    sensor, lags = shifted
    assert sensor == 1
    assert [lags[frame] for frame in range(7)] == [0, 0, 1, 1, 1, 1, 1]
    straight = [view for view in views if view.camera != 1]
    assert shifted_sensor(straight, arranged) is None


def test_a_hand_beside_the_predicted_cloth_is_cut() -> None:
    """It lies in the box, 60 mm before the cloth; not near the predicted cloth, nor of the cloth's colour."""
    camera = cameras()["front_left"]
    image = camera.depth[0].copy()
    hand = np.zeros_like(image, dtype=bool)
    hand[100:130, 100:120] = True
    image[hand] = image[hand] - round(0.06 / CAMERA.unit)
    optics = Intrinsics(SIZE[1], SIZE[0], PINHOLE[:2], PINHOLE[2:])
    colours = np.where(hand[..., None], [200, 150, 120], [20, 40, 200]).astype(np.uint8)  # skin, and blue cloth
    stream = DepthStream("a", optics, CAMERA.unit, np.zeros(1), lambda k: image, colour=lambda k: colours)
    aside = np.array([[1.0, 0, 0, 0.015], [0, 1, 0, 0], [0, 0, 1, 0]])  # of the colour camera: it sees the hand shifted
    stream = replace(stream, colour_camera=optics, depth_to_colour=aside)
    pixels = round(0.015 * PINHOLE[0] / float(np.median(image[hand]) * CAMERA.unit))
    colours = np.roll(colours, pixels, axis=1)
    cloth = cKDTree(faces(0.0)[0])
    kept = {}
    blue = Cut(colour=((200.0, 0.3, 0.2), (260.0, 1.0, 1.0)))
    for name, cut, predicted in (
        ("box", Cut(), None),
        ("predicted", Cut(predicted=0.03), lambda number: cloth),
        ("colour", blue, None),
    ):
        cutter = Cutter(stream, camera.pose, cut, DESIGN.fabric, "front_left", predicted)
        depth = np.zeros(SIZE)
        depth[cutter.part] = cutter.depth(0)
        kept[name] = (depth > 0) & hand
        assert np.count_nonzero((depth > 0) & ~hand) > 0.97 * np.count_nonzero((image > 0) & ~hand)
    assert kept["box"].sum() > 500
    assert kept["predicted"].sum() == 0
    assert kept["colour"].sum() < 0.1 * kept["box"].sum()  # the hand's border is a pixel off


def test_a_step_between_two_images_does_not_bend_the_view() -> None:
    """2 ms after a step a sheet is where it came to; a polynomial through images of before and after moves it."""
    slopes = np.stack(np.meshgrid(*[np.linspace(-0.1, 0.1, 20)] * 2), axis=-1).reshape(-1, 2)
    cells = np.indices((20, 20)).reshape(2, -1).T
    ahead = np.tile([0.0, 0.0, -1.0], (400, 1))

    def depth(time: float) -> float:
        after = max(time, 0.0) / 0.015
        return 0.6 + 0.02 * time + 0.03 * (1 - (1 + after) * np.exp(-after))

    times = np.array([-0.053, -0.020, 0.013, 0.047, 0.080])
    clouds = [Cleaned(depth(t) * np.column_stack([slopes, np.ones(400)]), ahead, 0, cells) for t in times]
    views = with_speeds(clouds, list(times), range(5))
    for instant, steps, least, most in (
        (0.002, [0.0], 0.0, 4e-4), (0.002, [], 1.5e-3, 1.0), (-0.01, [0.0], 0.0, 1e-6), (-0.01, [], 5e-4, 1.0),
        (0.03, [0.0], 0.0, 3e-3), (0.07, [0.0], 0.0, 1e-3),
    ):  # fmt: skip
        cloud, velocity = view_at(views, times, instant, steps)
        assert least <= np.abs(cloud.points[:, 2] - depth(instant)).max() <= most, (instant, steps)
    np.testing.assert_allclose(velocity[:, 2], (depth(0.071) - depth(0.069)) / 2e-3, atol=0.04)


@pytest.mark.parametrize(("amplitude", "remains"), [(0.0, 1.0), (0.05, 0.85), (0.53, 0.35)])
def test_ripple_is_found_and_taken_off(amplitude: float, remains: float) -> None:
    """A bent sheet, seen obliquely at 0.62 m; 0.53 pixels of disparity are 1.5 % of the depth."""
    camera, rng = StereoCamera(ripple=amplitude, unit=1e-4), np.random.default_rng(1)
    pixel = 0.62 / camera.optics.focal[0]
    rows, columns = np.indices((130, 110))
    true = [0.62 + 0.9 * pixel * (columns - 55) + 0.01 * np.sin(rows / 30 + k) for k in range(3)]
    seen = [camera.reported(depth, rng) * camera.unit for depth in true]
    ripple = ripple_of(seen, camera.optics.focal[0], pixel)
    if not amplitude:
        assert ripple is None
        return
    assert ripple is not None
    assert ripple.frequency == pytest.approx(camera.optics.focal[0] * camera.baseline, rel=0.02)
    assert ripple.disparity == pytest.approx(amplitude, rel=0.1)
    inner = (slice(10, -10), slice(10, -10))
    off = [[(image - depth)[inner][image[inner] > 0] for image, depth in zip(images, true, strict=True)]
           for images in (seen, [ripple.without(image) for image in seen])]  # fmt: skip
    before, after = (float(np.sqrt((np.concatenate(each) ** 2).mean())) for each in off)
    assert after < remains * before


def test_a_cloud_on_no_raster_is_cleaned() -> None:
    """Random points of a bent sheet at 0.6 m with noise of 0.5 mm, and 5 % that fly up to 25 mm behind it."""
    rng = np.random.default_rng(7)
    x, y = rng.uniform(-0.1, 0.1, (2, 6000))
    depth = 0.6 + 0.1 * x + 0.02 * np.sin(20 * y)
    flies = rng.random(len(x)) < 0.05
    seen = depth + rng.normal(0, 5e-4, len(x)) + flies * rng.uniform(0.005, 0.025, len(x))
    cleaned = clean(np.stack([x * seen / depth, y * seen / depth, seen], axis=1))
    assert len(cleaned.points) > 2000
    off = cleaned.points[:, 2] - 0.6 - 0.1 * cleaned.points[:, 0] - 0.02 * np.sin(20 * cleaned.points[:, 1])
    assert np.sqrt((off**2).mean()) < 7e-4
    assert np.abs(off).max() < 4e-3


def test_gravity_turns_nominal_poses_upright(tmp_path: Path) -> None:
    """The poses as a whole are 3 degrees off; what the cameras feel turns them back about the top edge."""
    recording = read_recording(write(tmp_path / "recording", dict(cameras())))
    true = [sensor.camera_to_world for sensor in recording.sensors]
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_euler("zx", [2.0, 3.0], degrees=True).as_matrix()
    depth = tuple(
        replace(stream, gravity=pose[:3, :3].T @ [0.0, -9.81, 0.0])
        for stream, pose in zip(recording.depth, true, strict=True)
    )
    sensors = tuple(replace(s, camera_to_world=tilt @ s.camera_to_world) for s in recording.sensors)
    assert upright(replace(recording, sensors=sensors)).sensors == sensors  # no camera feels it
    turned = upright(replace(recording, sensors=sensors, depth=depth))
    down = felt_gravity(depth, [sensor.camera_to_world for sensor in turned.sensors])
    np.testing.assert_allclose(down, [0.0, -1.0, 0.0], atol=1e-9)
    for sensor, pose in zip(turned.sensors, true, strict=True):
        assert off(sensor.camera_to_world, pose)[1] < 0.2  # degrees: about the vertical itself it says nothing

"""Files that were met, with the right answer for each, and small files that must not cost gigabytes or minutes."""

import base64
import json
import os
import struct
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fabdesign.clouds.cloud_file import read_geometry
from fabdesign.clouds.ply import read_ply
from fabdesign.clouds.recording import read_recording
from fabdesign.depth.stream import pair_frames
from fabdesign.errors import InputError
from fabdesign.files.pressure_file import read_csv
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.toml_file import parse_toml
from fabdesign.geometry.hung_cloth import require_on_cloth
from fabdesign.nouns.catalogue import build
from studies.check.files import inspect
from studies.fusion.input import read_views
from studies.measured.splits import Tolerance
from studies.view.items import items_of
from tests.command_line import Run
from tests.samples import CASES

pytestmark = pytest.mark.filterwarnings("ignore::fabdesign.errors.InputNote")


# --- read with the right values ---------------------------------------------------------------------------------------


def test_numbers_of_any_length_in_an_stl() -> None:
    mesh = read_geometry(CASES / "long_numbers.stl")
    assert mesh.triangles.shape == (32, 3)
    np.testing.assert_allclose(mesh.points.min(axis=0), [-0.1, -0.2, 0.0], atol=1e-15)
    np.testing.assert_allclose(mesh.points.max(axis=0), [0.1, 0.0, 0.02], atol=1e-15)


@pytest.mark.parametrize("name", ["cloudcompare.asc", "cloudcompare.csv", "comment_end_header.ply"])
def test_clouds_that_check_and_view_read_alike(name: str) -> None:
    assert inspect(CASES / name).problems == ()
    (item,) = items_of([CASES / name])
    assert item.frames.shape == (1, 441, 3)
    np.testing.assert_allclose(item.frames[0][:2], [[-0.1, 0, 0], [-0.09, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(np.ptp(item.frames[0], axis=0)[:2], [0.2, 0.2], atol=1e-6)


def test_the_count_of_cloudcompare_is_held_to(tmp_path: Path) -> None:
    for name in ("a.asc", "a.txt"):
        (tmp_path / name).write_text("//X Y Z\n3\n0 0 1\n0 1 0\n")
        (line,) = inspect(tmp_path / name).problems
        assert 'line 2: "3" is the count of points, of which there are 2' in line


def test_the_separator_line_of_excel(tmp_path: Path) -> None:
    program = read_csv(CASES / "sep_line.csv")
    np.testing.assert_allclose(program.pressure[:2], [[1e5, 1e5, 0, 0], [2e5, 1e5, 0, 0]])
    (tmp_path / "c.csv").write_text('"sep=;"\nx;y;z\n0,5;1;2\n')
    np.testing.assert_array_equal(read_geometry(tmp_path / "c.csv").points, [[0.5, 1, 2]])
    (tmp_path / "p.csv").write_text("sep=;\ntime_s;channel_0\n0;x\n")
    with pytest.raises(InputError, match="line 3"):
        read_csv(tmp_path / "p.csv")


# --- refused in one line ----------------------------------------------------------------------------------------------

REFUSED = {
    "thousands.csv": "'1,000' may be 1000 or 1.000",
    "tristrips.ply": "has tristrips rows with vertex_indices, which are not read",
    "huge_index.obj": 'line 4: "f 1 2 99999999999999999999" is no whole vertex or face',
    "bad_header.npy": "is damaged or no npy",
    "claim_count.pcd": "a point is larger than a file may be",
    "format_list.toml": 'format is "[]"; expected one of',
    "wrapped_int16.npz": "points fill the range of int16, -32764 to 32764, in x and y and z",
    "empty_message": "/a, frame 1: the cloud is empty",
}


@pytest.mark.parametrize(("name", "line"), REFUSED.items(), ids=[*REFUSED])
def test_what_is_refused(name: str, line: str) -> None:
    (problem,) = inspect(CASES / name).problems
    assert line in problem
    assert "\n" not in problem


def test_commas_that_can_only_be_decimal_are_read(tmp_path: Path) -> None:
    for text in ('time_s,channel_0\n0,"1,000"\n1,"2,5"\n', "time_s;channel_0\n0;1,000\n1;2,500\n"):
        (tmp_path / "p.csv").write_text(text)
        np.testing.assert_allclose(read_csv(tmp_path / "p.csv").pressure[:, 0], [1e3, 2.5e3])


def test_integers_that_fill_one_axis_or_none_did_not_wrap(tmp_path: Path) -> None:
    points = np.array([[-32767, 0, 5], [32767, -32767, 900], [0, -16000, 30]], np.int16)
    np.save(tmp_path / "a.npy", points)  # packed as close as can be: x from end to end, y below the edge
    assert len(read_geometry(tmp_path / "a.npy").points) == 3
    np.save(tmp_path / "a.npy", np.concatenate([points, [[0, 32700, 3]]]).astype(np.int16))
    with pytest.raises(InputError, match="in x and y; expected room"):
        read_geometry(tmp_path / "a.npy")


def test_a_cloud_far_smaller_than_its_cloth(tmp_path: Path) -> None:
    cloud = np.random.default_rng(3).uniform([-0.033, -0.066, 0], [0.033, 0, 0.002], (500, 3))
    with pytest.raises(InputError, match=r"the points span 6\d\.\d mm; expected a cloth held along 200 mm"):
        require_on_cloth([cloud], np.array([0.1]), build("cross").fabric, "a")


def test_faces_under_another_name_are_no_cloud(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int corners\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(InputError, match="face rows without vertex_indices, which are not read"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "has 4 rows; its header says 3 vertices and 2 faces"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "a face is not whole"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "cannot be read as a mesh"),
    ],
)
def test_an_off_that_is_cut_short(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.off").write_text(text)
    with pytest.raises(InputError, match=message):
        read_geometry(tmp_path / "a.off")


def plain_gltf() -> dict[str, Any]:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(corners).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"uri": uri, "byteLength": len(corners)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(corners)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }


GLTF = {
    "requires 'KHR_mesh_quantization'": {"extensionsRequired": ["KHR_mesh_quantization"]},
    "has a skin": {"skins": [{"joints": [0]}]},
    "morph targets with weights": {"nodes": [{"mesh": 0, "weights": [0, 0.5]}]},
    "accessor that is sparse": {"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "sparse": {}}]},
    "not float32": {"accessors": [{"bufferView": 0, "componentType": 5122, "count": 3, "normalized": True}]},
    "KHR_draco": {"meshes": [{"primitives": [{"extensions": {"KHR_draco_mesh_compression": {}}}]}]},
    "node in more than one place": {"nodes": [{"children": [1, 1]}, {"mesh": 0}]},
    "has 12000000 points in all": {
        "nodes": [{"mesh": 0}] * 4,
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3_000_000}],
    },
    "its buffers have 200 MB": {"buffers": [{"uri": "big.bin", "byteLength": 36}]},
    "is no plain file": {"buffers": [{"uri": "/dev/zero", "byteLength": 36}]},
}


@pytest.mark.parametrize(("message", "change"), GLTF.items(), ids=[*GLTF])
def test_a_gltf_whose_shape_trimesh_would_miss(message: str, change: dict[str, Any], tmp_path: Path) -> None:
    with (tmp_path / "big.bin").open("wb") as stream:
        stream.truncate(200_000_000)  # sparse
    text = json.dumps(plain_gltf() | change).encode()
    chunk = text + b" " * (-len(text) % 4)
    (tmp_path / "a.gltf").write_bytes(text)
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(chunk), len(chunk), b"JSON") + chunk)
    for name in ("a.gltf", "a.glb"):
        with pytest.raises(InputError, match=message) as caught:
            read_geometry(tmp_path / name)
        assert "\n" not in str(caught.value)
    (tmp_path / "a.gltf").write_text(json.dumps(plain_gltf()))
    assert read_geometry(tmp_path / "a.gltf").triangles.shape == (1, 3)


@pytest.mark.parametrize("mark", [";", "\t", " "])
def test_commas_that_may_part_thousands(mark: str, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(mark.join(["time_s", "channel_0\n0", "500\n1", "1,000\n"]))
    with pytest.raises(InputError, match=r"line 3: '1,000' may be 1000 or 1\.000"):
        read_csv(tmp_path / "p.csv")
    for last in ("1,000", "2,5"):
        (tmp_path / "a.xyz").write_text(mark.join(["999", "0", "1\n1,000", "0", last]) + "\n")
        if last == "2,5":
            np.testing.assert_array_equal(read_geometry(tmp_path / "a.xyz").points, [[999, 0, 1], [1, 0, 2.5]])
            continue
        with pytest.raises(InputError, match="line 2: '1,000' may be 1000"):
            read_geometry(tmp_path / "a.xyz")


@pytest.mark.parametrize("cell", ["1_000", "1_0.5", "\u0661"])
def test_numbers_that_only_python_takes(cell: str, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(f"time_s,channel_0\n0,0\n1,{cell}\n")
    with pytest.raises(InputError, match="line 3"):
        read_csv(tmp_path / "p.csv")
    (tmp_path / "a.xyz").write_text(f"0 0 0\n1 {cell} 0\n")
    with pytest.raises(InputError, match="line 2"):
        read_geometry(tmp_path / "a.xyz")


# --- recordings whose cameras lose messages ---------------------------------------------------------------------------


def test_a_lost_message_leaves_out_its_frame_and_shifts_nothing() -> None:
    pytest.importorskip("mcap_ros2", reason="the extra ros is not installed")
    recording = read_recording(CASES / "dropped_frame")
    np.testing.assert_allclose(recording.times, 0.05 * np.array([1, 2, 3, 5, 6, 7, 8, 9, 10]), atol=1e-9)
    assert "1 of 10 frames are left out (no cloud on /b at 0.2 s), and 1 clouds that repeat" in recording.left_out
    front, back = recording.sensors
    for k in range(9):  # the cameras look at one flat cloth from both sides: its edge is at one place in both
        reach = [np.ptp(recording.frame(sensor, k)[:, 2]) for sensor in (front, back)]
        assert reach[0] == pytest.approx(reach[1], abs=1e-6)
    (note,) = inspect(CASES / "dropped_frame").notes
    assert "1 of 10 frames are left out" in note


def test_an_empty_cloud_is_an_empty_frame() -> None:
    pytest.importorskip("mcap_ros2", reason="the extra ros is not installed")
    recording = read_recording(CASES / "empty_message")
    np.testing.assert_allclose(recording.times, [0.05, 0.1, 0.15])
    anchored = SimpleAnchors(recording.sensors)
    with pytest.raises(InputError, match="frame 1: the cloud is empty"):
        read_views(recording, anchored, Tolerance(skip_bad=False))  # type: ignore[arg-type]
    tolerance = Tolerance(skip_bad=True)
    views = read_views(recording, anchored, tolerance)  # type: ignore[arg-type]
    assert [view.frame for view in views] == [0, 2]
    assert len(tolerance.skipped) == 1


class SimpleAnchors:
    def __init__(self, sensors: object) -> None:
        self.sensors = sensors


SECOND = 1_000_000_000


def stamps(*seconds: float, begin: int = 1_700_000_000 * SECOND) -> np.ndarray:
    return np.array([begin + round(s * SECOND) for s in seconds], np.int64)


def test_pairs_by_stamps() -> None:
    every = stamps(0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    late = every + SECOND // 33  # a camera that is triggered 30 ms later
    pairs = pair_frames([every, np.delete(late, 2), np.delete(late, 4)])
    assert pairs is not None
    assert pairs.clouds.tolist() == [[0, 0, 0], [1, 1, 1], [2, -1, 2], [3, 2, 3], [4, 3, -1], [5, 4, 4]]
    assert pairs.complete.tolist() == [True, True, False, True, False, True]
    both = pair_frames([np.delete(every, 1), np.delete(late, 4)])  # each loses another one
    assert both is not None
    assert both.clouds.tolist() == [[0, 0], [-1, 1], [1, 2], [2, 3], [3, -1], [4, 4]]
    assert both.interval == pytest.approx(0.1, abs=1e-6)
    for silent in ([every, np.zeros(6, np.int64) + 5], [every, late + 1000 * SECOND], [every[:1], late[:1]]):
        assert pair_frames(silent) is None


# --- small files that cost much ---------------------------------------------------------------------------------------


def peak_of(read: Callable[[], object]) -> tuple[float, float]:
    """Most memory [MB] and time [s] that a read takes; an InputError is as good as what it gives."""
    tracemalloc.start()
    begin = time.process_time()
    try:
        read()
    except InputError as error:
        assert "\n" not in str(error)
    seconds, memory = time.process_time() - begin, tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return memory, seconds


def test_an_npz_is_counted_as_what_it_becomes(tmp_path: Path) -> None:
    frames = np.array([0, 50_000_000])
    rest = {"time": np.array([0.1]), "pressure": np.zeros((1, 1)), "scale": 1e-3, "offsets": frames}
    path = tmp_path / "a.npz"
    np.savez_compressed(path, points=np.zeros((50_000_000, 3), np.int8), **rest)
    assert path.stat().st_size < 3e5
    for read in (read_trial, read_geometry, inspect):
        memory, seconds = peak_of(lambda read=read: read(path))  # type: ignore[misc]
        assert memory < 50
        assert seconds < 5
    with pytest.raises(InputError, match=r"points, \(50000000, 3\) int8, takes 1350 MB in memory; expected at most"):
        read_trial(path)


def test_a_trial_is_held_once(tmp_path: Path) -> None:
    cloud = np.random.default_rng(1).integers(-900, 900, (1_000_000, 3)).astype(np.int16)
    rest = {"time": 0.1 * np.arange(1, 101), "pressure": np.ones((100, 1)) * 100, "scale": 1e-4}
    np.savez(tmp_path / "a.npz", points=cloud, offsets=np.arange(101) * 10_000, **rest)
    memory, _ = peak_of(lambda: read_trial(tmp_path / "a.npz"))
    assert memory < 6 + 24 + 15  # MB: as it lies in the file, as float64, and what a frame needs meanwhile


def test_a_key_of_many_parts(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    for text in (
        "a." * 20_000 + "b = 1\n",
        "x = { " + "a . " * 20_000 + "b = 1 }\n",
        "[" + '"a".' * 20_000 + "b]\n",
        "x = [" + "1," * 900_000 + "]\n",
    ):
        path.write_text(text)
        memory, seconds = peak_of(lambda: parse_toml(path))
        assert memory < 30
        assert seconds < 2
        with pytest.raises(InputError, match=r"has over 32 parts|has a line of 1800006 characters"):
            parse_toml(path)
    path.write_text(f'a.b.c.d = "{"word. " * 5000}"\n# {"." * 1000}\nx = [{"0.1," * 20_000}]\n')
    assert len(parse_toml(path)["x"]) == 20_000


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_triangles_and_quads_in_turn(form: str, tmp_path: Path) -> None:
    count = 60_000
    head = f"ply\nformat {form} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {2 * count}\nproperty list uchar int vertex_indices\nend_header\n"
    square = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    if form == "ascii":
        body = "".join("{} {} {}\n".format(*p) for p in square) + count * "3 0 1 2\n4 3 2 1 0\n"
        content = (head + body).encode()
    else:
        pair = struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 3, 2, 1, 0)
        content = head.encode() + b"".join(struct.pack("<3f", *p) for p in square) + count * pair
    (tmp_path / "a.ply").write_bytes(content)
    begin = time.process_time()
    mesh = read_ply(tmp_path / "a.ply")
    assert time.process_time() - begin < 3  # a million and more faces in a few seconds
    assert mesh.triangles.shape == (3 * count, 3)
    np.testing.assert_array_equal(mesh.triangles[-3:], [[0, 1, 2], [3, 2, 1], [3, 1, 0]])  # in the file's order


def test_a_glb_that_claims_much(tmp_path: Path) -> None:
    (tmp_path / "a.gltf").write_text('{"asset": {}, "accessors": [{"count": 9000000000, "type": "VEC3"}]}')
    with pytest.raises(InputError, match="has 9000000000 values in an accessor; expected at most"):
        read_geometry(tmp_path / "a.gltf")


# --- names of files in other encodings --------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="names of other systems are no bytes")
def test_names_that_are_no_utf8(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "c.npy", np.random.default_rng(1).random((50, 3)) * 0.2)
    (tmp_path / "c.npy").rename(os.fsdecode(os.fsencode(tmp_path) + b"/f\xfcr.npy"))
    ascii_only = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    monkeypatch.chdir(tmp_path)
    assert run("view", os.fsdecode(b"f\xfcr.npy"), "-o", "n.html")[0] == 0
    assert run("new", "basic", "-o", "Tür.toml", "--name", "Tür")[0] == 0
    arguments = ["export", "Tür.toml", "--tail-length", "0.05", "-o", "Tür"]
    program = [sys.executable, "-m", "fabdesign", *arguments]
    done = subprocess.run(program, env=ascii_only, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    assert b"f\xfcr.npy" in (tmp_path / "n.html").read_bytes()
    assert "<title>Tür, front</title>" in (tmp_path / "Tür" / "Tür_front.svg").read_text(encoding="utf-8")

"""Motions for other programs: GLB, VTK, Rerun and CSV, opened by what reads them, and how far panels are apart."""

import json
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from fabdesign.cli.console import commands
from fabdesign.errors import InputError
from fabdesign.files.motion_file import read_motion, square_triangles, write_mesh, write_motion
from fabdesign.files.pressure_file import constant_program
from fabdesign.files.trial_file import TrialData, write_trial
from fabdesign.geometry.shape import Shape, laced_muscles, strains
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from studies.view.items import compared, items_of
from studies.view.picture import wrapped_head
from studies.view.shapes import AROUND, points_beneath
from tests.analytic_cloth import AnalyticCloth

TIMES = np.array([0.0, 0.2, 0.5, 1.0])
DESIGN: Design = build("vertical", muscles=2)
SIZE = (DESIGN.fabric.width, DESIGN.fabric.height)
SIDE = 21
POINTS = 2 * SIDE * SIDE


def motion() -> np.ndarray:
    return AnalyticCloth(SIDE).motions([Case(DESIGN, constant_program([320e3, 60e3]))], [TIMES])[0]


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """A motion with its muscles and made-up states, a trial of it, its last shape as a mesh of one face."""
    points = motion()
    bare = laced_muscles(DESIGN, points)
    states = np.arange(len(TIMES) * len(bare.intervals), dtype=np.float32).reshape(len(TIMES), -1)
    muscles = laced_muscles(DESIGN, points, contraction=states / 1000, tension=states)
    names = {name: tmp_path / f"{name}.npz" for name in ("motion", "trial")} | {"mesh": tmp_path / "mesh.ply"}
    write_motion(names["motion"], TIMES, points, size=SIZE, muscles=muscles)
    rng = np.random.default_rng(1)
    frames = tuple(frame + 5e-4 * rng.standard_normal(frame.shape) for frame in points)
    write_trial(TrialData(TIMES[1:], np.tile([320e3, 60e3], (3, 1)), frames[1:]), names["trial"])
    write_mesh(names["mesh"], points[-1], square_triangles(POINTS)[: 2 * (SIDE - 1) ** 2])
    return names


def view(*words: object) -> dict[str, Any]:
    result = CliRunner().invoke(commands, ["view", *map(str, words), "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.output))


def test_muscles_of_a_flat_cloth_have_their_rest_length(files: dict[str, Path]) -> None:
    muscles = read_motion(files["motion"]).muscles
    assert muscles is not None
    lengths = np.linalg.norm(np.diff(muscles.points, axis=1), axis=-1)[:, muscles.intervals[:, 0]]
    rest = [np.linalg.norm(np.diff(m.fixed_points(), axis=0), axis=1) for m in DESIGN.muscles]
    np.testing.assert_allclose(lengths[0], np.concatenate(rest), rtol=1e-4)
    kind = DESIGN.muscle_types[DESIGN.muscles[0].type]
    sides = np.repeat(muscles.sides, np.diff(muscles.begins))
    np.testing.assert_allclose(muscles.points[0, :, 2], sides * kind.axis_offset, atol=1e-6)
    assert lengths[-1, muscles.owners == 0].sum() < lengths[0, muscles.owners == 0].sum()  # 320 kPa shorten it


def test_geometry_gives_the_simulators_contraction() -> None:
    from sim import Simulator

    simulated = Simulator(21).run([Case(DESIGN, constant_program([300e3, 100e3]))], [np.array([0.3])])[0]
    muscles = laced_muscles(DESIGN, simulated.points)
    lengths = np.linalg.norm(np.diff(muscles.points, axis=1), axis=-1)[:, muscles.intervals[:, 0]]
    rest = np.concatenate([np.linalg.norm(np.diff(m.fixed_points(), axis=0), axis=1) for m in DESIGN.muscles])
    # a loop holds an area of the cloth, a place on the picture is a point
    assert np.abs(1 - lengths / rest - simulated.contraction).max() < 0.01
    assert simulated.contraction.max() > 0.03


def test_strain_of_a_stretched_and_sheared_cloth_is_what_it_was_stretched_by() -> None:
    u, v = np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.3, 7))
    sheared = np.stack([1.1 * u - np.sin(0.2) * v, -np.cos(0.2) * v * 0.95, 0 * u], axis=-1)
    sheared[..., 0] += np.sin(0.2) * v * 0.05
    across, down, shear = strains(sheared, (0.2, 0.3))
    np.testing.assert_allclose(across, 0.1, atol=1e-12)
    np.testing.assert_allclose(down, -0.05, atol=1e-12)
    np.testing.assert_allclose(shear, -0.2, atol=1e-12)


@pytest.mark.parametrize(
    ("arrays", "problem"),
    [
        ({"cloth_size": np.array([0.2, -1.0])}, "expected width and height"),
        ({"tension": np.zeros((2, 3), np.float32)}, r"tension is \(2, 3\)"),
        ({"muscle_begins": np.array([0, 1, 2])}, "muscle_begins is"),
        ({"muscle_sides": None}, "no array muscle_sides"),
    ],
)
def test_unsound_muscles(arrays: dict[str, Any], problem: str, files: dict[str, Path]) -> None:
    with np.load(files["motion"]) as archive:
        kept = {**archive, **arrays}
    np.savez(files["motion"], **{name: array for name, array in kept.items() if array is not None})
    with pytest.raises(InputError, match=problem):
        read_motion(files["motion"])


def test_a_glb_holds_every_frame_as_a_morph_target(files: dict[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    trimesh = pytest.importorskip("trimesh")
    out = tmp_path / "m.glb"
    view(files["motion"], files["mesh"], "-o", out)
    asset, binary = glb(out)
    moving, still = asset["meshes"]
    assert len(moving["primitives"]) == 4  # two faces, two muscles
    assert [len(p["targets"]) for p in moving["primitives"]] == [len(TIMES) - 1] * 4
    assert "targets" not in still["primitives"][0] or not still["primitives"][0]["targets"]
    (channel,), (sampler,) = asset["animations"][0]["channels"], asset["animations"][0]["samplers"]
    assert asset["nodes"][channel["target"]["node"]]["mesh"] == 0
    np.testing.assert_allclose(read(asset, binary, sampler["input"])[:, 0], TIMES, atol=1e-6)
    weights = read(asset, binary, sampler["output"]).reshape(len(TIMES), -1)
    base = read(asset, binary, moving["primitives"][0]["attributes"]["POSITION"])
    targets = [read(asset, binary, t["POSITION"]) for t in moving["primitives"][0]["targets"]]
    for points, frame_weights in zip(motion(), weights, strict=True):
        shown = base + np.tensordot(frame_weights, targets, axes=1)
        np.testing.assert_allclose(shown[:POINTS], points, atol=1e-6)
    scene = trimesh.load(out)
    assert len(scene.geometry) == 5
    first = next(g for g in scene.geometry.values() if len(g.faces) == 2 * (SIDE - 1) ** 2)
    assert np.ptp(first.vertices[:, 0]) == pytest.approx(SIZE[0], rel=0.01)


def test_clouds_in_a_glb_are_shown_one_after_another(files: dict[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    view(files["trial"], "-o", tmp_path / "t.glb")
    asset, binary = glb(tmp_path / "t.glb")
    assert [mesh["primitives"][0]["mode"] for mesh in asset["meshes"]] == [0] * 3
    sizes = [read(asset, binary, s["output"])[:, 0] for s in asset["animations"][0]["samplers"]]
    np.testing.assert_array_equal(sizes, np.eye(3))


def glb(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON chunk and the binary one."""
    content = path.read_bytes()
    assert content[:4] == b"glTF"
    (length,) = struct.unpack("<I", content[12:16])
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def read(asset: dict[str, Any], binary: bytes, accessor: int) -> np.ndarray:
    entry = asset["accessors"][accessor]
    begin = asset["bufferViews"][entry["bufferView"]].get("byteOffset", 0)
    width = {"SCALAR": 1, "VEC3": 3}[entry["type"]]
    return np.frombuffer(binary, "<f4", entry["count"] * width, begin).reshape(-1, width)


def test_a_vtk_series_opens_with_all_that_is_known(files: dict[str, Path], tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    from xml.etree import ElementTree

    view(files["motion"], "-o", tmp_path / "m.pvd")
    entries = ElementTree.parse(tmp_path / "m.pvd").getroot().findall(".//DataSet")
    assert [(float(e.get("timestep", "")), e.get("part")) for e in entries] == [(t, p) for p in "01" for t in TIMES]
    cloths, muscles = ([e.get("file", "") for e in entries if e.get("part") == part] for part in "01")
    laced = read_motion(files["motion"]).muscles
    assert laced is not None
    assert laced.tension is not None
    for k, points in enumerate(motion()):
        cloth, lines = (meshio.read(tmp_path / names[k]) for names in (cloths, muscles))
        np.testing.assert_array_equal(cloth.points, points)
        assert len(cloth.cells_dict["triangle"]) == 4 * (SIDE - 1) ** 2
        expected = strains(Shape.of(points).middle, SIZE)[1].ravel()
        np.testing.assert_allclose(cloth.point_data["strain_down"], np.tile(expected, 2), atol=1e-6)
        np.testing.assert_array_equal(lines.points, laced.points[k])
        np.testing.assert_array_equal(lines.cells_dict["line"], laced.intervals)
        np.testing.assert_array_equal(lines.cell_data["tension_N"][0], laced.tension[k])
        assert lines.cell_data["muscle"][0].max() == 1


def test_markers_are_places_on_the_mid_surface(files: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "m.csv"
    view(files["motion"], "--marker", f"tip={SIZE[0]},{SIZE[1]}", "--marker", "between=0.005,0", "-o", out)
    header, *rows = [line.split(",") for line in out.read_text().splitlines()]
    assert header[:5] == ["panel", "time_s", "tip_x_m", "tip_y_m", "tip_z_m"]
    assert [float(row[1]) for row in rows] == TIMES.tolist()
    middle = Shape.of(motion()).middle
    np.testing.assert_allclose([[float(x) for x in row[2:5]] for row in rows], middle[:, -1, -1], atol=1e-6)
    np.testing.assert_allclose([float(row[5]) for row in rows], middle[:, 0, :2, 0].mean(axis=1), atol=1e-6)
    write_motion(tmp_path / "rest.npz", np.array([2.5]), motion()[-1:], size=SIZE)  # as `simulate --equilibrium` does
    view(tmp_path / "rest.npz", "-o", tmp_path / "rest.csv")
    assert (tmp_path / "rest.csv").read_text().splitlines()[1].startswith("rest,,")  # a shape at rest has no time
    with pytest.raises(InputError, match=r"marker far at 9, 0 m: expected a place on the cloth"):
        view(files["motion"], "--marker", "far=9,0", "-o", out, "--force")


def test_a_recording_for_rerun_is_sound(files: dict[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    view(files["motion"], files["trial"], "-o", tmp_path / "m.rrd")
    verify = [sys.executable, "-m", "rerun", "rrd", "verify", str(tmp_path / "m.rrd")]
    completed = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert "1 file verified without error" in completed.stdout + completed.stderr
    (tmp_path / "m.rrd").write_bytes((tmp_path / "m.rrd").read_bytes()[:1000])
    assert subprocess.run(verify, capture_output=True, check=False).returncode


def test_a_motion_becomes_a_video(files: dict[str, Path], tmp_path: Path) -> None:
    if shutil.which("ffmpeg") is None:
        pytest.importorskip("imageio_ffmpeg", reason="no ffmpeg, and the extra video is not installed")
    view(files["motion"], "-o", tmp_path / "m.mp4")
    content = (tmp_path / "m.mp4").read_bytes()
    assert content[4:8] == b"ftyp" and b"moov" in content and b"avc1" in content


def test_without_ffmpeg_a_video_says_what_to_install(
    files: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from fabdesign.cli import main

    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(sys, "argv", ["fabdesign", "view", str(files["motion"]), "-o", str(tmp_path / "m.mp4")])
    with pytest.raises(SystemExit):
        main()
    message = "fabdesign: needs imageio_ffmpeg; install it with: pip install 'fabdesign[video]'\n"
    assert capsys.readouterr().err == message


def test_a_missing_package_is_said_in_one_line_before_work(
    files: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from fabdesign.cli import main

    monkeypatch.setitem(sys.modules, "meshio", None)
    monkeypatch.setattr(sys, "argv", ["fabdesign", "view", str(files["motion"]), "-o", str(tmp_path / "m.pvd")])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 1
    assert capsys.readouterr().err == "fabdesign: needs meshio; install it with: pip install 'fabdesign[export]'\n"
    assert not (tmp_path / "m.pvd").exists()


def test_panels_say_how_far_they_are_apart(files: dict[str, Path], tmp_path: Path) -> None:
    points = AnalyticCloth(41).motions([Case(DESIGN, constant_program([150e3, 60e3]))], [TIMES])[0]
    write_motion(tmp_path / "fine.npz", TIMES, points)
    noisy = points + 5e-4 * np.random.default_rng(1).standard_normal(points.shape)
    write_trial(TrialData(TIMES, np.tile([150e3, 60e3], (len(TIMES), 1)), tuple(noisy)), tmp_path / "cloud.npz")
    first, cloud = (item.apart for item in compared(items_of([tmp_path / "fine.npz", tmp_path / "cloud.npz"])))
    assert first is None
    assert cloud is not None
    assert (cloud.reference, cloud.when) == ("fine", "mean of the motion")
    assert cloud.overall.surface_rms == pytest.approx(5e-4, rel=0.15)  # the noise that the trial was given
    assert cloud.overall.surface_rms == pytest.approx(cloud.overall.surface_floor, rel=0.1)
    _, mesh = (item.apart for item in compared(items_of([files["motion"], files["mesh"]])))
    assert mesh is not None
    assert mesh.when == "at the motion's end"
    assert mesh.overall.surface_rms < 1e-9 < mesh.errors[0].surface_rms


def test_a_floor_that_few_points_cannot_tell_is_not_told(files: dict[str, Path], tmp_path: Path) -> None:
    sparse = tmp_path / "few.xyz"
    sparse.write_text("\n".join("{:.5f} {:.5f} {:.5f}".format(*p) for p in motion()[-1][::40]))
    distance = view(sparse, files["motion"], "-o", tmp_path / "few.html")["panels"][1]["distance"]
    assert distance["chamfer_floor"] is None
    assert distance["surface_rms"] < 1e-2


def test_a_still_mesh_has_one_colour_and_nothing_to_play(files: dict[str, Path], tmp_path: Path) -> None:
    view(files["mesh"], "-o", tmp_path / "still.html")
    page = (tmp_path / "still.html").read_text()
    assert 'id="play"' not in page
    assert page.count("[0.45,0.6,0.42]") == 1
    assert "[0.8,0.22,0.22]" not in page
    distance = view(files["motion"], files["mesh"], "-o", tmp_path / "both.html")["panels"][1]["distance"]
    assert distance["from"] == "motion"
    assert distance["unit"] == "mm"
    assert 'id="play"' in (tmp_path / "both.html").read_text()


def test_the_measured_cloud_lies_over_what_is_compared_with_it(files: dict[str, Path], tmp_path: Path) -> None:
    view(files["trial"], files["motion"], "--overlay", "-o", tmp_path / "over.html")
    page = (tmp_path / "over.html").read_text()
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    assert [item["reference"] for item in data["items"]] == [None, 0]
    assert 'id="overlay" type="checkbox" checked' in page
    result = CliRunner().invoke(commands, ["view", str(files["motion"]), "--overlay", "-o", str(tmp_path / "a.csv")])
    assert isinstance(result.exception, InputError) and "expected an output that ends in .html" in str(result.exception)


def test_a_muscle_knows_the_points_of_its_side_that_it_lies_on(files: dict[str, Path]) -> None:
    (item,) = items_of([files["motion"]])
    beneath = points_beneath(item)
    assert len(beneath) == AROUND * sum(span.stop - span.start for span in item.muscles.spans)
    assert beneath.max() < POINTS // 2  # all of them are laced into the front
    at = np.asarray(item.frames[0])[beneath[::AROUND]]
    apart = np.linalg.norm(at - np.concatenate([item.muscles.points[0, span] for span in item.muscles.spans]), axis=1)
    assert apart.max() < 0.01


def test_words_over_a_picture_stay_within_it(files: dict[str, Path]) -> None:
    items = items_of([files["trial"], files["motion"]])
    lines = wrapped_head(compared(items)[1], 6.0).splitlines()
    assert max(map(len, lines)) <= 78 and lines[-1].startswith("surface RMS")

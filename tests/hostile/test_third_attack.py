"""What a third and a fourth attack have found: files as laboratories have them, and names that become files."""

import json
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fabdesign.clouds.cloud_file import read_geometry
from fabdesign.clouds.measured_points import require_room
from fabdesign.clouds.recording import Sensor, read_recording, write_recording
from fabdesign.clouds.target_file import read_target
from fabdesign.errors import InputError, InputNote
from fabdesign.files.design_file import write_design
from fabdesign.files.law_tables import read_membrane_curve
from fabdesign.files.measurement_set import NewTrial, read_set, write_set
from fabdesign.files.model_file import read_model
from fabdesign.files.pressure_file import constant_program, read_csv
from fabdesign.files.trial_file import TrialData
from fabdesign.formats.toml_file import file_stem
from fabdesign.nouns.catalogue import build
from fabdesign.study_files.study_targets import TargetFile
from studies.check.files import inspect
from studies.prediction.predict import folders_of
from studies.report import result_folders
from studies.report.result_folders import EvaluationsTable, write_optuna_store

OPERATIONAL = sqlite3.OperationalError
POINTS = np.random.default_rng(3).uniform([-0.1, -0.2, 0.0], [0.1, 0.0, 0.02], (12, 3)).round(4)


def text(rows: np.ndarray, between: str = " ") -> str:
    return "".join(between.join(f"{value:g}" for value in row) + "\n" for row in rows)


def numbered(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.arange(len(rows)), rows])


@pytest.mark.parametrize(
    ("name", "content", "unit"),
    [
        ("savetxt.xyz", "# z y x\n" + text(POINTS[:, ::-1]), None),
        ("savetxt.csv", "# z,y,x\n" + text(POINTS[:, ::-1], ","), None),
        ("blanks_above_commas.csv", "# z y x\n" + text(POINTS[:, ::-1], ","), None),
        ("unit.txt", "# made today\n# x[mm] y[mm] z[mm]\n" + text(1e3 * POINTS), "mm"),
        ("unit_behind.txt", "# x y z (mm)\n" + text(1e3 * POINTS), "mm"),
        ("words.xyz", "# x y z of the cloth\n" + text(POINTS), None),
        ("frame_of_one.csv", "frame,x,y,z\n" + "".join(f"7,{line}\n" for line in text(POINTS, ",").split()), None),
    ],
)
def test_comments_that_name_the_columns_are_their_header(
    name: str, content: str, unit: str | None, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(content)
    cloud = read_geometry(tmp_path / name)
    assert cloud.unit == unit
    np.testing.assert_allclose(cloud.points, POINTS * (1e3 if unit == "mm" else 1), rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("numbered.xyz", text(numbered(POINTS)), "its first column counts the points"),
        ("numbered.pts", "12\n" + text(np.column_stack([numbered(POINTS), POINTS])), "counts the points"),
        ("frames.csv", "frame,x,y,z\n" + text(numbered(POINTS), ","), "several instants (frame)"),
        ("marker.csv", "time_s,x,y,z\n" + text(numbered(POINTS), ","), "several instants (time_s)"),
        ("units.csv", "x_m,y_m,z_m\nmm,mm,mm\n" + text(POINTS, ","), "names other units than the header"),
        ("thousands.csv", "x;y;z\n-10.000;0;5.250\n10.000;20.000;0\n", "may be -10000 or -10.000"),
    ],
)
def test_a_cloud_that_could_mean_two_things_is_refused(name: str, content: str, why: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as refused:
        read_geometry(tmp_path / name)
    assert why in str(refused.value)


def test_a_frame_of_a_file_without_frames_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text(POINTS))
    with pytest.raises(InputError, match="frame = 3 of a file that has no frames"):
        read_target(TargetFile(tmp_path / "a.xyz", frame=3), build("cross").fabric)


@pytest.mark.parametrize("name", ["scale", "unit"])
def test_points_with_a_scale_of_their_own_are_refused(name: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=(1e4 * POINTS).astype("i2"), **{name: 1e-4 if name == "scale" else "mm"})
    with pytest.raises(InputError, match=f"has {name} beside points"):
        read_geometry(tmp_path / "a.npz")


def test_integers_that_wrapped_on_one_axis_are_refused() -> None:
    z = np.random.default_rng(0).integers(-20, 20, 400)
    points = np.column_stack([np.arange(400), np.arange(400), z])
    with pytest.raises(InputError, match="fill the range of uint16, 0 to 65535, in z"):
        require_room(np.vstack([points, [[0, 0, -1]]]).astype(np.uint16), "a.npy")
    require_room((points + [0, 0, 20]).astype(np.uint16), "a.npy")


U_SHAPE = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]])  # 7 of 9 squares


@pytest.mark.parametrize("kind", ["ply", "obj", "off"])
def test_a_face_with_a_corner_that_points_inwards_is_refused(kind: str, tmp_path: Path) -> None:
    """A fan would cover 11 squares. The hull of the same corners is read."""

    def write(places: np.ndarray) -> Path:
        vertices = text(np.column_stack([places, np.zeros(len(places))]))
        count, face = len(places), " ".join(map(str, range(len(places))))
        header = (
            f"ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\n"
        )
        path = tmp_path / f"a.{kind}"
        path.write_text(
            {
                "ply": f"{header}element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}",
                "obj": "".join(f"v {line}\n" for line in vertices.splitlines()),
                "off": f"OFF\n{count} 1 0\n{vertices}",
            }[kind]
            + ("f " + " ".join(str(k + 1) for k in range(count)) if kind == "obj" else f"{count} {face}")
            + "\n"
        )
        return path

    with pytest.raises(InputError, match="a face of 8 corners has one that points inwards"):
        read_geometry(write(U_SHAPE))
    assert len(read_geometry(write(U_SHAPE[[0, 1, 2, 7]])).triangles) == 2


def test_a_fan_beside_triangles_in_a_gltf_is_refused(tmp_path: Path) -> None:
    """trimesh leaves it out in silence."""
    triangles = {"attributes": {"POSITION": 0}}
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [triangles, {**triangles, "mode": 6}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," + "AAAA" * 12}],
    }  # fmt: skip
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(InputError, match="primitives of mode 6, such as triangle fans"):
        read_geometry(tmp_path / "a.gltf")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("time_s;channel_0 [Pa]\n0;100.000\n1;150.000\n2;0\n", "'100.000' may be 100000 or 100.000"),
        ("time_s,p_abs [kPa]\n0,101\n1,301\n", "p_abs [kPa] is an absolute pressure"),
        ("time_s,Absolutdruck 0 [bar]\n0,1\n1,3\n", "is an absolute pressure"),
        ("time_s,p1 [kPa],p0 [kPa]\n0,1,2\n", "do not rise one by one"),
        ("time_s,muscle 3 [kPa],muscle 1 [kPa]\n0,1,2\n", "do not rise one by one"),
        ("time_s,Druck abs. [kPa]\n0,101\n1,301\n", "is an absolute pressure"),
        ("time_s,vacuum_0 [kPa]\n0,50\n1,20\n", "is a vacuum"),
        ("time_s,p_set [kPa],p_meas [kPa]\n0,100,99\n1,200,180\n", "may be of one channel"),
    ],
)
def test_pressures_that_could_mean_two_things_are_refused(content: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(content)
    with pytest.raises(InputError) as refused:
        read_csv(tmp_path / "p.csv")
    assert why in str(refused.value)


@pytest.mark.parametrize(
    ("content", "first_row"),
    [
        ("time_s;channel_0 [mbar]\n0;0.500\n1;1.250\n2;2\n", [50.0]),
        ("time_s,p1 [kPa],p2 [kPa]\n0,1,2\n", [1e3, 2e3]),
        ("time_s,absorbed pressure [kPa]\n0,1\n", [1e3]),
    ],
)
def test_pressures_like_these_are_read(content: str, first_row: list[float], tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(content)
    assert read_csv(tmp_path / "p.csv").pressure[0].tolist() == first_row


def test_a_strain_in_percent_without_its_unit_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text("strain,tension_n_per_m\n0,0\n10,52\n")
    with pytest.raises(InputError, match=r"strain = 10; expected at most 5 \(strain \[%\] is a percentage\)"):
        read_membrane_curve(tmp_path / "c.csv")


@pytest.mark.parametrize(
    "name", ["../../x", "a/b", "a\\b", ".", "..", ".fabdesign", "", "a\nb", "x" * 300, "ü" * 200, "a_b", "50 %: ä"]
)
def test_a_name_is_one_file(name: str) -> None:
    stem = file_stem(name)
    assert Path(stem).name == stem and not stem.startswith(".") and "\\" not in stem and len(stem.encode()) < 140
    assert (stem == name) == (name in ("a_b", "50 %: ä"))
    assert file_stem("a/b") != file_stem("a_b")


def test_a_design_leads_to_no_other_folder(tmp_path: Path) -> None:
    """A design's name once named a file outside of the set, and replaced one there."""
    name, victim = "../../../victim", tmp_path / "victim.toml"
    victim.write_text("mine")
    design = replace(build("cross", muscles=2), name=name)
    cloud = np.random.default_rng(1).uniform([-0.1, -0.2, 0.0], [0.1, 0.0, 0.01], (50, 3))
    data = TrialData(np.array([0.1, 0.2]), np.full((2, 2), 3e5), (cloud, cloud))
    write_set(tmp_path / "a" / "set", {name: design}, [NewTrial("../../../t", name, 0, "fit", data)], name="x")
    assert victim.read_text() == "mine" and {file.name for file in tmp_path.iterdir()} == {"a", "victim.toml"}
    (trial,) = read_set(tmp_path / "a" / "set").trials
    assert trial.design_name == name and len(trial.load().frames) == 2


def test_a_first_frame_long_after_rest_is_warned_of(tmp_path: Path) -> None:
    cloud = np.random.default_rng(1).uniform([-0.1, -0.2, 0.0], [0.1, 0.0, 0.01], (50, 3))
    for begins, warned in ((0.1, False), (2.1, True)):
        data = TrialData(begins + np.arange(3) / 10, np.full((3, 2), 3e5), (cloud, cloud, cloud))
        design = build("cross", muscles=2)
        write_set(tmp_path / str(begins), {"cross": design}, [NewTrial("t", "cross", 0, "fit", data)], name="x")
        late = [line for line in inspect(tmp_path / str(begins)).warnings if "does time begin at rest?" in line]
        assert bool(late) == warned


@pytest.mark.parametrize("name", ["..", ".fabdesign", "a/b"])
def test_a_set_whose_name_is_no_folder_is_refused_before_its_motions(name: str) -> None:
    with pytest.raises(InputError, match="good for a folder"):
        folders_of([("plain", ()), (name, ())])


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two frames of one camera."""
    clouds = [{"left": POINTS + [0, 0, 1 + k / 100]} for k in range(2)]
    design, program = build("cross", muscles=2), constant_program([1e5, 0.0], 0.3)
    write_recording(tmp_path, design, program, np.array([0.1, 0.2]), [Sensor("left", np.eye(4))], clouds, clouds[0])
    return tmp_path / "recording.toml"


def test_a_pose_of_a_camera_that_is_transposed_is_refused(recording: Path) -> None:
    assert not inspect(recording).problems
    content = recording.read_text()
    for last_row, likely in (("[0.1, 0.0, 0.0, 1.0]", " (is it transposed?)"), ("[0.0, 0.0, 0.0, 2.0]", "")):
        recording.write_text(content.replace("[0.0, 0.0, 0.0, 1.0]", last_row))
        with pytest.raises(InputError) as refused:
            read_recording(recording)
        assert str(refused.value).endswith(f"expected 0, 0, 0, 1 as the last row{likely}")


def test_a_cloud_that_repeats_the_one_before_is_said(recording: Path) -> None:
    frames = recording.parent / "frames"
    shutil.copyfile(frames / "0000" / "left.ply", frames / "0001" / "left.ply")
    (line,) = inspect(recording).notes
    assert "repeats the cloud of frame 0" in line
    shutil.copytree(frames / "0000", frames / "0005")
    assert any("has frames to 5, and 2 times" in line for line in inspect(recording).notes)


def test_an_effect_that_stands_twice_is_refused(tmp_path: Path) -> None:
    effect = '[[effects]]\nname = "filling_lag"\n[effects.parameters.fill]\nvalue = 0.1\nunit = "s"\n'
    (tmp_path / "m.toml").write_text('format = "fabdesign.model/1"\n' + 2 * effect)
    with pytest.raises(InputError, match="filling_lag stands twice"):
        read_model(tmp_path / "m.toml")


def test_a_full_disk_under_an_optuna_store_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("optuna", reason="the extra optuna is not installed")

    def small(path: Path) -> sqlite3.Connection:
        connection = sqlite3.connect(path)
        connection.execute("pragma max_page_count = 4")
        return connection

    monkeypatch.setattr(result_folders, "sqlite3", SimpleNamespace(connect=small, OperationalError=OPERATIONAL))
    table = EvaluationsTable(["part", "evaluation", "seconds", "stage", "objective_mm", "diverged"], [])
    with pytest.raises(InputError, match=r"cannot be written \(database or disk is full\)"):
        write_optuna_store(table, tmp_path / "t.db", "x")


# what a fourth attack has found


def bent(count: int) -> np.ndarray:
    """(count, 20, 3) m: a cloth that bends further from frame to frame, by the same points."""
    rows = np.random.default_rng(4).uniform([-0.1, -0.2, 0.0], [0.1, 0.0, 0.0], (20, 3))
    depth = np.linspace(0.0, 0.08, count)[:, None] * (rows[:, 1] / 0.2) ** 2
    return np.stack([np.broadcast_to(rows[:, 0], depth.shape), np.broadcast_to(rows[:, 1], depth.shape), depth], axis=2)


def depth_image() -> np.ndarray:
    """(24, 32, 3) m: a bent cloth as a camera at 0.6 m sees it, turned in its plane, with pixels that saw nothing."""
    v, u = np.meshgrid(np.linspace(-0.2, 0.2, 24), np.linspace(-0.25, 0.25, 32), indexing="ij")
    z = 0.6 + 0.08 * np.sin(3 * v + u)
    cosine, sine = np.cos(0.6), np.sin(0.6)
    image = np.stack([(cosine * u - sine * v) * z, (sine * u + cosine * v) * z, z], axis=2)
    image[np.random.default_rng(0).random((24, 32)) < 0.2] = np.nan
    image[0] = 0.0
    return image


@pytest.mark.parametrize("frames", [bent(6), bent(40), bent(6).swapaxes(0, 1), bent(1).repeat(5, axis=0)])
def test_frames_in_an_npy_are_no_depth_image(frames: np.ndarray, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", frames)
    with pytest.raises(InputError, match=r"lie on each other; .*are they frames\?"):
        read_geometry(tmp_path / "a.npy")


def test_a_depth_image_is_read(tmp_path: Path) -> None:
    image = depth_image()
    for name, each in (("a", image), ("one_row", bent(1)), ("metres", image + [0.0, 0.5, 3.0])):
        np.save(tmp_path / f"{name}.npy", each)
        assert len(read_geometry(tmp_path / f"{name}.npy").points) > 0.7 * each.size / 3


@pytest.mark.parametrize("odd", [np.full((24, 32, 3), 0.3), np.where(np.arange(3) == 1, 1e200, depth_image())])
def test_an_image_whose_points_are_none_is_refused(odd: np.ndarray, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", odd)
    with pytest.raises(InputError, match=r"a\.npy: "):
        read_geometry(tmp_path / "a.npy")


def test_a_comment_without_a_word_stands_above_points(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("#\n0 0 0\n0.1 0 0\n0 -0.1 0\n")
    assert len(read_geometry(tmp_path / "a.xyz").points) == 3


def write_numbered(folder: Path, kind: str, name: str, frames: np.ndarray) -> Path:
    """A cloud whose points have a number each, under `name`."""
    path, rows = folder / f"a.{kind}", np.column_stack([POINTS, frames])
    if kind == "npz":
        np.savez(path, points=POINTS, **{name: frames})
        return path
    ply = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n"
    ply += "".join(f"property float {each}\n" for each in ("x", "y", "z", name)) + "end_header\n"
    pcd = f"FIELDS x y z {name}\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH {len(rows)}\nHEIGHT 1\nDATA ascii\n"
    heads = {"ply": ply, "pcd": pcd, "csv": f"x,y,z,{name}\n"}
    path.write_text(heads[kind] + text(rows, "," if kind == "csv" else " "))
    return path


@pytest.mark.parametrize(
    ("kind", "name"),
    [("npz", "time"), ("npz", "frame_id"), ("ply", "frame"), ("pcd", "time"), ("csv", "Frame #"), ("csv", "Bild Nr")],
)
def test_points_of_several_frames_are_refused(kind: str, name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="its points are of several instants"):
        read_geometry(write_numbered(tmp_path, kind, name, np.arange(12) // 6))
    assert len(read_geometry(write_numbered(tmp_path, kind, name, np.full(12, 7))).points) == 12


def test_comments_that_part_frames_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("# frame 0\n" + text(POINTS) + "# frame 1\n" + text(POINTS + 0.1))
    with pytest.raises(InputError, match="comments part several frames"):
        read_geometry(tmp_path / "a.xyz")
    (tmp_path / "a.xyz").write_text("# frame 0\n# made today\n" + text(POINTS))
    assert len(read_geometry(tmp_path / "a.xyz").points) == 12


def test_a_stretch_that_is_called_a_strain_is_said(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text("strain,tension_n_per_m\n1.0,0\n1.1,52\n")
    with pytest.warns(InputNote, match="begins at 1; expected about 0"):
        read_membrane_curve(tmp_path / "c.csv")


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("seed = 1", "seed = 1\nstart_pressures = [2, 2]", "the largest pressure is 2 kPa"),
        ("[0, 300]", "[0, 3]", "the largest pressure is 3 kPa"),
        ("[0, 300]", "[0, 300]\nspacing = 6", "spacing = 6; expected less than the cloth, in m"),
        ('file = "a.xyz"', 'file = "a.xyz"\nrotation = [0, 3.1416, 0]', "is read in degrees (is it in radians?)"),
        ('file = "a.xyz"', "[target.tube]\nradius = 64", "radius = 64; expected a number from 0.005 to 10"),
    ],
)
def test_a_study_in_other_units_is_said(old: str, new: str, line: str, tmp_path: Path) -> None:
    write_design(build("cross", muscles=2), tmp_path / "d.toml")
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 20), np.linspace(-0.2, 0.0, 20))
    (tmp_path / "a.xyz").write_text(text(np.column_stack([u.ravel(), v.ravel(), 0.02 + 0 * u.ravel()])))
    content = (
        'kind = "optimize"\ndesign = "d.toml"\nseed = 1\n[target]\nfile = "a.xyz"\n[limits]\npressure = [0, 300]\n'
    )
    (tmp_path / "s.toml").write_text(content)
    assert not inspect(tmp_path / "s.toml").notes
    assert old in content
    (tmp_path / "s.toml").write_text(content.replace(old, new))
    findings = inspect(tmp_path / "s.toml")
    assert any(line in each for each in (*findings.problems, *findings.notes))


def test_a_sweep_of_pressures_in_bar_is_said(tmp_path: Path) -> None:
    write_design(build("cross", muscles=2), tmp_path / "d.toml")
    content = 'kind = "sensitivity"\ndesign = "d.toml"\n[parameters.pressure.0]\nlow = 1\nhigh = '
    for high, count in ((3, 1), (300, 0)):
        (tmp_path / "s.toml").write_text(f"{content}{high}\n")
        assert len(inspect(tmp_path / "s.toml").notes) == count


def test_gravity_that_pulls_upwards_is_warned_of(tmp_path: Path) -> None:
    design = build("cross", muscles=2)
    for upwards, count in ((9.81, 1), (-9.81, 0)):
        fabric = replace(design.fabric, gravity=(0.0, upwards, 0.0))
        write_design(replace(design, fabric=fabric), tmp_path / "d.toml")
        lines = inspect(tmp_path / "d.toml").warnings
        assert sum("where it is held (its sign?)" in line for line in lines) == count
        (tmp_path / "d.toml").unlink()


def test_frames_and_trials_that_repeat_are_warned_of(tmp_path: Path) -> None:
    rng, design = np.random.default_rng(1), build("cross", muscles=2)
    a, b, c = (rng.uniform([-0.1, -0.2, 0.0], [0.1, 0.0, 0.01], (50, 3)) for _ in range(3))
    trials = [
        NewTrial(name, "cross", order, role, TrialData(np.arange(1, 4) / 10, np.full((3, 2), 3e5), clouds))
        for order, (name, role, clouds) in enumerate(
            [("sound", "fit", (a, b, c)), ("stopped", "fit", (a, b, b)), ("again", "test", (a, b, c))]
        )
    ]
    write_set(tmp_path / "set", {"cross": design}, trials, name="x")
    lines = [line for line in inspect(tmp_path / "set").warnings if ".npz: " in line]
    assert len(lines) == 2
    assert "stopped.npz: 1 of 3 frames repeat the one before" in lines[0]
    assert "again.npz: has the frames of" in lines[1] and "sound.npz" in lines[1]


def test_a_trial_half_as_large_again_as_its_cloth_is_refused(tmp_path: Path) -> None:
    cloud = np.random.default_rng(1).uniform([-0.1, -0.2, 0.0], [0.1, 0.0, 0.01], (200, 3))
    for scale, sound in ((1.0, True), (1.5, False)):
        data = TrialData(np.arange(1, 3) / 10, np.full((2, 2), 3e5), (scale * cloud, scale * cloud[::-1]))
        folder = tmp_path / str(scale)
        write_set(folder, {"cross": build("cross", muscles=2)}, [NewTrial("t", "cross", 0, "fit", data)], name="x")
        problems = inspect(folder).problems
        assert not problems if sound else "mm across; expected the cloth's diagonal, 283 mm" in problems[0]


@pytest.mark.parametrize(
    ("parameter", "covariance", "line"),
    [
        ("interval90 = [-0.05, 0.05]", "bending", "factor = 1.08 lies outside its interval90, -0.05 to 0.05"),
        ("interval90 = [1.0, 1.2]", "bendin", "[covariance] names bendin"),
        ("interval90 = [1.0, 1.2]", "bending", ""),
    ],
)
def test_a_model_that_contradicts_itself_is_warned_of(
    parameter: str, covariance: str, line: str, tmp_path: Path
) -> None:
    content = f'format = "fabdesign.model/1"\n[parameters.bending]\nfactor = 1.08\n{parameter}\n'
    (tmp_path / "m.toml").write_text(f'{content}[covariance]\nnames = ["{covariance}"]\nmatrix = [[0.01]]\n')
    warnings = inspect(tmp_path / "m.toml").warnings
    assert line in warnings[0] if line else not warnings


def test_a_recording_that_contradicts_itself_is_said(recording: Path) -> None:
    content, frames, program = recording.read_text(), recording.parent / "frames", recording.parent / "pressure.csv"
    recording.write_text(content.replace("times =", "frame_rate = 30\ntimes ="))
    assert any("frame_rate = 30; times counts" in line for line in inspect(recording).notes)
    recording.write_text(content.replace("[0.1, 0.2]", "[1.7e9, 1700000001.0]"))
    with pytest.raises(InputError, match=r"times go to .*expected seconds after rest, 3600 at most"):
        read_recording(recording)
    pose = "[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]"
    recording.write_text(f'{content}\n[[sensors]]\nname = "right"\ncamera_to_world = {pose}\n')
    for folder in frames.iterdir():
        shutil.copyfile(folder / "left.ply", folder / "right.ply")
    shutil.copytree(recording.parent / "reference", recording.parent / "old")
    shutil.copyfile(recording.parent / "old" / "left.ply", recording.parent / "reference" / "right.ply")
    assert (
        sum("right.ply: repeats the cloud of frame" in line and "of left" in line for line in inspect(recording).notes)
        == 2
    )
    program.write_text("time_s,channel_0,channel_1\n0,2,0\n0.01,2,0\n")
    findings = inspect(recording)
    assert any("ends at 0.02 s, the frames at 0.2 s" in line for line in findings.notes)
    assert any("largest pressure = 2 kPa" in line and "in bar?" in line for line in findings.warnings)
    np.savez(frames / "0000" / "left.npz", points=POINTS)
    assert any("left.ply and" in line for line in inspect(recording).problems)

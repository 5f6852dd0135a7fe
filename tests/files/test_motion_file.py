"""Motions as files, their triangles, meshes of their frames, and the shape at rest."""

from pathlib import Path

import numpy as np
import pytest

from fabdesign.clouds.ply import read_ply
from fabdesign.errors import InputError
from fabdesign.files.motion_file import read_motion, write_motion
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.surface import Surface, face_triangles
from fabdesign.nouns.forward import Case
from tests.command_line import Run
from tests.sim_designs import laced

TIME = np.array([0.0, 0.1])
MOTION = np.random.default_rng(3).normal(0, 0.1, (2, 2 * 5 * 5, 3)).astype(np.float32)


def changed(path: Path, **arrays: np.ndarray | None) -> Path:
    with np.load(path) as archive:
        kept = {**archive, **arrays}
    other = path.with_name("changed.npz")
    np.savez(other, **{name: array for name, array in kept.items() if array is not None})
    return other


def test_motion_reads_back_and_says_its_triangles(tmp_path: Path) -> None:
    write_motion(tmp_path / "m.npz", TIME, MOTION)
    with np.load(tmp_path / "m.npz") as archive:
        assert archive["triangles"].dtype == np.int32
        assert np.array_equal(archive["triangles"], Surface.of_faces(MOTION[0]).triangles)
    for path in (tmp_path / "m.npz", changed(tmp_path / "m.npz", triangles=None)):
        motion = read_motion(path)
        assert np.array_equal(motion.points, MOTION)
        assert np.array_equal(motion.time, TIME)
        assert motion.triangles is not None
        assert np.array_equal(motion.triangles, face_triangles(5, 5))


def test_points_that_are_no_square_faces_have_no_triangles(tmp_path: Path) -> None:
    write_motion(tmp_path / "m.npz", TIME, MOTION)
    assert read_motion(changed(tmp_path / "m.npz", points=MOTION[:, :40], triangles=None)).triangles is None


@pytest.mark.parametrize(
    ("arrays", "problem"),
    [
        ({"points": None}, "no array points"),
        ({"points": MOTION[0]}, r"expected \(frames, points, 3\)"),
        ({"points": MOTION * np.nan}, "2 of 2 frames are not finite"),
        ({"points": np.full((2, 50, 3), 1e299)}, r"up to 1e\+299 m away; expected metres, at most 100"),
        ({"points": MOTION * 1e6}, "m away; expected metres, at most 100"),
        ({"time": TIME * 400_000}, r"time spans 40000 s; expected at most 3600 s \(is it in ms\?\)"),
        ({"time": np.zeros(3)}, r"expected \(2,\)"),
        ({"time": np.zeros(2)}, "does not rise"),
        ({"triangles": np.full((1, 3), 50)}, "name point 50; expected 0 to 49"),
        ({"triangles": np.zeros((4, 4), int)}, r"expected \(m, 3\)"),
    ],
)
def test_unsound_motion(arrays: dict, problem: str, tmp_path: Path) -> None:
    write_motion(tmp_path / "m.npz", TIME, MOTION)
    with pytest.raises(InputError, match=problem):
        read_motion(changed(tmp_path / "m.npz", **arrays))


@pytest.mark.usefixtures("hanging")
@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_meshes_of_a_motion_read_back(suffix: str, run: Run, folder: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    out, name = folder / "out.npz", folder / "meshes" / f"m.{suffix}"
    shown = ("simulate", folder / "bare.toml", "--duration", 0.05, "--mesh", name, "-o", out)
    code, _, _ = run(*shown)
    assert code == 0
    files = sorted(name.parent.iterdir())
    assert [file.name for file in files] == [f"m_{k:04d}.{suffix}" for k in range(4)]
    motion = read_motion(out)
    for file, points in zip(files, motion.points, strict=True):
        mesh = trimesh.load(file, process=False)
        assert np.abs(mesh.vertices - points).max() <= 1e-6  # m
        assert np.array_equal(mesh.faces, motion.triangles)


def test_equilibrium_is_the_simulators(run: Run, folder: Path) -> None:
    from fabdesign.files.design_file import write_design
    from sim import Simulator

    design = laced("vertical", 2)
    write_design(design, folder / "laced.toml")
    options = ("--pressures", "300,100", "--equilibrium", "--grid", 21, "--mesh", folder / "rest.ply")
    code, out, _ = run("simulate", folder / "laced.toml", *options, "-o", folder / "rest.npz")
    assert (code, out) == (0, f"{folder / 'rest.npz'}: the shape at rest, 3362 points\n")
    case = Case(design, constant_program([300e3, 100e3]))
    expected = Simulator(21).equilibria([case])[0]
    motion = read_motion(folder / "rest.npz")
    assert np.array_equal(motion.points, expected[None])
    assert motion.time.tolist() == [case.program.duration]
    mesh = read_ply(folder / "rest.ply")
    assert np.array_equal(mesh.points, expected)
    assert np.array_equal(mesh.triangles, motion.triangles)

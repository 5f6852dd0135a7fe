"""Targets as people have them: in any file, unit and frame the same shape, or refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.clouds.ply import write_ply
from fabdesign.clouds.target_file import MOST, AsTarget, read_target
from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.trial_file import read_trial
from fabdesign.geometry.distances import chamfer
from fabdesign.geometry.hung_cloth import misplaced
from fabdesign.geometry.placement import UNITS, Placement, fit_placement
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.catalogue import build
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from studies.layout_search.target import load_target, target_errors
from studies.layouts.run import run_study
from studies.studio.opening import open_files
from studies.view.items import items_of
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line
from tests.meshes import sheet, write_obj, write_stl, write_xyz
from tests.sheets import rolled_sheet

DESIGN = build("vertical")
FABRIC = DESIGN.fabric
POINTS, TRIANGLES = sheet(20, 20, roll=30.0)
CAD = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # x stays, y becomes z, z becomes -y


def points_of(target: TargetFile) -> NDArray[np.float64]:
    return read_target(target, FABRIC).points


@pytest.mark.parametrize("kind", ["ply", "obj", "stl", "xyz", "csv", "npz"])
def test_a_study_runs_on_every_kind_of_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setattr("fabdesign.clouds.target_file.POINTS", 400)  # every distance costs less
    path, millimetres = tmp_path / f"target.{kind}", 1e3 * POINTS
    if kind == "npz":
        np.savez(path, points=millimetres)
    elif kind in ("xyz", "csv"):
        write_xyz(path, millimetres, mark="," if kind == "csv" else " ")
    else:
        {"ply": write_ply, "obj": write_obj, "stl": write_stl}[kind](path, millimetres, TRIANGLES)
    study = Study("any", DESIGN, (TargetFile(path, unit="mm"),), limits=StudyLimits(evaluations=8))
    run_study(study, tmp_path / "out", forward=AnalyticCloth())
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["targets"] == [f"target.{kind}, in mm"]
    assert result["surface_floor"] < 1e-6 < result["surface_rms"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "the target has no noise" in page
    assert "sensor's noise" not in page
    assert "measured point" not in page


def test_the_rolled_sheet_is_the_same_in_every_unit_and_frame(data: Path) -> None:
    folder = data / "targets"
    metres = points_of(TargetFile(folder / "rolled_sheet.stl"))
    millimetres = points_of(TargetFile(folder / "rolled_sheet_mm.stl", unit="mm"))
    placed = points_of(TargetFile(folder / "rolled_sheet_cad_frame.stl", unit="mm", place="fit"))
    np.testing.assert_allclose(millimetres, metres, atol=1e-6)
    assert chamfer(placed, metres) < 1e-5  # one seed draws the same places, but for the files' rounding
    given = replace(TargetFile(folder / "rolled_sheet_cad_frame.stl"), unit="mm", rotation=(-90.0, 0.0, 0.0))
    np.testing.assert_allclose(points_of(replace(given, translation=(-0.1, -0.3, 0.0))), placed, atol=1e-9)


@pytest.mark.parametrize("unit", UNITS)
def test_a_mesh_in_any_unit_and_a_cad_frame_is_brought_back(tmp_path: Path, unit: str) -> None:
    moved = (POINTS @ CAD.T + [0.1, 0.0, 0.3]) / UNITS[unit]
    path = write_obj(tmp_path / "cad.obj", moved, TRIANGLES)
    reference = points_of(TargetFile(write_obj(tmp_path / "own.obj", POINTS, TRIANGLES)))
    fitted = read_target(TargetFile(path, unit=unit, place="fit"), FABRIC)
    np.testing.assert_allclose(fitted.points, reference, atol=1e-6)
    assert fitted.placement.rotation == (-90.0, 0.0, 0.0)
    assert fitted.turned_over is not None
    np.testing.assert_allclose(fitted.turned_over.apply(moved), POINTS * [-1, 1, -1], atol=1e-6)


@settings(max_examples=24)
@given(
    rotation=st.tuples(*[st.sampled_from([-90.0, 0.0, 90.0, 180.0])] * 3),
    shift=st.tuples(*[st.floats(-2, 2)] * 3),
    factor=st.sampled_from(list(UNITS.values())),
)
def test_a_fit_undoes_any_exchange_of_axes(
    rotation: tuple[float, float, float], shift: tuple[float, float, float], factor: float
) -> None:
    file = (Rotation.from_euler("xyz", rotation, degrees=True).apply(POINTS) + shift) / factor
    fit = fit_placement(file, FABRIC, factor=factor, drawn=False)
    assert fit.rival is None
    assert fit.turned_over is not None
    placed = [placement.apply(file) for placement in (fit.placement, fit.turned_over)]
    assert min(np.abs(points - POINTS).max() for points in placed) < 1e-5


def test_a_fit_of_a_noisy_cloud_is_good_to_what_its_sampling_leaves() -> None:
    rng = np.random.default_rng(1)
    cloud = Surface(POINTS, TRIANGLES).sample(3000, rng)[0] + rng.normal(0, 6e-4, (3000, 3))
    turned = Rotation.from_euler("xyz", [90, 0, 20], degrees=True).apply(cloud) + 1.0
    placed = fit_placement(turned, FABRIC).placement.apply(turned)
    assert np.sqrt(np.square(placed - cloud).sum(axis=1).mean()) < 0.002


def test_a_fit_does_not_turn_a_shape_about_its_edge() -> None:
    """Nearer to the hanging cloth, it would hide what the cloth cannot do."""
    leaning = Rotation.from_euler("x", -25, degrees=True).apply(POINTS)
    fit = fit_placement(leaning + [0.02, 0.05, -0.1], FABRIC, drawn=False)
    assert fit.placement.rotation == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(fit.placement.apply(leaning + [0.02, 0.05, -0.1]), leaning, atol=1e-6)


def test_where_edges_are_alike_the_file_says_which(tmp_path: Path) -> None:
    flat, triangles = sheet(20, 20)
    arch = Rotation.from_euler("x", 90, degrees=True).apply(flat)
    path = write_obj(tmp_path / "flat.obj", arch, triangles)
    with pytest.raises(InputError, match=r"two of its edges fit the hung one, .* expected one of them as rotation"):
        points_of(TargetFile(path, place="fit"))
    placed = read_target(TargetFile(path, place="fit", rotation=(-90.0, 0.0, 0.0)), FABRIC)
    assert placed.placement.rotation == (-90.0, 0.0, 0.0)


@pytest.mark.parametrize("size", [(0.24, 0.15), (0.12, 0.3), (0.22, 0.2)])
@pytest.mark.parametrize("bent", [0.0, 30.0, -10.0])
def test_the_edge_as_wide_as_the_cloth_is_hung(size: tuple[float, float], bent: float) -> None:
    """The longer edge is no rival, nor is the opposite one of a shape that is the same upside down."""
    points, triangles = sheet(20, 20, roll=bent)
    points *= [size[0] / 0.2, size[1] / 0.2, 1.0]
    fabric = replace(FABRIC, width=size[0], height=size[1])
    drawn = np.concatenate([points, Surface(points, triangles).sample(3000, np.random.default_rng(0))[0]])
    for turn in ([0, 0, 90], [-90, 0, 0], [90, 0, 90]):
        file = Rotation.from_euler("xyz", turn, degrees=True).apply(drawn) + 0.3
        fit = fit_placement(file, fabric, drawn=False)
        assert fit.rival is None
        assert min(chamfer(fit.placement.apply(file), drawn * mirrored) for mirrored in (1, [-1, 1, -1])) < 6e-3


def test_turns_are_about_fixed_axes_in_order() -> None:
    placed = Placement(0.001, (90.0, 0.0, 90.0), (0.0, 0.0, 0.5)).apply(np.array([[100.0, 0.0, 0.0], [0.0, 0.0, 10.0]]))
    np.testing.assert_allclose(placed, [[0.0, 0.1, 0.5], [0.01, 0.0, 0.5]], atol=1e-12)


@pytest.mark.parametrize(
    ("moved", "message"),
    [
        (1e3 * POINTS, r'across; expected at most 283 mm.* \(is it in mm\? unit = "mm"\)'),
        (POINTS / 0.0254, r'unit = "in"'),
        (
            POINTS + [0, -0.335, 0],
            r'reaches .* expected at most 200 mm \(place = "fit" would bring it onto the cloth\)',
        ),
        (POINTS + [0, 0, -0.06], r'it lies 60.1 mm from where the cloth is held, in the mean; .*place = "fit"'),
        (POINTS[:, [0, 2, 1]], r"degrees off gravity, seen from the held edge"),
        (POINTS @ CAD.T, r'degrees off gravity.* \(place = "fit" would'),
        (POINTS * [1, -1, 1], r"degrees off gravity"),
        (1e3 * POINTS @ CAD.T + 300, r'\(unit = "mm" and place = "fit" would bring it onto the cloth\)'),
        (1e-3 * POINTS, r"mm across; expected a cloth held along 200 mm"),
        (3 * POINTS, r"it is 734 mm across; expected at most 283 mm, the cloth's diagonal$"),
    ],
)
def test_what_no_cloth_could_be_is_refused_with_what_would_do(
    tmp_path: Path, moved: NDArray[np.float64], message: str
) -> None:
    path = write_stl(tmp_path / "t.stl", moved, TRIANGLES)
    with pytest.raises(InputError, match=message) as caught:
        points_of(TargetFile(path))
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_unit_too_small_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'0.2\d\d mm across.* \(is it in m\? unit = "m"\)'):
        points_of(TargetFile(write_stl(tmp_path / "t.stl", POINTS, TRIANGLES), unit="mm"))


def test_unit_and_place_are_options_of_commands_as_keys_of_a_study(run: Run, tmp_path: Path) -> None:
    design, mesh = tmp_path / "cloth.toml", write_stl(tmp_path / "t.stl", 1e3 * POINTS @ CAD.T + 300, TRIANGLES)
    write_design(DESIGN, design)
    placed = read_target(TargetFile(mesh, unit="mm", place="fit"), FABRIC)

    one_line(run("view", mesh, "-o", tmp_path / "v.html"), "expected metres, or --unit")
    fit = ("--unit", "mm", "--place", "fit")
    one_line(run("check", mesh, *fit), "--place fit: needs the cloth; expected a design among the files")
    one_line(run("view", mesh, *fit, "-o", tmp_path / "v.html"), "expected --design with its design file")
    with pytest.raises(InputError, match=r"\(--unit mm and --place fit would bring it onto the cloth\)"):
        open_files([design, mesh], None)
    with pytest.raises(InputError, match=r"\(--place fit would bring it onto the cloth\)"):
        open_files([design, mesh], None, AsTarget("mm"))
    with pytest.raises(InputError, match="--unit, --place or --rotation without a target"):
        open_files([design], None, AsTarget("mm"))

    code, out, _ = run("check", design, mesh, *fit, "--json")
    assert code == 0
    assert json.loads(out)["files"][str(mesh)]["notes"] == [f"{mesh}: lies on the cloth with {placed.placement}"]
    (item,) = items_of([mesh], how=AsTarget("mm", "fit", FABRIC))
    np.testing.assert_allclose(item.frames[0], placed.placement.apply(placed.geometry.points))
    assert item.triangles is not None
    (item,) = items_of([mesh], how=AsTarget("mm"))
    np.testing.assert_allclose(item.frames[0], 1e-3 * placed.geometry.points)
    code, out, err = run("check", design, mesh, "--unit", "mm", "--rotation", "-90,0,0", "--place", "fit", "--json")
    assert code == 0, err
    assert "rotation [-90, 0, 0]" in json.loads(out)["files"][str(mesh)]["notes"][0]
    (item,) = items_of([mesh], how=AsTarget("mm", rotation=(-90.0, 0.0, 0.0)))
    np.testing.assert_allclose(np.ptp(item.frames[0], axis=0), np.ptp(POINTS, axis=0), atol=1e-6)
    one_line(run("check", design, mesh, "--rotation", "90"), "--rotation 90: expected three angles X,Y,Z in degrees")
    flat = Rotation.from_euler("x", 90, degrees=True).apply(sheet(20, 20)[0])
    alike = write_obj(tmp_path / "flat.obj", flat, TRIANGLES)
    shown = run("view", alike, "--place", "fit", "--design", design, "-o", tmp_path / "v.html")
    one_line(shown, "fit the hung one, -90,0,0 or 90,0,90; expected one of them as --rotation")
    (shown,) = open_files([design, mesh], None, AsTarget("mm", "fit")).targets
    np.testing.assert_array_equal(shown.points, placed.points)
    assert shown.file.unit == "mm"  # so a study that is saved says it


def test_frames_of_the_rigs_are_where_a_cloth_can_be(data: Path) -> None:
    for path in sorted(data.glob("rig_*/trials/*[05].npz")):
        for frame in read_trial(path).frames[::15]:
            assert misplaced(frame, FABRIC) is None
            assert misplaced(frame[::40], FABRIC) is None  # sparse


def test_a_trial_says_its_own_unit(data: Path) -> None:
    trial = TargetFile(data / "rig_c/trials/000.npz")
    assert load_target(trial, DESIGN).measured
    with pytest.raises(InputError, match="unit or scale for a trial, which says its own; expected none"):
        points_of(replace(trial, unit="mm"))


def test_floors_have_the_noise_that_a_cloud_shows_and_no_other(tmp_path: Path) -> None:
    model = rolled_sheet(12.0, thickness=FABRIC.thickness)
    drawn = Surface.of_faces(model).sample(3000, np.random.default_rng(0))[0]
    for sigma in (0.0, 5e-4):
        cloud = drawn + np.random.default_rng(1).normal(0, 1, drawn.shape) * sigma
        target = load_target(TargetFile(write_xyz(tmp_path / "cloud.xyz", cloud)), DESIGN)
        errors = target_errors([target], model[None], DESIGN)
        assert target.measured == (sigma > 0)
        assert errors.surface_floor == pytest.approx(sigma, rel=0.1, abs=1e-9)
        assert errors.chamfer == pytest.approx(errors.chamfer_floor, rel=0.02)
    single = Surface(POINTS, TRIANGLES).sample(3000, np.random.default_rng(0))[0]  # one layer is not two with noise
    assert not load_target(TargetFile(write_xyz(tmp_path / "single.xyz", single)), DESIGN).measured


def test_a_dense_scan_is_thinned_and_that_is_said(tmp_path: Path) -> None:
    dense = Surface(POINTS, TRIANGLES).sample(MOST + 500, np.random.default_rng(0))[0]
    np.savez(tmp_path / "scan.npz", points=dense)
    target = load_target(TargetFile(tmp_path / "scan.npz"), DESIGN)
    assert len(target.points) == MOST
    assert target.description == f"scan.npz, {MOST} of its {MOST + 500} points"
    assert chamfer(target.points, dense) < 1e-3

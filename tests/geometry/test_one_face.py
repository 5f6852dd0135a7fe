"""Targets that show one face, or a part of the cloth: distances, slopes, floors, and a study with one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fabdesign.clouds.target_file import read_target
from fabdesign.errors import InputError
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.distances import chamfer
from fabdesign.geometry.metrics import CloudKind, distance_to_faces, trial_errors
from fabdesign.geometry.sensor_noise import NOISE_FREE
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import Study, StudyLimits, read_study
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.objective import Objective, Target
from studies.layout_search.target import load_target
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth

DESIGN = build("vertical")
TRUTH = 1e3 * np.array([320.0, 60.0, 210.0])


def shape(pressures: NDArray[np.float64] = TRUTH) -> NDArray[np.float64]:
    """(2 n, 3) m; a cloth of 2 mm, so that a face is not the other."""
    return AnalyticCloth().equilibria([Case(DESIGN, constant_program(pressures))])[0].astype(float)


def halves(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return points[: len(points) // 2], points[len(points) // 2 :]


@pytest.mark.parametrize("face", [0, 1])
def test_a_face_is_compared_with_that_face(face: int) -> None:
    points, name = shape(), ("front", "back")[face]
    face_points, other = halves(points)[face], halves(points)[1 - face]
    assert Objective([Target(face_points, face=name)]).value(points[None]) == 0.0
    far = Objective([Target(other, face=name)]).value(points[None])
    assert far == pytest.approx(chamfer(other, face_points))
    flat = shape(np.zeros(3))
    assert distance_to_faces(halves(flat)[1 - face], flat, name) == pytest.approx(DESIGN.fabric.thickness, rel=0.01)
    [errors] = [trial_errors([face_points], points[None], NOISE_FREE, CloudKind(face=name), draws=2)]
    assert errors.chamfer == 0.0 and errors.surface_rms < 1e-9
    both = trial_errors([face_points], points[None], NOISE_FREE, draws=2)
    assert both.chamfer_floor < errors.chamfer_floor  # the other face's points are near as well
    assert both.chamfer > 0.5e-3  # but none lies on it


@pytest.mark.parametrize("target", [{"face": "back"}, {"face": "front", "markers": True}, {"face": "front"}])
@pytest.mark.parametrize("measure", ["chamfer", "surface_rms"])
def test_the_slope_is_that_of_the_face(target: dict, measure: str) -> None:
    cloud = np.random.default_rng(3).normal(halves(shape())[target["face"] == "back"], 5e-4)[::2]
    objective = Objective([Target(cloud, **target)], measure=measure)
    at = shape(1e3 * np.array([300.0, 80.0, 200.0]))
    _, slope = objective.gradient(at[None])
    along = shape(1e3 * np.array([305.0, 78.0, 203.0])) - at
    low, high = (objective.gradient((at + by * along)[None])[0] for by in (-0.02, 0.02))
    assert np.sum(slope[0] * along) == pytest.approx((high - low) / 0.04, rel=0.02)


def part_of(folder: Path, *, upper: bool = False) -> Path:
    """A scan of the lower half of the front face, or of the upper one."""
    front = halves(shape())[0].reshape(41, 41, 3)
    rows = front[:21] if upper else front[21:]
    np.save(folder / "part.npy", np.random.default_rng(1).normal(rows.reshape(-1, 3), 3e-4))
    return folder / "part.npy"


def test_a_part_is_taken_where_it_is_said_to_be_one(tmp_path: Path) -> None:
    target = TargetFile(part_of(tmp_path))
    with pytest.raises(InputError, match="expected points along all of that edge"):
        read_target(target, DESIGN.fabric)
    assert len(read_target(replace(target, distances="one way"), DESIGN.fabric).points) == 20 * 41
    small = replace(DESIGN.fabric, width=0.02, height=0.02)
    with pytest.raises(InputError, match="the cloth's diagonal"):
        read_target(replace(target, distances="one way"), small)
    loaded = load_target(replace(target, distances="one way", face="front"), DESIGN)
    assert loaded.markers and loaded.face == "front"
    assert loaded.description.endswith("one way, in place of Chamfer, of the front face")


def test_a_study_finds_the_layout_of_a_part(tmp_path: Path) -> None:
    target = TargetFile(part_of(tmp_path), face="front", distances="one way")
    study = Study("s", DESIGN, (target,), limits=StudyLimits(evaluations=900))
    study_result = run_study(study, tmp_path / "out", forward=AnalyticCloth())
    off = np.linalg.norm(study_result.points[0] - shape(), axis=1)
    assert off.max() < 2e-3  # the upper half too, though nobody showed it: the muscles reach over both
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["chamfer"] < 1.1 * result["chamfer_floor"]


def test_keys_of_a_study(tmp_path: Path) -> None:
    from fabdesign.files.design_file import write_design

    write_design(DESIGN, tmp_path / "d.toml")
    part_of(tmp_path)
    text = 'kind = "optimize"\ndesign = "d.toml"\n[target]\nfile = "part.npy"\n'
    (tmp_path / "s.toml").write_text(text + 'face = "front"\ndistances = "one way"\n')
    [target] = read_study(tmp_path / "s.toml").targets
    assert (target.face, target.distances) == ("front", "one way")
    (tmp_path / "s.toml").write_text(text + 'face = "left"\n')
    with pytest.raises(InputError, match=r"face .*left.*; expected"):
        read_study(tmp_path / "s.toml")

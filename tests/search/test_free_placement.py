"""Targets that may stand anywhere: the motion that is found, distances and slopes with it, and a study with one."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.clouds.target_file import read_target
from fabdesign.errors import InputError
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.placement import onto
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.objective import Objective, Target
from studies.layout_search.target import load_target
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth, WithJacobian

DESIGN = build("vertical")
TURN, SHIFT = Rotation.from_euler("xyz", [20, -35, 15], degrees=True), np.array([0.4, -0.2, 0.7])


def shape(*kpa: float) -> NDArray[np.float64]:
    """(2 n, 3) m."""
    return AnalyticCloth().equilibria([Case(DESIGN, constant_program(1e3 * np.array(kpa)))])[0].astype(float)


def moved(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(TURN.apply(points) + SHIFT)


TRUTH = shape(320, 60, 210)


def test_a_moved_shape_is_brought_back() -> None:
    target = moved(TRUTH)
    motion = onto(TRUTH, target[::3])
    off = np.linalg.norm(motion.of(TRUTH) - target, axis=1)
    assert off.mean() < 1.5e-3  # of points 5 mm apart, of which a sheet's plane decides little
    np.testing.assert_allclose(motion.back(motion.of(TRUTH)), TRUTH, atol=1e-12)
    np.testing.assert_allclose(motion.turn @ motion.turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(motion.turn) == pytest.approx(1.0)


@pytest.mark.parametrize("measure", ["chamfer", "surface_rms"])
def test_only_the_shape_counts(measure: str) -> None:
    cloud = np.random.default_rng(5).normal(TRUTH, 1.5e-3)[::2]  # points that lie on those of the shape would decide
    there, here = Target(moved(cloud), free=True), Target(cloud)
    free, fixed = (Objective([target], measure=measure) for target in (there, here))
    assert Objective([Target(moved(TRUTH)[::2])], measure=measure).value(TRUTH[None]) > 5e-3
    for other in (TRUTH, shape(250, 120, 210)):
        assert free.value(other[None]) < fixed.value(other[None]) + 4e-4
    assert free.value(shape(100, 100, 100)[None]) > free.value(TRUTH[None]) + 5e-4


def test_the_slope_is_that_of_the_shape() -> None:
    rng = np.random.default_rng(2)
    objective = Objective([Target(rng.normal(moved(TRUTH), 5e-4)[::2], free=True)])
    at, other = shape(250, 120, 210), shape(262, 114, 210)
    _, slope = objective.gradient(at[None])
    low, high = (objective.gradient((at + by * (other - at))[None])[0] for by in (-0.5, 0.5))
    # the motion, of few points, is not quite at the minimum of all
    assert np.sum(slope[0] * (other - at)) == pytest.approx(high - low, rel=0.25)


def saved(folder: Path) -> Path:
    np.save(folder / "there.npy", np.random.default_rng(1).normal(moved(TRUTH)[::2], 3e-4))
    return folder / "there.npy"


def test_a_free_target_may_lie_anywhere(tmp_path: Path) -> None:
    target = TargetFile(saved(tmp_path))
    with pytest.raises(InputError, match="from where the cloth is held"):
        read_target(target, DESIGN.fabric)
    assert load_target(TargetFile(target.file, free=True), DESIGN).free
    with pytest.raises(InputError, match="the cloth's diagonal"):
        read_target(TargetFile(target.file, free=True, scale=10.0), DESIGN.fabric)


def test_a_study_finds_the_shape_and_says_how_the_target_was_moved(tmp_path: Path) -> None:
    target = TargetFile(saved(tmp_path), free=True)
    study = Study("s", DESIGN, (target,), limits=StudyLimits(evaluations=300))
    study_result = run_study(study, tmp_path / "out", forward=WithJacobian())
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["chamfer"] < 1.15 * result["chamfer_floor"]
    assert "moved by rotation [" in result["targets"][0]
    # the report shows the target where it was moved: on the cloth
    assert np.linalg.norm(study_result.targets[0].points.mean(axis=0) - study_result.points[0].mean(axis=0)) < 5e-3
    off = np.linalg.norm(study_result.points[0] - TRUTH, axis=1)
    assert np.sqrt(np.mean(off**2)) < 8e-3

"""Regions of a cloth that count more: which places lie in them, distances by their weights, slopes, and a study."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.metrics import CloudKind, distance_to_faces, trial_errors
from fabdesign.geometry.sensor_noise import NOISE_FREE
from fabdesign.geometry.wishes import Region, Weighting
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import Study, StudyLimits, read_study
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.objective import Objective, Target
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth

DESIGN = build("vertical")
SIDE = 41
BOX = ((0.0, 0.15), (0.2, 0.15), (0.2, 0.2), (0.0, 0.2))
LOWER = Weighting((Region(BOX, 6.0),), 0.2, 0.2)


def shape(kpa: list[float]) -> NDArray[np.float64]:
    return AnalyticCloth(SIDE).equilibria([Case(DESIGN, constant_program(1e3 * np.array(kpa)))])[0].astype(float)


def test_places_in_a_polygon_and_on_its_edge_have_its_weight() -> None:
    # an L of 100 mm, its inner corner at (0.05, 0.05), which no box is
    corners = ((0.0, 0.0), (0.1, 0.0), (0.1, 0.05), (0.05, 0.05), (0.05, 0.1), (0.0, 0.1))
    weights = Weighting((Region(corners, 3.0), Region(BOX, 0.5)), 0.2, 0.2).of_points(2 * SIDE * SIDE)
    u, v = np.meshgrid(np.linspace(0, 0.2, SIDE), np.linspace(0, 0.2, SIDE))
    margin = 1e-9
    inside = (u < 0.1 + margin) & (v < 0.1 + margin) & ((u < 0.05 + margin) | (v < 0.05 + margin))
    expected = np.where(v > 0.15 - margin, 0.5, np.where(inside, 3.0, 1.0))
    np.testing.assert_array_equal(weights.reshape(2, SIDE, SIDE), [expected, expected])


def test_distances_are_means_by_the_weights_of_the_cloth() -> None:
    model, rng = shape([200, 100, 0]), np.random.default_rng(1)
    cloud = rng.normal(model[::5], 2e-3)
    weights = LOWER.of_points(len(model))
    apart = np.linalg.norm(cloud[:, None] - model[None], axis=2)
    nearest_weights = weights[apart.argmin(axis=1)]
    expected = np.average(apart.min(axis=1), weights=nearest_weights) + np.average(apart.min(axis=0), weights=weights)
    assert Objective([Target(cloud, weighting=LOWER)]).value(model[None]) == pytest.approx(expected, rel=1e-12)
    errors = trial_errors([cloud], model[None], NOISE_FREE, CloudKind(weighting=LOWER), draws=4)
    assert errors.chamfer == pytest.approx(expected, rel=1e-12)
    bare = trial_errors([cloud], model[None], NOISE_FREE, draws=4)
    assert errors.chamfer_floor == pytest.approx(bare.chamfer_floor, rel=0.1)  # of an even cloth it is the same
    # far off below, on the cloth above: a mean that is the share of the weights below
    markers = np.array([model[SIDE * 3 + 5], model[SIDE * 37 + 5] + [0, 0, 0.004]])
    both = distance_to_faces(markers, model, "front")
    assert distance_to_faces(markers, model, "front", LOWER) == pytest.approx(2 * both * 6 / 7, rel=0.01)


@pytest.mark.parametrize(("measure", "markers"), [("chamfer", False), ("surface_rms", False), ("chamfer", True)])
def test_the_slope_is_that_of_the_weighted_distance(measure: str, markers: bool) -> None:
    model, rng = shape([200, 100, 0]), np.random.default_rng(1)
    # beside the region's edge the weights themselves change with the place, which slopes hold: no points there
    away = np.tile(np.abs(np.repeat(np.arange(SIDE), SIDE) - 30) > 3, 2)
    target = Target(rng.normal(model[away][::3], 2e-3), markers=markers, weighting=LOWER)
    objective = Objective([target], measure=measure)  # type: ignore[arg-type]
    _, slope = objective.gradient(model[None])
    way, h = np.broadcast_to(rng.normal(size=3), model[None].shape), 1e-7
    ahead, behind = (objective.gradient(model[None] + s * h * way)[0] for s in (1, -1))
    assert np.sum(slope * way) == pytest.approx((ahead - behind) / (2 * h), rel=2e-3)


def test_a_search_comes_nearer_where_it_counts(tmp_path: Path) -> None:
    # above and below want different pressures of the one muscle: where it counts decides
    upper, lower = shape([300, 300, 300]), shape([100, 100, 100])
    row = np.repeat(np.arange(SIDE), SIDE)
    mixed = np.where(np.tile(row < 24, 2)[:, None], upper, lower)
    np.savetxt(tmp_path / "target.xyz", mixed[::4])
    off = []
    for weight in (0.05, 20.0):
        region = Weighting((Region(((0.0, 0.0), (0.2, 0.0), (0.2, 0.115), (0.0, 0.115)), weight),), 0.2, 0.2)
        target = TargetFile(tmp_path / "target.xyz", distances="one way", weighting=region)
        study = Study("s", DESIGN, (target,), limits=StudyLimits(evaluations=64))
        result = run_study(study, tmp_path / f"{weight}", forward=AnalyticCloth(21))
        assert result.objective == pytest.approx(result.errors.chamfer)
        off.append(np.linalg.norm((result.points[0] - mixed).reshape(2, SIDE, SIDE, 3)[:, :24], axis=-1).mean())
        description = json.loads((tmp_path / f"{weight}" / "result.json").read_text())["targets"][0]
        assert f"counts {weight:g} times in the box u 0 to 200, v 0 to 115 mm" in description
    assert off[1] < 0.5 * off[0]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("[[target.regions]]\nweight = 2", "either box"),
        ("[[target.regions]]\nbox = [0, 0, 0.1, 0.1]\nweight = 0", "weight = 0; expected a number"),
        ("[[target.regions]]\nbox = [0.1, 0, 0, 0.1]\nweight = 2", "left, upper, right, lower"),
        ("[[target.regions]]\nbox = [0.3, 0, 0.4, 0.1]\nweight = 2", "a part of the cloth"),
        ("[[target.regions]]\npolygon = [[0, 0], [0.1, 0]]\nweight = 2", "three corners"),
        ("free = true\n[[target.regions]]\nbox = [0, 0, 0.1, 0.1]\nweight = 2", "beside regions"),
    ],
)
def test_bad_regions_are_refused_in_a_line(tmp_path: Path, lines: str, message: str) -> None:
    write_design(DESIGN, tmp_path / "d.toml")
    np.savetxt(tmp_path / "target.xyz", shape([0, 0, 0])[::8])
    head = 'format = "fabdesign.study/1"\nkind = "optimize"\ndesign = "d.toml"\n[target]\nfile = "target.xyz"\n'
    (tmp_path / "s.toml").write_text(head + lines + "\n")
    with pytest.raises(InputError, match=message):
        read_study(tmp_path / "s.toml")
    (tmp_path / "s.toml").write_text(head + "[[target.regions]]\nbox = [0, 0.15, 0.2, 0.2]\nweight = 6\n")
    [target] = read_study(tmp_path / "s.toml").targets
    assert target.weighting == replace(LOWER, regions=(Region(BOX, 6.0),))

"""Limits of contraction, channels and air: what they measure, and that a search keeps them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import MuscleChoice, Study, StudyLimits, read_study
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.design_space import DesignSpace, by_muscle, start_of
from optimize.search.margins import Intervals, Limits, LinearContraction, constraint_margins, largest_contraction
from optimize.search.starts import layout_starts
from studies.layouts.result import study_content
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth
from tests.sheets import rolled_sheet

DESIGN = build("vertical")
FULL = np.full((1, 3), 400e3)


def one_muscle(side: str = "front") -> Design:
    first = DESIGN.muscles[0]
    muscle = replace(first, channel=0, side="front" if side == "front" else "back", path=((0.1, 0.0), (0.1, 0.2)))
    return replace(DESIGN, muscles=(muscle,))


@pytest.mark.parametrize("side", ["front", "back"])
def test_a_muscle_on_a_rolled_cloth_contracts_by_its_chords(side: str) -> None:
    # axis on a circle of radius R - e on the inner side, which is the front; of it each interval L spans L / R
    curvature, design = 10.0, one_muscle(side)
    shape = rolled_sheet(curvature, n=41, thickness=design.fabric.thickness)
    radius = 1 / curvature - design.muscle_types["EM20"].axis_offset * (1 if side == "front" else -1)
    length = 0.2 / round(0.2 / design.muscles[0].fixed_point_pitch)  # of an interval, whose ends are points of the grid
    chord = 2 * radius * np.sin(length * curvature / 2)
    assert largest_contraction(design, shape[None]) == pytest.approx(1 - chord / length, abs=1e-9)


def test_the_linear_margins_and_slopes_are_those_of_the_shapes() -> None:
    design, rng = build("basic"), np.random.default_rng(2)
    shape = AnalyticCloth(41).equilibria([Case(design, constant_program(np.full(8, 200e3)))])[0][None].astype(float)
    slopes = rng.normal(0, 1e-3, (3, *shape.shape))
    x = np.array([0.5, 0.4, 0.3])
    linear = LinearContraction(design, 0.2, x, shape, slopes)
    moved = x + [0.1, -0.1, 0.2]
    moved_shape, intervals = shape + np.tensordot(moved - x, slopes, axes=1), Intervals.of(design)
    contraction = intervals.contraction(intervals.chords(moved_shape))[0]
    largest = [0.2 - contraction[intervals.muscle == k].max() for k in range(8)]
    margins, by_x = linear.at(moved)
    np.testing.assert_allclose(margins, largest, atol=1e-12)
    h = 1e-7
    steps = [(linear.at(moved + h * e)[0] - linear.at(moved - h * e)[0]) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(by_x, np.transpose(steps), rtol=1e-4, atol=1e-7)


def target_of(folder: Path, kpa: float = 400.0) -> TargetFile:
    shape = AnalyticCloth(21).equilibria([Case(DESIGN, constant_program(1e3 * np.full(3, kpa)))])[0]
    np.savetxt(folder / "target.xyz", shape[::3])
    return TargetFile(folder / "target.xyz")


def studied(folder: Path, limits: StudyLimits, muscles: MuscleChoice | None = None) -> tuple[Study, dict[str, float]]:
    study = Study("s", DESIGN, (target_of(folder),), limits=limits, muscles=muscles, positions=muscles is not None)
    run_study(study, folder / "out", forward=AnalyticCloth(21))
    result = json.loads((folder / "out" / "result.json").read_text())
    return study, result


def test_a_search_keeps_the_contraction_and_comes_up_against_it(tmp_path: Path) -> None:
    free = largest_contraction(DESIGN, AnalyticCloth(41).equilibria([Case(DESIGN, constant_program(FULL[0]))])[0][None])
    allowed = 0.6 * free
    _, result = studied(tmp_path, StudyLimits(contraction=allowed, evaluations=300))
    assert 0 <= result["constraints"]["contraction"] + 1e-4 < 0.1 * allowed
    assert max(result["pressures_kpa"]) < 390


def test_a_search_keeps_the_air_and_comes_up_against_it(tmp_path: Path) -> None:
    radius = DESIGN.muscle_types["EM20"].outer_diameter / 2
    every = sum(np.pi * radius**2 * muscle.length * 400e3 / 101_325 for muscle in DESIGN.muscles)
    assert constraint_margins(DESIGN, FULL, Limits(air=every))["air"] == pytest.approx(0, abs=1e-12)
    _, result = studied(tmp_path, StudyLimits(air=0.5 * every, evaluations=300))
    assert -1e-6 * every < result["constraints"]["air"] < 0.02 * every
    assert sum(result["pressures_kpa"]) == pytest.approx(600, rel=0.05)
    assert "air at its limit" in result["reach"]["held_by"]


def test_drawn_layouts_keep_the_air_and_the_channels() -> None:
    limits = Limits(air=2e-6, channels=2)
    starts = layout_starts(DESIGN, limits, 2, MuscleChoice(1, 5), number=30, seed=1)
    assert max(len(space.design.muscles) for space, _ in starts) == 5
    for space, x in starts:
        design, pressures = space.decode(x)
        margins = constraint_margins(design, pressures, limits)
        assert design.channels <= 2 and margins["channels"] >= 0
        assert margins["air"] >= -1e-12


def test_muscles_of_the_nearest_pressures_share_a_channel() -> None:
    space = DesignSpace(build("basic", muscles=4), Limits(channels=2), np.zeros((1, 4)), vary_positions=True)
    pressures = 1e3 * np.array([[390.0, 10.0, 400.0, 30.0]])
    start = start_of((space.design.muscles, pressures), space)
    assert start is not None
    muscles, muscle_pressures = by_muscle(start)
    assert [muscle.channel for muscle in muscles] == [0, 1, 0, 1]
    np.testing.assert_allclose(muscle_pressures, 1e3 * np.array([[395.0, 20.0, 395.0, 20.0]]))


def test_a_layout_keeps_its_channels(tmp_path: Path) -> None:
    _, result = studied(tmp_path, StudyLimits(channels=1, evaluations=250), MuscleChoice(3, 3, ("front",)))
    assert {muscle["channel"] for muscle in result["muscles"]} == {0}
    assert len(result["muscles"]) == 3 and len(result["pressures_kpa"]) == 1
    assert result["constraints"]["channels"] == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("contraction = 0.7", "contraction"),
        ("channels = 0", "channels"),
        ("air = -1", "air"),
        ("channels = 2", "expected 3 or more, those of design vertical"),
    ],
)
def test_bad_limits_are_refused(tmp_path: Path, line: str, message: str) -> None:
    target_of(tmp_path)
    write_design(DESIGN, tmp_path / "d.toml")
    head = 'format = "fabdesign.study/1"\nkind = "optimize"\ndesign = "d.toml"\n[target]\nfile = "target.xyz"\n'
    (tmp_path / "s.toml").write_text(f"{head}[limits]\n{line}\n")
    with pytest.raises(InputError, match=message):
        read_study(tmp_path / "s.toml")


def test_a_limit_that_is_absent_is_no_part_of_a_study() -> None:
    # else a search begun before there were such limits would be another one
    study = Study("lim", DESIGN, ())
    names = {"limits.contraction", "limits.channels", "limits.air"}
    assert not names & study_content(study, []).keys()
    limited = replace(study, limits=replace(study.limits, contraction=0.2, channels=2, air=1e-3))
    assert names <= study_content(limited, []).keys()

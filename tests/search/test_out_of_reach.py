"""Of a target that no layout reaches: where it is missed, and what would bring it nearer, by derivatives."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.column import factor
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.design_space import DesignSpace, Limits
from optimize.search.objective import Objective, Target
from optimize.search.slopes import what_helps
from studies.layout_search.target import LoadedTarget
from studies.layouts.reach import missed_at, spaces_by_type
from studies.layouts.run import run_study
from tests.analytic_cloth import WithJacobian

DESIGN = build("vertical")


class Stronger(WithJacobian):
    """With a gain on its muscles' pull, here on their pressure, as the one factor that matters."""

    def _shape(self, case: Case, share: float) -> NDArray[np.float32]:
        program = constant_program(case.program.pressure[-1] * case.factors.get("muscle_gain", 1.0))
        return super()._shape(replace(case, program=program), share)


def cloud(kpa: Sequence[float], design: Design = DESIGN) -> NDArray[np.float64]:
    return Stronger(21).equilibria([Case(design, constant_program(1e3 * np.array(kpa)))])[0].astype(float)


def test_what_helps_is_what_a_changed_forward_model_shows() -> None:
    limits = Limits(pressure=(0.0, 200e3))
    space = DesignSpace(DESIGN, limits, np.full((1, 3), 200e3))
    x = space.encode(DESIGN, space.start_pressures)
    objective, forward = Objective([Target(cloud([230, 230, 230]))]), Stronger(21)
    changes = {f"gain {by:+g}": (factor("muscle_gain"), by) for by in (0.1, -0.1)}
    changes["bending"] = factor("bending"), 0.1
    wider = {"220 kPa": replace(space, limits=replace(limits, pressure=(0.0, 220e3)))}
    before, by_name = what_helps(forward.faces_jacobian, objective, (space, x), changes, wider, {})
    assert forward.asked == 1  # the shape at rest is solved once
    assert [*by_name.values()] == sorted(by_name.values())
    assert before == pytest.approx(objective.value(objective.shapes(forward, [space.decode(x)])[0]), rel=1e-6)
    [there] = objective.shapes(forward, [wider["220 kPa"].decode(np.ones(3))])
    assert by_name["gain +0.1"] == pytest.approx(by_name["220 kPa"], rel=0.02)  # the same thing here
    assert by_name["220 kPa"] == pytest.approx(objective.value(there), rel=0.1)
    assert by_name["220 kPa"] < 0.7 * before
    assert by_name["bending"] == pytest.approx(before, rel=1e-6)
    assert by_name["gain -0.1"] > before


class ByType(Stronger):
    """Muscles of the type "strong" pull as at a fifth more pressure."""

    def _shape(self, case: Case, share: float) -> NDArray[np.float32]:
        strong = case.design.muscles[0].type == "strong"
        return super()._shape(replace(case, factors={"muscle_gain": 1.2 if strong else 1.0}), share)


def test_another_type_of_muscle_is_among_what_helps() -> None:
    kind = next(iter(DESIGN.muscle_types.values()))
    types = {kind.name: kind, "strong": replace(kind, name="strong")}
    design = replace(DESIGN, muscle_types=types)
    space = DesignSpace(design, Limits(pressure=(0.0, 150e3)), np.full((1, 3), 150e3))
    [(name, strong_space)] = spaces_by_type(space).items()
    assert name == "muscles of type strong" and {muscle.type for muscle in strong_space.design.muscles} == {"strong"}
    assert spaces_by_type(replace(space, design=DESIGN)) == {}
    objective, forward = Objective([Target(cloud([180, 180, 180]))]), ByType(21)
    before, by_name = what_helps(forward.faces_jacobian, objective, (space, np.ones(3)), {}, {}, {name: strong_space})
    [there] = objective.shapes(forward, [strong_space.decode(np.ones(3))])
    assert [*by_name] == [name]
    assert by_name[name] == pytest.approx(objective.value(there), abs=1e-5)
    assert by_name[name] < 0.7 * before


def test_the_place_that_misses_is_found() -> None:
    shape = cloud([100, 100, 100])
    target = shape.reshape(2, 21, 21, 3).copy()
    n = target.shape[1]
    u, v = np.meshgrid(np.linspace(0, 0.2, n), np.linspace(0, 0.2, n))
    target[..., 2] += 0.02 * np.exp(-((u - 0.15) ** 2 + (v - 0.05) ** 2) / (2 * 0.02**2))
    missed = missed_at(shape, LoadedTarget(target.reshape(-1, 3), description="bumped"), (0.2, 0.2))
    assert missed.place == pytest.approx((0.15, 0.05), abs=0.015)
    assert 0.008 < missed.off < 0.02


def test_a_study_says_what_would_help(tmp_path: Path) -> None:
    """Once it has converged; ended before by a limit, it says what a longer search needs and which limits it has met,
    and that nobody knows yet whether the target is out of reach."""
    np.savetxt(tmp_path / "target.xyz", cloud([400, 400, 400])[::2])
    limits = StudyLimits(pressure=(0.0, 150e3), evaluations=80)
    study = Study("s", DESIGN, (TargetFile(tmp_path / "target.xyz"),), limits=limits)
    run_study(study, tmp_path / "out", forward=Stronger(21))
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["stop_reason"] == "the limit of 80 evaluations is reached"
    reach, page = result["reach"], (tmp_path / "out" / "report.html").read_text()
    assert (reach["out_of_reach"], reach["converged"], reach["helps"], reach["missed"]) == (None, False, None, [])
    assert reach["gap_mm"] > 1 and reach["held_by"] == ["all muscles at 150 kPa"]
    assert 40 < reach["needs"]["evaluations"] < 400 and reach["needs"]["seconds"] > 0
    ending, held = reach["said"]
    assert held == "So far it has come up against: all muscles at 150 kPa." and held in page
    assert re.fullmatch(
        r"The search ended before it converged, \d+\.\d mm over the noise floor\. "
        r"To converge it may need about \d+ evaluations more, about \d+ (s|min) at its pace so far\.",
        ending,
    )
    assert ending in page and not re.search(r"out of reach|What holds it back|derivatives neither|kind of layout", page)

    run_study(replace(study, limits=replace(limits, evaluations=300)), tmp_path / "out", forward=Stronger(21))
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["stop_reason"].startswith("converged") and result["evaluations"] > 80
    reach = result["reach"]
    assert reach["out_of_reach"] and reach["held_by"] == ["all muscles at 150 kPa"]
    assert [row["what"] for row in reach["helps"]] == [
        "20% more pull of the muscles at the same pressure",
        "pressures up to 165 kPa",
    ]
    assert reach["missed"][0]["v"] > 0.1  # towards the free edge
    assert "What would bring it nearer, by derivatives: 20% more pull" in " ".join(reach["said"])
    assert "What would bring it nearer" in (tmp_path / "out" / "report.html").read_text()

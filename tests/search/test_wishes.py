"""Wishes in place of a cloud: how they are read, their distance and its slope, and studies that run on them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import read_study
from optimize.search.objective import Objective, Target
from studies.layout_search.target import errors_in_words, load_target
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth, WithJacobian

DESIGN = build("vertical")
FORWARD = """
[[target.wishes]]
edge = "bottom"
forward = 0.06
"""
TUBE = "\n[target.tube]\nradius = 0.0637\n"


@pytest.fixture
def study(tmp_path: Path):
    """Writes a study with this text as its target, and reads it."""
    write_design(DESIGN, tmp_path / "d.toml")

    def read(text: str, before: str = ""):
        (tmp_path / "s.toml").write_text(f'kind = "optimize"\ndesign = "d.toml"\n{before}[target]{text}')
        return read_study(tmp_path / "s.toml")

    return read


def flat() -> np.ndarray:
    return AnalyticCloth().equilibria([Case(DESIGN, constant_program(np.zeros(3)))])[0].astype(float)


def landmarks_of(study) -> Landmarks:
    landmarks = load_target(study.targets[0], study.design).landmarks
    assert landmarks is not None
    return landmarks


def test_an_edge_forward_counts_in_one_coordinate(study) -> None:
    landmarks = landmarks_of(study(FORWARD))
    shape = flat()
    assert landmarks.mean(shape) == pytest.approx(0.06, abs=1e-6)
    np.testing.assert_allclose(landmarks.shares[:, 1], 1.0)
    moved = shape + [0.01, 0.02, 0.045]  # across and upwards is free
    assert landmarks.mean(moved) == pytest.approx(0.015, abs=1e-6)


def test_places_have_weights_and_come_in_the_world_or_from_the_flat_cloth(study) -> None:
    text = """
[[target.wishes]]
at = [0.1, 0.2]
y = -0.15
z = 0.06
weight = 3.0
[[target.wishes]]
at = [0.0, 0.1]
right = 0.02
"""
    landmarks = landmarks_of(study(text))
    np.testing.assert_allclose(landmarks.weights, [0.75, 0.25])
    np.testing.assert_allclose(landmarks.distances(flat()), [np.hypot(0.05, 0.06), 0.02], atol=1e-6)
    description = load_target(study(text).targets[0], DESIGN).description
    assert description.startswith("wishes ((0.1, 0.2): y = -150 mm, z = 60 mm; (0, 0.1): 20 mm right)")


def test_a_tube_keeps_the_cloths_length(study) -> None:
    landmarks = landmarks_of(study(TUBE))
    goals = landmarks.goals.reshape(9, 9, 3)
    steps = np.linalg.norm(np.diff(goals, axis=0), axis=-1)
    np.testing.assert_allclose(steps, 0.025, rtol=0.01)  # chords of an eighth of 0.2 m
    np.testing.assert_allclose(goals[-1, :, 1], 0.0, atol=1e-3)  # 180 degrees: the lower edge is as high as the upper
    np.testing.assert_allclose(goals[-1, :, 2], 2 * 0.0637, atol=1e-3)


@pytest.mark.parametrize("text", [FORWARD, TUBE])
def test_the_slope_is_that_of_the_distance(study, text: str) -> None:
    objective = Objective([Target(np.zeros((1, 3)), landmarks=landmarks_of(study(text)))])
    rng = np.random.default_rng(1)
    shape = flat()[None] + rng.normal(0, 2e-3, (1, 3362, 3))
    value, slope = objective.gradient(shape)
    assert value == pytest.approx(objective.value(shape))
    along = rng.normal(0, 1e-5, shape.shape)
    low, high = (objective.value(shape + by * along) for by in (-1, 1))
    assert np.sum(slope * along) == pytest.approx((high - low) / 2, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('\nfile = "c.ply"' + FORWARD, "file = .*expected none beside wishes"),
        ("\n[[target.wishes]]\nforward = 0.1\n", r"expected either at = \[u, v\] or edge"),
        ('\n[[target.wishes]]\nedge = "bottom"\n', "no goal; expected some of x, y, z, right, up, forward"),
        ('\n[[target.wishes]]\nedge = "bottom"\nz = 0.1\nforward = 0.1\n', "z and forward say the same"),
        ("\n[[target.wishes]]\nat = [0.3, 0.1]\nz = 0.1\n", "a place on the cloth, 0.2 by 0.2 m"),
        ('\n[[target.wishes]]\nedge = "bottom"\nforward = 0.5\n', "to lie 500 mm from a held place; expected at most"),
        ('\n[target.tube]\nradius = 0.05\ntowards = "left"\n', "towards"),
    ],
)
def test_a_wish_that_is_none_is_refused(study, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        study(text)


def test_wishes_have_a_distance_of_their_own(study) -> None:
    with pytest.raises(InputError, match='objective = "surface_rms"; expected "chamfer" for wishes'):
        study(FORWARD, 'objective = "surface_rms"\n')


def test_a_study_fulfils_wishes(study, tmp_path: Path) -> None:
    text = "\n[[target.wishes]]\nat = [0.1, 0.2]\nforward = 0.06\n[[target.wishes]]\nat = [0.03, 0.2]\nz = 0.03\n"
    study_result = run_study(
        study("\n" + text, "[limits]\nevaluations = 400\n"), tmp_path / "out", forward=WithJacobian()
    )
    middle = study_result.points[0].reshape(2, 41, 41, 3).mean(axis=0)
    assert middle[-1, [20, 6], 2] == pytest.approx([0.06, 0.03], abs=1e-3)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["objective_mm"] < 0.5 and result["chamfer_floor"] == 0
    description = "wishes ((0.1, 0.2): 60 mm forward; (0.03, 0.2): z = 30 mm)"
    assert result["targets"][0].startswith(description)
    page = (tmp_path / "out" / "report.html").read_text()
    body = page[page.index("<body>") : page.index('id="figures"')]
    assert description in body and "mean distance from<br>what was asked for, mm" in body
    assert "Chamfer" not in body and "surface RMS" not in body
    assert '"asked for"' in page and "nearest<br>target" not in page  # no colour bar


def test_a_wish_that_a_limit_ended_says_so(study, tmp_path: Path) -> None:
    text = "\n[[target.wishes]]\nat = [0.1, 0.2]\nforward = 0.06\n"
    messages: list[str] = []
    limited = study("\n" + text, "[limits]\nevaluations = 12\nseconds = 77\n")
    study_result = run_study(
        limited, tmp_path / "out", forward=WithJacobian(), progress=lambda e: messages.append(e.message)
    )
    assert messages[-1].startswith("following the motions that lead to the result")
    words = errors_in_words(study_result.study, study_result.errors)
    assert words.startswith("mean distance from what was asked for; root mean square ") and "Chamfer" not in words
    sentences = json.loads((tmp_path / "out" / "result.json").read_text())["reach"]["said"]
    assert sentences[0].startswith("The search ended before it converged") and "not known" in sentences[0]
    shown = str(study_result)
    assert sentences[0] in shown and "the limit of 12 evaluations is reached" in shown
    assert re.search(r"^\d+ of at most 77 s of search time \(without compilation\)", shown, re.M)


def test_a_wish_that_nothing_fulfils_says_where_and_what_would_help(study, tmp_path: Path) -> None:
    limited = "[limits]\nevaluations = 300\npressure = [0.0, 60.0]\n"
    run_study(study(FORWARD, limited), tmp_path / "out", forward=WithJacobian())
    reach = json.loads((tmp_path / "out" / "result.json").read_text())["reach"]
    assert reach["out_of_reach"] and "mm from what was asked for. What holds it back" in reach["said"][0]
    assert "capped" not in (tmp_path / "out" / "report.html").read_text()
    assert reach["missed"][0]["v"] == pytest.approx(0.2)
    assert [row["what"] for row in reach["helps"]] == ["pressures up to 66 kPa"]

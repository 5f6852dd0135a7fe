"""Copies with scatter: what they are, what derivatives say of them, and which layout is chosen for them."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fabdesign.files.pressure_file import constant_program
from fabdesign.formats.json_file import plain
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.column import Column, FacesJacobian
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Covariance, Model, Parameter
from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import Robust, TargetFile
from optimize.search.design_space import DesignSpace, Limits
from optimize.search.objective import Objective, Target
from optimize.search.starts import Start
from studies.layouts.robustness import first_order, most_robust, robustness_of
from studies.layouts.run import run_study
from studies.layouts.scatter import Scatter, Scattering
from studies.prediction.forward_model import forward_model
from tests.analytic_cloth import AnalyticCloth, WithJacobian

CLOTH = build("vertical")
LINE = ((0.1, 0.03), (0.1, 0.17))
ROBUST = Robust(copies=24)
FORWARD = forward_model(AnalyticCloth(11), None)


def with_muscles(*sides: str) -> Design:
    first = CLOTH.muscles[0]
    muscles = tuple(
        replace(first, channel=k, side="front" if side == "front" else "back", path=LINE)
        for k, side in enumerate(sides)
    )
    return replace(CLOTH, muscles=muscles)


def start_of(design: Design, kpa: list[float]) -> Start:
    space = DesignSpace(design, Limits(), 1e3 * np.array([kpa]), vary_positions=True)
    return space, space.encode(design, space.start_pressures)


def layouts(starts: list[Start]) -> list[tuple[Design, np.ndarray]]:
    return [space.decode(x) for space, x in starts]


ONE = with_muscles("front"), [200.0]
# the back takes away what the front has too much: the same shape, of larger forces
SHARE = float(np.tanh(380 / 250) ** 2 - np.tanh(200 / 250) ** 2)
TWO = with_muscles("front", "back"), [380.0, 250 * float(np.arctanh(np.sqrt(SHARE)))]
STUDY = Study("s", ONE[0], (), robust=ROBUST)


def scattering(
    objective: Objective, forward: Predictor = FORWARD, robust: Robust = ROBUST, **study: object
) -> Scattering:
    return Scattering(replace(STUDY, **study), robust, objective, forward)


@pytest.fixture(scope="module")
def objective() -> Objective:
    shape = AnalyticCloth(11).equilibria([Case(ONE[0], constant_program([200e3]))])[0].astype(float)
    return Objective([Target(np.random.default_rng(2).normal(shape, 6e-4))])


def test_a_muscle_off_its_place_is_that_very_design(objective: Objective) -> None:
    scatter = Scatter(scattering(objective), ONE[0], np.array([[200e3]]))
    assert scatter.size == 4 + 1 + 1  # two corners, a channel, a muscle
    moved = replace(ONE[0].muscles[0], path=((0.103, 0.03), (0.103, 0.17)))
    [shape, nominal] = scatter.shapes([scatter.shifted(0, (1, 0), 0.003), np.zeros(6)])
    wanted = objective.shapes(FORWARD, layouts([start_of(replace(ONE[0], muscles=(moved,)), [200.0]), start_of(*ONE)]))
    np.testing.assert_allclose([shape, nominal], wanted, atol=1e-7)
    stronger = np.zeros(6)
    stronger[4], stronger[5] = 1.0, -1.0  # pressure 5 % up, gain 4 % down
    [shape] = scatter.shapes([stronger])
    [wanted] = objective.shapes(FORWARD, layouts([start_of(ONE[0], [200 * 1.05 * 0.96])]))
    np.testing.assert_allclose(shape, wanted, atol=1e-7)


def test_derivatives_say_what_a_batch_of_copies_shows(objective: Objective) -> None:
    robustness = robustness_of(scattering(objective), (ONE[0], np.array([[200e3]])), FORWARD, nominal=0.008)
    scatter = Scatter(scattering(objective), ONE[0], np.array([[200e3]]))
    zs = np.random.default_rng(5).standard_normal((200, scatter.size))
    values = [objective.value(shape) for shape in scatter.shapes(list(zs))]
    assert robustness.expected_linear == pytest.approx(np.mean(values), rel=0.05)
    assert robustness.expected == pytest.approx(np.mean(values), rel=0.15)
    assert robustness.worst > robustness.expected > robustness.nominal
    assert robustness.tolerance == pytest.approx(0.010)
    assert robustness.on_another_branch == 0 and robustness.holds
    tip = robustness.band.reshape(2, 41, 41)[0, -1].mean()
    assert tip > 3 * robustness.band.reshape(2, 41, 41)[0, 10].mean()  # what is near the held edge moves little


@pytest.mark.parametrize("choose", ["expected", "yield"])
def test_of_equal_shapes_the_one_of_smaller_forces_is_chosen(objective: Objective, choose: str) -> None:
    robust = replace(ROBUST, choose=choose)
    points = [start_of(*TWO), start_of(*ONE)]
    [two, one] = objective.shapes(FORWARD, layouts(points))
    np.testing.assert_allclose(one, two, atol=1e-5)
    assert most_robust(scattering(objective, robust=robust), points) == 1
    scores = []
    for space, x in points:
        scatter = Scatter(scattering(objective, robust=robust), *space.decode(x))
        scores.append(first_order(scatter, scatter.linear()[0], 0.010))
    assert scores[1][0] < scores[0][0]
    assert scores[1][1] > scores[0][1] + 0.2


def test_the_muscle_that_pulls_is_the_delicate_one(objective: Objective) -> None:
    idle = replace(ONE[0].muscles[0], channel=0, path=((0.03, 0.03), (0.03, 0.17)))
    pulls = replace(ONE[0].muscles[0], channel=1)
    design = replace(ONE[0], muscles=(idle, pulls))
    how = scattering(objective, robust=replace(ROBUST, copies=8))
    robustness = robustness_of(how, (design, np.array([[0.0, 200e3]])), FORWARD, nominal=0.008)
    assert robustness.delicate[0] == 1  # from 0, as in files
    assert robustness.delicate[1] > robustness.nominal


class NearAFold(WithJacobian):
    """Whose slopes are ten times too steep where a design has one muscle; `definite`: and does not say so."""

    def __init__(self, *, definite: bool) -> None:
        super().__init__(11)
        self.definite = definite

    def faces_jacobian(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[FacesJacobian]:
        jacobians = super().faces_jacobian(cases, columns)
        return [
            one._replace(changes=10 * one.changes, exact=one.exact & self.definite)
            if len(case.design.muscles) == 1
            else one
            for case, one in zip(cases, jacobians, strict=True)
        ]


@pytest.mark.parametrize("definite", [True, False])
def test_near_a_fold_copies_stand_in_place_of_derivatives(objective: Objective, definite: bool) -> None:
    forward = forward_model(NearAFold(definite=definite), None)
    # derivatives would choose the two muscles, whose copies are the worse ones (above)
    points = [start_of(*TWO), start_of(*ONE)]
    scores = []
    how = scattering(objective, forward)
    for space, x in points:
        scatter = Scatter(how, *space.decode(x))
        scores.append(first_order(scatter, scatter.linear()[0], 0.010)[0])
    assert scores[1] > 1.5 * scores[0]
    assert most_robust(how, points) == 1
    result = ONE[0], np.array([[200e3]])
    robustness = robustness_of(how, result, forward, nominal=0.008)
    true = robustness_of(scattering(objective), result, FORWARD, nominal=0.008)
    assert not robustness.holds and true.holds
    assert robustness.expected_linear > 1.5 * robustness.expected == 1.5 * true.expected
    assert robustness.on_another_branch == true.on_another_branch == 0
    assert robustness.delicate[1] == pytest.approx(true.delicate[1], rel=0.05)
    kept = plain(robustness)
    assert kept["first_order"]["holds"] is False
    assert "The values above are those of the copies." in robustness.sentences[-1]


class Recording(AnalyticCloth):
    def __init__(self) -> None:
        super().__init__(11)
        self.factors: list[dict[str, float]] = []

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.factors += [dict(case.factors) for case in cases]
        return super().equilibria(cases)


def test_the_models_covariance_scatters_too(objective: Objective) -> None:
    model = Model(
        {"bending": Parameter(1.2), "membrane": Parameter(0.9)},
        covariance=Covariance(("bending", "membrane"), np.array([[0.01, 0.0], [0.0, 0.0004]])),
    )
    how = scattering(objective, forward_model(simulator := Recording(), model), model=model)
    scatter = Scatter(how, ONE[0], np.array([[200e3]]))
    assert scatter.size == 6 + 2
    z = np.zeros((2, 8))
    z[1, 6] = 1.0
    scatter.shapes(list(z))
    assert simulator.factors[0] == pytest.approx({"bending": 1.2, "membrane": 0.9})
    assert simulator.factors[1] == pytest.approx({"bending": 1.2 * np.exp(0.1), "membrane": 0.9})
    assert Scatter(replace(how, robust=replace(ROBUST, covariance=False)), ONE[0], np.array([[200e3]])).size == 6


def test_a_study_reports_its_copies(objective: Objective, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "target.xyz", objective.targets[0].points[::2])
    study = replace(STUDY, targets=(TargetFile(tmp_path / "target.xyz"),), robust=replace(ROBUST, copies=8))
    study = replace(study, limits=replace(study.limits, evaluations=80))
    result = run_study(study, tmp_path / "out", forward=AnalyticCloth(11))
    kept = json.loads((tmp_path / "out" / "result.json").read_text())["robust"]
    assert kept["copies"] == 8 and 8 * kept["yield"] in range(9)
    assert kept["nominal_mm"] == pytest.approx(1e3 * result.objective, rel=0.02)
    assert kept["delicate"]["muscle"] == 0 and len(kept["said"]) == 3
    assert "Muscle 0 matters most: 3 mm off" in kept["said"][2] and "uscle 1" not in kept["said"][2]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Manufacturing tolerances: simulated copies" in page and "data:image/png" in page


def test_derivatives_of_the_forward_model_are_those_of_copies(objective: Objective) -> None:
    bent = replace(ONE[0].muscles[0], channel=0, path=((0.06, 0.03), (0.08, 0.09), (0.07, 0.17)))
    design = replace(ONE[0], muscles=(*ONE[0].muscles, bent))  # two muscles on one channel
    offered, scatter = (
        Scatter(scattering(objective, forward_model(cloth, None)), design, np.array([[200e3]]))
        for cloth in (WithJacobian(11), AnalyticCloth(11))
    )
    linear = offered.linear()[0]
    assert len(scatter.columns) == scatter.size == len(linear.slopes)
    np.testing.assert_allclose(linear.shape, scatter.linear()[0].shape, atol=1e-7)
    for z, slope in zip(0.1 * np.eye(scatter.size), linear.slopes, strict=True):
        low, high = scatter.shapes([-z, z])
        assert np.abs((high - low) / 0.2 - slope).max() < 0.05 * np.abs(slope).max() + 2e-6


def test_derivatives_of_the_models_covariance_are_those_of_copies(objective: Objective) -> None:
    model = Model(
        {"muscle_gain": Parameter(1.2), "bending": Parameter(0.9)},
        covariance=Covariance(("muscle_gain", "bending"), np.array([[0.01, 0.004], [0.004, 0.04]])),
    )
    scatter = Scatter(scattering(objective, model=model), ONE[0], np.array([[200e3]]))
    case = scatter.how.case(0, scatter.copy(np.zeros(scatter.size)))
    assert case.factors == pytest.approx({"muscle_gain": 1.2, "bending": 0.9})
    moved = scatter.columns[-2].moved(case, 1.0).factors
    assert moved == pytest.approx({"muscle_gain": 1.2 * np.exp(0.1), "bending": 0.9 * np.exp(0.04)})

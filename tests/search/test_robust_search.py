"""A layout made robust: moved for the mean of its copies, its muscles laid as two where that gains."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import EffectTerm, Model, Quantity
from fabdesign.study_files.study_file import MuscleChoice
from fabdesign.study_files.study_targets import Price, TargetFile
from optimize.search.objective import Objective, Target
from optimize.search.variations import doubled
from studies.layouts.robust_search import COPIES, YIELD_GAIN, Copies, MoreRobust, descend, more_robust
from studies.layouts.run import run_study
from studies.layouts.scatter import Scatter
from studies.prediction.forward_model import forward_model
from tests.analytic_cloth import AnalyticCloth, WithJacobian
from tests.search.test_robustness import LINE, ONE, ROBUST, STUDY, TWO, scattering, start_of, with_muscles

FORWARD = forward_model(WithJacobian(11), None)
MANY = replace(STUDY, positions=True, muscles=MuscleChoice(1, 2))


SHARES = np.stack(np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 7)), axis=-1).reshape(-1, 2)


def seen(design: Design, kpa: list[float]) -> Objective:
    """49 places of the cloth, where that layout brings them."""
    shape = AnalyticCloth(41).equilibria([Case(design, constant_program([1e3 * p for p in kpa]))])[0].astype(float)
    goals = at_places(Shape.of(shape).middle, SHARES)
    given, weights = np.ones(goals.shape, dtype=bool), np.full(len(goals), 1 / len(goals))
    return Objective([Target(goals, landmarks=Landmarks(SHARES, goals, given, weights))])


@pytest.fixture(scope="module")
def objective() -> Objective:
    return seen(*ONE)


@pytest.fixture(scope="module")
def wide() -> Objective:
    """Of two muscles beside each other, which one alone comes near to."""
    pair = [
        replace(muscle, path=((u, 0.03), (u, 0.17)))
        for muscle, u in zip(with_muscles("front", "front").muscles, (0.094, 0.106), strict=True)
    ]
    return seen(replace(ONE[0], muscles=tuple(pair)), [130.0, 130.0])


def test_copies_move_with_the_layout(objective: Objective) -> None:
    """Two muscles on one channel, and two channels: by differences of the copies themselves."""
    muscles = [*with_muscles("front", "back", "back").muscles]
    muscles[1] = replace(muscles[1], channel=0, path=((0.05, 0.04), (0.09, 0.16)))
    muscles[2] = replace(muscles[2], channel=1, path=((0.15, 0.04), (0.12, 0.16)))
    space, x = start_of(replace(ONE[0], muscles=tuple(muscles)), [200.0, 90.0])
    two = replace(objective, targets=[*objective.targets] * 2)
    space = replace(space, start_pressures=np.array([[200e3, 90e3], [50e3, 250e3]]))
    x = space.encode(space.design, space.start_pressures)
    copies = Copies(scattering(two, FORWARD), space)
    [shape] = copies.shapes([x])
    assert len(shape) == 2 * COPIES
    jacobians = FORWARD.faces_jacobian
    assert jacobians is not None
    model = copies.model(x, shape, jacobians)
    for step, slope in zip(1e-3 * np.eye(len(x)), model.slopes, strict=True):
        low, high = copies.shapes([x - step, x + step])
        assert np.abs((high - low) / 2e-3 - slope).max() < 0.02 * np.abs(slope).max() + 2e-4


def test_the_mean_of_copies_goes_down(objective: Objective) -> None:
    start = start_of(*TWO)
    how = scattering(objective, FORWARD)
    copies = Copies(how, start[0])
    space, x = descend(how, start)
    before, after = (copies.together.value(shape) for shape in copies.shapes([start[1], x]))
    assert after < 0.97 * before
    values = []
    for one in (start[1], x):  # and of other copies
        scatter = Scatter(how, *space.decode(one))
        zs = np.random.default_rng(9).standard_normal((200, scatter.size))
        values.append(np.mean([objective.value(shape) for shape in scatter.shapes(zs)]))
    assert values[1] < 0.99 * values[0]
    still = forward_model(AnalyticCloth(11), None)  # without derivatives
    assert descend(scattering(objective, still), start) is start
    assert descend(how, start, going=lambda: False)[1] is start[1]


def test_a_muscle_becomes_two_beside_each_other() -> None:
    start = doubled(start_of(*ONE), 0, 0.6)
    assert start is not None
    design, pressures = start[0].decode(start[1])
    first, second = (np.array(muscle.path) for muscle in design.muscles)
    gap = 2 * start[0].limits.spacing
    np.testing.assert_allclose(np.abs(first - second), [[gap, 0.0]] * 2, atol=1e-9)
    np.testing.assert_allclose((first + second) / 2, LINE, atol=1e-9)
    np.testing.assert_allclose(pressures, [[120e3, 120e3]])
    assert [muscle.channel for muscle in design.muscles] == [0, 1]
    crowded = replace(ONE[0].muscles[0], channel=1, path=((0.11, 0.03), (0.11, 0.17)))
    assert doubled(start_of(replace(ONE[0], muscles=(*ONE[0].muscles, crowded)), [200.0, 0.0]), 0, 0.6) is None


@pytest.mark.parametrize("choose", ["expected", "yield"])
def test_muscles_are_doubled_while_that_gains(wide: Objective, choose: str) -> None:
    how = replace(scattering(wide, FORWARD, replace(ROBUST, choose=choose)), study=MANY)

    def result_for(price: float, most: int) -> MoreRobust:
        study = replace(MANY, muscles=MuscleChoice(1, most), price=Price(muscle=price))
        return more_robust(replace(how, study=study), start_of(*ONE), tolerance=0.0007)

    one, more, dear = result_for(0.0, 1), result_for(0.0, 2), result_for(1.0, 2)
    assert one.muscles == dear.muscles == 1 and one.doubled == dear.doubled == 0
    assert more.muscles == 2 and more.doubled == 1
    assert more.expected < 0.98 * one.expected
    assert choose == "expected" or more.yielded >= one.yielded + YIELD_GAIN
    cut = more_robust(how, start_of(*ONE), tolerance=0.0007, going=lambda: False)
    assert cut.muscles == 1
    early = replace(wide, targets=[replace(wide.targets[0], time=0.2)])
    start = start_of(*ONE)
    assert more_robust(replace(how, objective=early), start, tolerance=0.0007).start is start


def test_a_study_says_that_muscles_were_doubled_and_does_not_search_twice(
    wide: Objective, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savetxt(tmp_path / "target.xyz", wide.targets[0].points)
    study = replace(MANY, targets=(TargetFile(tmp_path / "target.xyz"),), robust=replace(ROBUST, copies=8))
    study = replace(study, limits=replace(study.limits, evaluations=120))
    result = run_study(study, tmp_path / "out", forward=WithJacobian(11))
    kept = json.loads((tmp_path / "out" / "result.json").read_text())["robust"]
    assert result.robust is not None and kept["doubled"] == result.robust.doubled > 0
    assert len(result.design.muscles) > 1
    assert any("laid as two beside each other" in line for line in kept["said"])
    monkeypatch.setattr("studies.layouts.refinement.more_robust", lambda *args, **kwargs: pytest.fail("searched twice"))
    again = run_study(study, tmp_path / "out", forward=WithJacobian(11))
    assert again.design == result.design and again.robust is not None
    assert again.robust.doubled == result.robust.doubled


def test_derivatives_leave_out_forces_against_motion(objective: Objective) -> None:
    """The shape is the whole model's, its slopes those of the model without drag."""
    drag = EffectTerm("air_drag", {"coefficient": Quantity(2.0, "N s^2/m^4")}, "rig")
    scatters = [
        Scatter(scattering(objective, FORWARD, model=model), ONE[0], np.array([[200e3]]))
        for model in (Model(effects=(drag,)), Model())
    ]
    assert [scatter.resists for scatter in scatters] == [True, False]
    assert scatters[0].how.case(0, scatters[0].copy(np.zeros(scatters[0].size))).effects == ()
    assert scatters[0].copy(np.zeros(scatters[0].size))[2].effects == (drag,)
    with_drag, bare = (scatter.linear()[0] for scatter in scatters)
    np.testing.assert_array_equal(with_drag.slopes, bare.slopes)

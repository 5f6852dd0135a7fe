"""Derivatives in the search: those of the forward model against differences, with all that lies on top, and what a
search with them comes to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import EffectTerm, Model, Parameter, Quantity
from fabdesign.nouns.predictor import Predictor
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.local_search import LinearShape
from optimize.search.margins import Limits
from optimize.search.multistart import search
from optimize.search.objective import Objective, Target
from optimize.search.slopes import jacobians_for, slopes_of
from optimize.search.starts import pressure_starts
from sim import Simulator
from tests.analytic_cloth import AnalyticCloth, WithJacobian

ANY = Target(np.zeros((1, 3)))
DESIGN = build("vertical")
BENT = ((0.05, 0.04), (0.08, 0.1), (0.06, 0.16))


def point(design: Design, kpa: Sequence[Sequence[float]]) -> tuple[DesignSpace, Vector]:
    space = DesignSpace(design, Limits(), 1e3 * np.array(kpa), vary_positions=True)
    return space, space.encode(design, space.start_pressures)


def of_two_layouts() -> list[tuple[DesignSpace, Vector]]:
    """One with a bent muscle; two poses each."""
    bent = replace(DESIGN.muscles[0], path=BENT)
    one = replace(DESIGN, muscles=(bent, *DESIGN.muscles[1:]))
    return [
        point(one, [[120, 200, 60], [40, 300, 90]]),
        point(build("cross", muscles=2), [[150, 90], [40, 220]]),
    ]


def differenced(objective: Objective, forward: AnalyticCloth | Predictor, space: DesignSpace, x: Vector, by: float):
    """(n, poses, 2 n, 3) m, central where there is room."""
    low, high = np.maximum(x - by * np.eye(len(x)), 0.0), np.minimum(x + by * np.eye(len(x)), 1.0)
    shapes = objective.shapes(forward, [space.decode(row) for row in (*low, *high)])
    widths = (high - low).sum(axis=1)[:, None, None, None]
    return (np.array(shapes[len(x) :]) - np.array(shapes[: len(x)])) / widths


def off(slopes: NDArray, wanted: NDArray) -> NDArray:
    """(n,) relative; of a variable that does next to nothing, to a twentieth of the largest."""
    error, size = (np.sqrt(np.square(a).sum(axis=(1, 2, 3))) for a in (slopes - wanted, wanted))
    return np.asarray(error / np.maximum(size, 0.05 * size.max()))


def test_slopes_are_those_of_every_variable_in_every_pose() -> None:
    objective, forward = Objective([ANY, ANY]), WithJacobian(21)
    points = of_two_layouts()
    layout_slopes = slopes_of(forward.faces_jacobian, objective, points)
    assert forward.asked == 2  # both layouts together, a batch for each pose
    shapes = objective.shapes(forward, [space.decode(x) for space, x in points])
    for (space, x), slopes, shape in zip(points, layout_slopes, shapes, strict=True):
        np.testing.assert_allclose(slopes.shape, shape, atol=1e-7)
        wanted = differenced(objective, forward, space, x, 1e-3)
        assert off(slopes.by_variable, wanted).max() < 0.02


def test_early_frames_and_models_without_derivatives_take_differences() -> None:
    assert jacobians_for(AnalyticCloth(), Objective([ANY])) is None
    assert jacobians_for(Predictor(AnalyticCloth()), Objective([ANY])) is None
    forward = Predictor(WithJacobian())
    assert jacobians_for(forward, Objective([replace(ANY, time=0.3)])) is None
    assert jacobians_for(forward, Objective([replace(ANY, time=1.5)])) is not None


@dataclass(frozen=True)
class Sagging:
    """A corrector that lowers the cloth by what its pressures and its own height say."""

    ordered: bool = True
    starts: float = 0.0

    def history(self) -> tuple[float, ...]:
        return (0.1,)

    def correct(self, cases: Sequence[Case], times: Sequence[NDArray], motions: Sequence[NDArray]) -> list[NDArray]:
        answers = []
        for case, motion in zip(cases, motions, strict=True):
            points = np.array(motion[-1:], dtype=float)
            points[..., 2] -= (0.02 + 1e-7 * case.program.pressure[-1].sum()) * np.square(points[..., 1] / 0.2)
            answers.append(points.astype(np.float32))
        return answers


def test_what_lies_on_top_is_in_the_slopes() -> None:
    scale = EffectTerm("scale_error", {"scale": Quantity(0.05, "1")})
    model = Model({"bending": Parameter(1.2)}, effects=(scale,))
    forward = Predictor(WithJacobian(21), model, sensing=True, corrector=Sagging())
    objective = Objective([ANY, ANY])
    [(space, x), *_] = of_two_layouts()
    jacobians = jacobians_for(forward, objective)
    assert jacobians is not None
    [slopes] = slopes_of(jacobians, objective, [(space, x)])
    np.testing.assert_allclose(slopes.shape, objective.shapes(forward, [space.decode(x)])[0], atol=1e-7)
    wanted = differenced(objective, forward, space, x, 2e-3)
    bare = differenced(objective, AnalyticCloth(21), space, x, 2e-3)
    assert off(slopes.by_variable, wanted).max() < 0.03
    assert off(bare, wanted).max() > 0.05  # so that leaving them out would show


TRUTH = np.array([[320e3, 60e3, 210e3]])
SPACE = DesignSpace(DESIGN, Limits(), np.full((1, 3), 200e3))


def searched(forward: AnalyticCloth, *, time: float | None = None, at_rest: bool = False) -> tuple[float, int]:
    """m that a search of pressures ends at, and its evaluations."""
    bare = Objective([Target(np.zeros((1, 3)), time)])
    [[shape]] = bare.shapes(AnalyticCloth(), [SPACE.decode(SPACE.encode(DESIGN, TRUTH))])
    target = Target(shape[::4] + np.random.default_rng(7).normal(0, 6e-4, shape[::4].shape), time)
    with History(":memory:", "a") as history:
        run = Evaluations(
            Objective([target]),
            pressure_starts(SPACE, 8, seed=1),
            [
                Stage("first", forward, keep=2, rounds=10, at_rest=at_rest),
                Stage("full model", forward, keep=1, rounds=4),
            ],
            history,
            seconds=600.0,
            evaluations=20_000,
        )
        search(run)
        assert run.best is not None
        return run.best.value, history.evaluations


def test_a_search_with_derivatives_ends_as_near_with_fewer_evaluations() -> None:
    forward = WithJacobian(21)
    (plain, plain_evaluations), (value, evaluations) = searched(AnalyticCloth(21)), searched(forward)
    assert forward.asked > 3
    assert value < plain * 1.002
    assert evaluations < plain_evaluations


@pytest.mark.parametrize("wrong", [1.0, 0.6, 1.5])
def test_what_slopes_lack_is_learned_from_the_trials(wrong: float) -> None:
    plain, _ = searched(AnalyticCloth(21), time=1.5)
    value, _ = searched(WithJacobian(21, wrong=wrong), time=1.5)
    assert value < plain * 1.01


def test_a_model_learns_a_shape_and_keeps_what_lies_across() -> None:
    rng = np.random.default_rng(4)
    model = LinearShape(np.zeros(3), rng.normal(size=(1, 6, 3)), rng.normal(size=(3, 1, 6, 3)))
    x, shape = np.array([0.1, 0.2, 0.0]), rng.normal(size=(1, 6, 3))
    learned = model.through(x, shape)
    np.testing.assert_allclose(learned.at(x), shape)
    across = np.array([-0.2, 0.1, 0.3])
    np.testing.assert_allclose(learned.at(across), model.at(across))


class Killed(WithJacobian):
    """A power cut during one of its calls."""

    def __init__(self, call: int) -> None:
        super().__init__(21, wrong=1.5)
        self.remaining = call

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.remaining -= 1
        if not self.remaining:
            raise SystemExit
        return super().equilibria(cases)


def run_in(file: Path, forward: WithJacobian) -> tuple[float, list[float], list[tuple[float, ...]]]:
    """Search with what the file keeps: the best value, where it is, and all points that were asked for."""
    [[shape]] = Objective([ANY]).shapes(AnalyticCloth(), [SPACE.decode(SPACE.encode(DESIGN, TRUTH))])
    stages, starts = [Stage("first", forward, keep=2, rounds=9)], pressure_starts(SPACE, 4, seed=1)
    with History(file, "a") as history:
        run = Evaluations(Objective([Target(shape[::4])]), starts, stages, history, seconds=600.0, evaluations=20_000)
        search(run)
        assert run.best is not None
        return run.best.value, run.best.x.tolist(), [entry.x for entry in history.entries()]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, list[float], list[tuple[float, ...]]]:
    return run_in(tmp_path_factory.mktemp("whole") / "whole.sqlite", Killed(0))


@pytest.mark.parametrize("call", [3, 4, 6])
def test_a_killed_search_goes_on_to_the_same_end_with_derivatives(
    tmp_path: Path, call: int, uninterrupted: tuple[float, list[float], list[tuple[float, ...]]]
) -> None:
    with pytest.raises(SystemExit):
        run_in(tmp_path / "cut.sqlite", Killed(call))
    resumed = run_in(tmp_path / "cut.sqlite", Killed(0))
    assert resumed[:2] == uninterrupted[:2]
    assert set(uninterrupted[2]) <= set(resumed[2])


class Asked(WithJacobian):
    """That notes what it is asked for."""

    def __init__(self) -> None:
        super().__init__(21)
        self.what: list[str] = []

    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        self.what.append("motions")
        return super().motions(cases, times)

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.what.append("equilibria")
        return super().equilibria(cases)


def test_shapes_at_rest_lead_to_a_late_frame() -> None:
    plain, _ = searched(AnalyticCloth(21), time=1.5)
    forward = Asked()
    value, _ = searched(forward, time=1.5, at_rest=True)
    assert value < plain * 1.002
    first = forward.what.index("motions")
    assert first > 3 and set(forward.what[first:]) == {"motions"}  # of the full model, after the coarse stage


def test_late_frames_alone_become_shapes_at_rest() -> None:
    objective = Objective([ANY, replace(ANY, time=0.4), replace(ANY, time=1.2)], weights=[1.0, 2.0, 3.0])
    assert [target.time for target in objective.at_rest.targets] == [None, 0.4, None]
    assert objective.at_rest.weights == [1.0, 2.0, 3.0]


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(points_per_side=11, tolerance=1e-7)


def test_the_simulators_slopes_follow_its_differences(simulator: Simulator) -> None:
    objective = Objective([ANY])
    space, x = point(build("vertical"), [[150, 220, 90]])
    jacobians = jacobians_for(Predictor(simulator), objective)
    assert jacobians is not None
    [slopes] = slopes_of(jacobians, objective, [(space, x)])
    [shape] = objective.shapes(simulator, [space.decode(x)])
    assert np.abs(slopes.shape - shape).max() < 2e-4  # the forces balance closer than a damped motion leaves them
    wanted = differenced(objective, simulator, space, x, 0.01)
    assert np.median(off(slopes.by_variable, wanted)) < 0.05
    # the largest are of positions, whose number of intervals the differences change
    assert off(slopes.by_variable, wanted).max() < 0.25


def test_a_late_frame_changes_nearly_as_the_shape_at_rest(simulator: Simulator) -> None:
    late = Objective([replace(ANY, time=1.5)])
    space, x = point(build("vertical", muscles=4), [[260, 240, 240, 260]])
    space, x = replace(space, vary_positions=False), x[-4:]
    jacobians = jacobians_for(Predictor(simulator), late)
    assert jacobians is not None
    [slopes] = slopes_of(jacobians, late, [(space, x)])
    wanted = differenced(late, simulator, space, x, 0.04)
    along = np.einsum("npkd,npkd->n", slopes.by_variable, wanted)
    sizes = [np.sqrt(np.square(a).sum(axis=(1, 2, 3))) for a in (slopes.by_variable, wanted)]
    assert (along / (sizes[0] * sizes[1])).min() > 0.9


def test_effects_of_the_model_are_in_the_simulators_slopes(simulator: Simulator) -> None:
    curl = EffectTerm("rest_curvature", {"down": Quantity(1.5, "1/m")})
    model = Model({"bending": Parameter(1.3)}, effects=(curl,))
    forward, objective = Predictor(simulator, model), Objective([ANY])
    space, x = point(build("cross", muscles=2), [[150, 90]])
    jacobians = jacobians_for(forward, objective)
    assert jacobians is not None
    [slopes] = slopes_of(jacobians, objective, [(space, x)])
    wanted = differenced(objective, forward, space, x, 0.01)
    assert np.median(off(slopes.by_variable, wanted)) < 0.05

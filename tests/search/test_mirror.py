"""An even target: which layouts are their own images, and that a search stays at them and takes them."""

from dataclasses import replace

import numpy as np
import pytest

from fabdesign.geometry.wishes import Landmarks, Region, Weighting, Wish
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from optimize.search.best import Best, Stage
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.margins import Limits
from optimize.search.mirror import has_even_targets, is_even, mirror_of
from optimize.search.multistart import search
from optimize.search.objective import Objective, Target
from optimize.search.starts import Start
from tests.analytic_cloth import AnalyticCloth
from tests.sheets import rolled_sheet

THREE = build("vertical", muscles=3)
EVEN = [[250e3, 120e3, 250e3]]


def start_of(pressures: list[list[float]], design: Design = THREE, *, positions: bool = True) -> Start:
    space = DesignSpace(design, Limits(), np.array(pressures), vary_positions=positions)
    return space, space.encode(design, space.start_pressures)


def moved(start: Start, muscle: int, by: float) -> Start:
    """One muscle lies aside by so many m."""
    space, _ = start
    muscles = [*space.design.muscles]
    muscles[muscle] = muscles[muscle].along(np.array(muscles[muscle].path) + [by, 0.0])
    design = replace(space.design, muscles=tuple(muscles))
    return replace(space, design=design), space.encode(design, space.start_pressures)


def evaluations_of(target: Target, starts: list[Start], history: History) -> Evaluations:
    stage = Stage("first", AnalyticCloth(11), keep=1, rounds=6, vary_positions=True)
    return Evaluations(Objective([target]), starts, [stage], history, seconds=60, evaluations=400)


def target_under(pressures: list[list[float]]) -> Target:
    """Of the layout a little higher and wider, with noise."""
    wide = [muscle.along(0.96 * (np.array(muscle.path) - 0.1) + 0.1) for muscle in THREE.muscles]
    start = start_of(pressures, replace(THREE, muscles=tuple(wide)))
    [[shape]] = Objective([Target(np.zeros((1, 3)))]).shapes(AnalyticCloth(), [start[0].decode(start[1])])
    return Target(shape + np.random.default_rng(7).normal(0, 6e-4, shape.shape))


def test_an_even_layout_is_its_own_image_and_another_has_one_between() -> None:
    even = start_of(EVEN)
    assert is_even(even) and not is_even(start_of([[250e3, 120e3, 240e3]])) and not is_even(moved(even, 0, 0.01))
    space, x = moved(even, 0, 0.01)
    mirror = mirror_of(space, x)
    assert mirror is not None
    muscles = space.decode(mirror.even(x))[0].muscles
    u = [[corner[0] for corner in muscle.path] for muscle in muscles]
    np.testing.assert_allclose(np.array(u[0]) + u[2], 0.2)  # of a cloth 0.2 m wide: both by half as much
    np.testing.assert_allclose(np.array(u[0]) - [c[0] for c in THREE.muscles[0].path], 0.005)
    level = replace(THREE.muscles[0], path=((0.02, 0.1), (0.18, 0.1)))  # its image runs backwards
    assert is_even(start_of([[1e5]], replace(THREE, muscles=(replace(level, channel=0),))))


def test_muscles_that_stay_and_channels_that_are_shared_have_a_mirror_where_they_go_together() -> None:
    assert is_even(start_of(EVEN, positions=False)) and not is_even(start_of([[1e5, 0.0, 0.0]], positions=False))
    aside, x = moved(start_of(EVEN), 0, 0.01)
    assert mirror_of(replace(aside, vary_positions=False), x[-3:]) is None
    shared = [replace(THREE, muscles=tuple(map(_on, THREE.muscles, channels))) for channels in ((0, 1, 0), (0, 0, 1))]
    assert is_even(start_of([[1e5, 2e5]], shared[0]))
    assert mirror_of(*start_of([[1e5, 2e5]], shared[1])) is None


def _on(muscle, channel):
    return replace(muscle, channel=channel)


def test_targets_are_even_as_far_as_their_points_can_say() -> None:
    sheet, rng = rolled_sheet(2.0, n=41), np.random.default_rng(3)
    drawn = sheet[rng.permutation(len(sheet))[:1500]] + rng.normal(0, 6e-4, (1500, 3))
    aslant = drawn + np.outer(drawn[:, 0] * 0.05, [0.0, 0.0, 1.0])
    edge = Wish("", tuple((u, 0.2) for u in np.linspace(0, 0.2, 9)), ((0.0, 0.0, 0.04),) * 9, (False, False, True))
    corner = replace(edge, places=edge.places[:1], goals=edge.goals[:1])
    wishes = [Target(np.zeros((1, 3)), landmarks=Landmarks.of(of, THREE.fabric)) for of in ([edge], [edge, corner])]
    left, both = (Weighting((Region(((0, 0), (u, 0), (u, 0.1), (0, 0.1)), 3.0),), 0.2, 0.2) for u in (0.1, 0.2))
    targets = [Target(drawn), wishes[0], Target(drawn, weighting=both)]
    others = [Target(aslant), wishes[1], Target(drawn, weighting=left), Target(drawn, free=True)]
    assert [has_even_targets(Objective([target])) for target in targets] == [True] * 3
    assert [has_even_targets(Objective([target])) for target in others] == [False] * 4
    assert not has_even_targets(Objective([targets[0], others[0]]))


@pytest.mark.parametrize("even", [True, False])
def test_a_search_stays_even_where_the_target_is(even: bool) -> None:
    """Noise alone would lead it off; and to an uneven target it goes."""
    target = target_under(EVEN if even else [[250e3, 120e3, 150e3]])
    with History(":memory:", "a") as history:
        searched = evaluations_of(target, [start_of([[200e3, 200e3, 200e3]])], history)
        [(space, x)] = searched.starts
        before = searched.objective.value(searched.objective.shapes(AnalyticCloth(11), [space.decode(x)])[0])
        search(searched)
    assert searched.best is not None and searched.best.value < 0.7 * before
    assert is_even(searched.best_point()) == even


def test_an_even_layout_is_taken_before_one_that_is_as_near() -> None:
    even = start_of(EVEN)
    with History(":memory:", "a") as history:
        searched = evaluations_of(target_under(EVEN), [moved(even, 0, 0.01), even], history)
        best = searched.reached.best = Best(0, searched.starts[0][1], 4.00e-3, 0)
        for value, first in ((4.05e-3, 1), (4.20e-3, 0)):
            searched.reached.rivals = {0: best, 1: Best(1, even[1], value, 0)}
            nearest = searched.nearest()
            assert nearest is not None and nearest.start == first
            assert is_even(searched.finalists()[0]) == bool(first) and len(searched.finalists()) == 1 + first

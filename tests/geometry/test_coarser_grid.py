"""Where 41 points a side are as good as a model's 61, and where not."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model, Parameter
from studies.prediction.forward_model import ByDesign, enough_points

DESIGN = build("cross")
MODEL = Model({"muscle_gain": Parameter(0.9)}, points_per_side=61)


def trial(name: str, kilopascals: float, named: str = "cross", design=DESIGN):
    program, times = constant_program([1e3 * kilopascals] * 2), np.array([0.5, 1.0])
    return SimpleNamespace(name=name, design_name=named, design=design, program=program, times=times, order=0)


TRIALS = [trial(f"{k:03d}", 20.0 * k) for k in range(12)]


class Grid:
    """Shapes that depend on the grid above 210 kPa alone, by `apart` m."""

    asked: ClassVar[list[float]] = []

    def __init__(self, side: int, apart: float):
        self.shift = apart if side == 41 else 0.0

    def motions(self, cases, times):
        Grid.asked += [case.program.pressure.max() for case in cases]
        assert all(0.9 in case.factors.values() for case in cases)
        still = [self.shift * (case.program.pressure.max() > 210e3) for case in cases]
        return [np.stack([rolled_sheet(n=5) + [0, 0, s]] * len(t)) for s, t in zip(still, times, strict=True)]


@pytest.mark.parametrize(("apart", "points"), [(0.00009, 41), (0.00011, 61), (np.nan, 61)])
def test_the_most_driven_trial_decides(apart, points):
    lines, Grid.asked = [], []
    forward = enough_points(MODEL, TRIALS, lambda side: Grid(side, apart), tell=lines.append)
    assert isinstance(forward, ByDesign) == (points == 41)
    assert Grid.asked == [220e3, 220e3]
    assert len(lines) == 1 and f"grid: {points} points a side for cross" in lines[0] and "011 moves" in lines[0]


def test_a_design_that_differs_keeps_the_fine_grid_for_itself():
    other = build("side")
    calm = [trial(f"1{k:02d}", 100.0, "side", other) for k in range(12)]
    lines = []
    forward = enough_points(MODEL, [*TRIALS, *calm], lambda side: Grid(side, 0.0002), tell=lines.append)
    assert forward.calm == (other,) and len(lines) == 2
    driven = [Case(design, TRIALS[-1].program, {"muscle_gain": 0.9}) for design in (other, DESIGN, other)]
    shifts = [motion[0, 0, 2] - rolled_sheet(n=5)[0, 2] for motion in forward.motions(driven, [np.zeros(1)] * 3)]
    assert np.allclose(shifts, [0.0002, 0.0, 0.0002])


def test_nothing_is_tried_for_few_trials_or_on_the_coarser_grid():
    for model, some, points in ((MODEL, TRIALS[:5], 61), (Model(), TRIALS, 41)):
        asked = []
        forward = enough_points(model, some, lambda side, asked=asked: asked.append(side) or Grid(side, 0.0))
        assert isinstance(forward, Grid) and asked == [points]

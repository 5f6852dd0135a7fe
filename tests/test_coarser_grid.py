"""Where 41 points a side are as good as a model's 61, and where not."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.catalogue import build
from fabdesign.model import Model, Parameter
from fabdesign.pressure_file import constant_program
from studies.coarser_grid import enough_points

DESIGN = build("cross")
MODEL = Model({"muscle_gain": Parameter(0.9)}, points_per_side=61)


def trial(name: str, kilopascals: float, design: str = "cross"):
    program, times = constant_program([1e3 * kilopascals] * 2), np.array([0.5, 1.0])
    return SimpleNamespace(name=name, design_name=design, design=DESIGN, program=program, times=times, order=0)


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
    assert enough_points(MODEL, TRIALS, lambda side: Grid(side, apart), tell=lines.append) == points
    assert Grid.asked == [220e3, 220e3]
    assert len(lines) == 1 and f"grid: {points} points a side" in lines[0] and "cross 011" in lines[0]


def test_one_design_that_differs_keeps_the_fine_grid_for_all():
    calm = [trial(f"1{k:02d}", 100.0, "side") for k in range(12)]
    assert enough_points(MODEL, [*TRIALS, *calm], lambda side: Grid(side, 0.0002)) == 61
    assert enough_points(MODEL, calm, lambda side: Grid(side, 0.0002)) == 41


def test_nothing_is_tried_for_few_trials_or_on_the_coarser_grid():
    assert enough_points(MODEL, TRIALS[:5], lambda side: pytest.fail("tried")) == 61
    assert enough_points(Model(), TRIALS, lambda side: pytest.fail("tried")) == 41

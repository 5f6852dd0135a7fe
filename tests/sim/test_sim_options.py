"""The simulator's options: what they may be, in a line; its example runs."""

import doctest
from dataclasses import replace

import numpy as np
import pytest

import fabdesign
import sim.simulator
from fabdesign.errors import InputError
from fabdesign.files import motion_file
from fabdesign.files.pressure_file import constant_program
from fabdesign.interface import motions as interface_motions
from fabdesign.nouns import design, model, muscle
from fabdesign.nouns.forward import Case
from sim import Simulator


@pytest.mark.parametrize(
    ("option", "value", "problem"),
    [
        ("points_per_side", 8, "points_per_side is 8; expected a whole number from 9 to 161"),
        ("points_per_side", 21.5, "points_per_side is 21.5; expected a whole number from 9 to 161"),
        ("points_per_side", "41", "points_per_side is '41'; expected a whole number from 9 to 161"),
        ("time_step", 0.0, "time_step is 0.0; expected a number from 1e-06 to 0.00416667 s"),
        ("time_step", 1 / 100, "time_step is 0.01; expected a number from 1e-06 to 0.00416667 s"),
        ("time_step", np.nan, "time_step is nan; expected a number from 1e-06 to 0.00416667 s"),
        ("calm_steps", 0, "calm_steps is 0; expected a whole number from 1 to 64"),
        ("iterations", True, "iterations is True; expected a whole number from 1 to 1000"),
        ("tolerance", -1e-7, "tolerance is -1e-07; expected a number from 1e-12 to 0.001 m"),
        ("rho", 2.0, "rho is 2.0; expected a number from 0 to 1"),
        ("self_contact", 1, "self_contact is 1; expected True or False"),
    ],
)
def test_option_out_of_range_is_told_in_a_line(option, value, problem):
    with pytest.raises(InputError, match=f"^{problem}$"):
        Simulator(**{option: value})


def test_extreme_options_can_be_tried_finer():
    least = Simulator(time_step=1e-6, iterations=1000, calm_steps=1)
    assert least.finer() == least
    assert Simulator().finer() == replace(Simulator(), time_step=1 / 3840, calm_steps=4, iterations=32)


def test_numpy_numbers_are_numbers():
    assert Simulator(np.int64(21), time_step=np.float64(1 / 960)).points_per_side == 21


def test_a_motion_has_tensions_and_contractions():
    cloth = fabdesign.build("vertical", muscles=2)
    shape = fabdesign.equilibrium(cloth, [300, 100], grid=21)
    (simulated,) = Simulator(21).rest([Case(cloth, constant_program([3e5, 1e5]))])
    assert np.array_equal(shape.tension, simulated.tension) and np.array_equal(shape.contraction, simulated.contraction)
    strong, weak = (shape.contraction[0, shape.muscles.owners == muscle].mean() for muscle in (0, 1))
    assert shape.tension.shape == (1, len(shape.muscles.owners)) and strong > weak > 0


@pytest.mark.parametrize(
    "module",
    [sim.simulator, design, model, muscle, fabdesign, interface_motions, motion_file],
    ids=lambda module: module.__name__,
)
def test_example_runs(module):
    done = doctest.testmod(module)
    assert done.attempted > 0 and done.failed == 0

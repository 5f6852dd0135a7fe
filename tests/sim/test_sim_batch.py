"""Lanes, bits, mirror images, instants, factors and divergence."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import sim.simulator
from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from sim import Simulator
from sim.equilibrium import Approach
from tests.sim_designs import held, laced
from tests.thrown import tried_once

SIMULATOR = Simulator(points_per_side=21)
TIMES = np.array([0.1, 0.15])


def run(*cases, times=TIMES):
    return SIMULATOR.run(cases, [times] * len(cases))


@pytest.fixture(scope="module")
def designs():
    return laced(), laced("cross", 2), laced("vertical", 3)


@pytest.fixture(scope="module")
def cases(designs):
    return [held(designs[0], (200, 100, 0, 50)), held(designs[1], (150, 0)), held(designs[2], (0, 100, 50))]


@pytest.fixture(scope="module")
def motions(cases):
    return run(*cases)


def test_same_batch_twice_gives_the_same_bits(cases, motions):
    for again, motion in zip(run(*cases), motions, strict=True):
        assert np.array_equal(again.points, motion.points)


def test_design_alone_gives_the_bits_it_gives_among_others(cases, motions):
    assert np.array_equal(run(cases[1])[0].points, motions[1].points)


def test_kernel_for_one_design_agrees_with_the_one_for_many(tmp_path):
    design = build("cross", muscles=2)
    write_design(design, tmp_path / "cross.toml")
    many = Simulator().motions([held(design, (150, 50))], [np.arange(4) / 60])[0]
    simulate = (sys.executable, "-m", "fabdesign", "simulate", "cross.toml")
    command = (*simulate, "--pressures", "150,50", "--duration", "0.05")
    unset = {name: value for name, value in os.environ.items() if name != "FABDESIGN_LANES"}
    subprocess.run((*command, "-o", "m.npz"), cwd=tmp_path, env=unset, check=True, timeout=300)
    apart = np.abs(np.load(tmp_path / "m.npz")["points"] - many)
    assert apart.max() < 3e-5 and np.sqrt(np.mean(apart**2)) < 1e-5  # what two solves to 1e-7 m a step add up to


def test_lanes_must_be_known(tmp_path):
    process = subprocess.run(
        (sys.executable, "-c", "import sim"), env={**os.environ, "FABDESIGN_LANES": "3"}, capture_output=True, text=True
    )
    assert "FABDESIGN_LANES is '3'; expected 1, 2, 4, 8 or 16" in process.stderr


def test_mirror_images(designs):
    # exchanging front and back turns z around (channels 0, 1 are on the front, 2, 3 behind), exchanging 0 and 1, and
    # 2 and 3, left and right
    pressures = (200, 100, 0, 50), (0, 50, 200, 100), (100, 200, 50, 0)
    plain, turned, mirrored = (m.middle for m in SIMULATOR.run([held(designs[0], p) for p in pressures], [TIMES] * 3))
    assert np.abs(turned * (1, 1, -1) - plain).max() < 1e-5
    assert np.abs(mirrored[:, :, ::-1] * (-1, 1, 1) - plain).max() < 1e-5


def test_frames_at_any_instants(cases, motions):
    # a frame does not depend on which others are asked for, and lies between its neighbours
    times = np.array([0.0, 1e-4, 0.1, 0.1013, 0.1021, 0.15])
    motion = run(cases[0], times=times)[0]
    assert np.array_equal(motion.middle[[2, 5]], motions[0].middle)
    assert (
        np.abs(motion.middle[1] - motion.middle[0]).max() < 2e-5
    )  # a t^2 / 2 of a node of 0.1 g under a muscle's pull
    part = (times[3] - times[2]) / (times[4] - times[2])
    between = (1 - part) * motion.middle[2] + part * motion.middle[4]
    assert np.abs(motion.middle[3] - between).max() < 0.02 * np.abs(motion.middle[4] - motion.middle[2]).max()


def test_frame_at_rest_alone(designs):
    rest = run(held(designs[0], (200, 100, 0, 50)), times=np.array([0.0]))[0]
    later = run(held(designs[0], (200, 100, 0, 50)), times=np.array([0.0, 0.1]))[0]
    assert np.array_equal(rest.middle[0], later.middle[0])


def test_cases_of_one_batch_have_times_of_their_own(cases, motions):
    short, long = SIMULATOR.run([cases[1], cases[0]], [np.array([0.02]), TIMES])
    assert short.points.shape == (1, 3362, 3)
    assert np.array_equal(long.points, motions[0].points)


def test_diverged_lane_is_marked_alone(cases, motions):
    broken = held(cases[0].design, (400, 0, 0, 0), muscle_gain=1e7)
    first, lost, last = run(cases[0], broken, cases[1])
    assert lost.diverged is not None
    when, (row, column) = lost.diverged
    assert when == TIMES[0] and 0 <= row < 21 and 0 <= column < 21
    assert np.isnan(lost.points).all()
    assert first.diverged is None and np.array_equal(first.points, motions[0].points)
    assert last.diverged is None and np.array_equal(last.points, motions[1].points)


def test_diverged_motion_is_tried_again_with_half_the_steps(cases, motions, monkeypatch):
    # the second of three is lost at the first try
    finer = Simulator(points_per_side=21, time_step=1 / 3840, calm_steps=4, iterations=32)
    [expected] = tried_once(finer, [cases[1]], [TIMES], Approach.PATIENT)
    motion_of, tries = sim.simulator.motion_of, []

    def losing(case, *given):
        tries.append(case)
        motion = motion_of(case, *given)
        return replace(motion, diverged=(0.1, (0, 0))) if case is cases[1] and len(tries) <= len(cases) else motion

    monkeypatch.setattr(sim.simulator, "motion_of", losing)
    for one, wanted in zip(run(*cases), (motions[0], expected, motions[2]), strict=True):
        assert one.diverged is None and np.array_equal(one.middle, wanted.middle)


def test_a_cloth_that_long_steps_do_not_bring_to_rest_starts_from_a_damped_motion(designs, monkeypatch):
    tilted = replace(designs[0], fabric=replace(designs[0].fabric, gravity=(0.0, -9.7, -1.4)))
    [motion] = run(held(tilted, (200, 100, 0, 50)))
    rested = sim.equilibrium.rested
    monkeypatch.setattr(sim.equilibrium, "rested", lambda batch: np.zeros_like(rested(batch)))
    [other] = run(held(tilted, (200, 100, 0, 50)))
    assert other.diverged is None and not np.array_equal(other.middle, motion.middle)
    assert np.abs(other.middle - motion.middle).max() < 2e-4


def test_factors_multiply_the_declared_values(designs):
    # the motion with a factor is that of a design with the multiplied value
    design, kpa, f = designs[0], (200, 100, 0, 50), 1.2
    fabric, kind = design.fabric, design.muscle_types["EM20"]
    scaled = {
        "membrane": {"membrane_stiffness": (f * 520.0, f * 520.0)},
        "shear": {"shear_stiffness": f * fabric.shear_stiffness},
        "bending": {"bending_stiffness": (f * 0.006, f * 0.006)},
        "areal_density": {"areal_density": f * fabric.areal_density},
    }
    declared = [held(replace(design, fabric=replace(fabric, **change)), kpa) for change in scaled.values()]
    types = {
        "axis_offset": replace(kind, axis_offset=f * kind.axis_offset),
        "damping": replace(kind, viscosity=f * kind.viscosity),
    }
    damped = replace(fabric, viscosity=f * fabric.viscosity, air_damping=f * fabric.air_damping)
    declared += [
        held(replace(design, fabric=damped if name == "damping" else fabric, muscle_types={"EM20": changed}), kpa)
        for name, changed in types.items()
    ]
    names = [*scaled, *types]
    plain, *factored = run(held(design, kpa), *(held(design, kpa, **{name: f}) for name in names))
    for name, motion, expected in zip(names, factored, run(*declared), strict=True):
        assert np.abs(motion.middle - expected.middle).max() < 1e-6, name
        assert np.abs(motion.middle - plain.middle).max() > 1e-6, name


def test_muscle_gain_acts_on_what_pressure_adds(designs):
    # F = F(0, eps) + gain (F(p, eps) - F(0, eps)): no effect at zero pressure
    idle, gained_idle = run(held(designs[0], (0,) * 4), held(designs[0], (0,) * 4, muscle_gain=1.5))
    assert np.array_equal(idle.points, gained_idle.points)
    plain, gained = run(held(designs[0], (100, 0, 0, 0)), held(designs[0], (100, 0, 0, 0), muscle_gain=1.5))
    assert np.abs(gained.middle - plain.middle).max() > 1e-3


def test_design_with_many_fixed_points_moves():
    # the arrays by mode and by row are then the longest
    design = laced(muscles=8)
    motion = Simulator(points_per_side=21).run([held(design, (100,) + (0,) * 7)], [np.array([0.01])])[0]
    assert sum(len(m.fixed_points()) for m in design.muscles) == 80
    assert motion.diverged is None and np.abs(motion.middle[..., 2]).max() > 1e-5

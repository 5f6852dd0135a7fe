"""The simulator against closed forms, on a coarse grid; the finer ones are in tests/verify."""

from dataclasses import replace

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.muscle_law import MuscleLaw
from sim import Simulator
from tests.sim_designs import around, cloth, held, laced, linear_muscle, middle

SIMULATOR = Simulator(points_per_side=21)
G = 9.81


def shape(design, kpa=(), **factors):
    return middle(SIMULATOR.equilibria([held(design, kpa, **factors)])[0])


def test_hanging_sheet_sags_by_its_weight():
    # u(L) = rho g L^2 / 2 k
    design = cloth(poisson=0.0, membrane_stiffness=(520.0, 100.0), areal_density=1.0)
    sag = -0.2 - shape(design)[-1, :, 1]
    assert sag == pytest.approx(1.0 * G * 0.2**2 / (2 * 100.0), rel=0.02)


def test_strip_stretches_and_narrows():
    # e_2 = T / k_2, e_1 = -nu_21 e_2, T of a weight along the lower edge; far from the held edge
    width, length, tension = 0.05, 0.2, 26.0
    bar = linear_muscle(1e-3, 0.0, name="bar", mass_per_length=tension / G, axis_offset=0.0)
    weight = Muscle("bar", "front", 0, ((0.0, length), (width, length)), width)
    design = cloth(weight, types={"bar": bar}, width=width, areal_density=1e-3)
    points = shape(design, (0,))
    stretch = (points[15, 20, 1] - points[25, 20, 1]) / (10 * length / 40) - 1
    narrow = (points[20, -1, 0] - points[20, 0, 0]) / width - 1
    assert stretch == pytest.approx(tension / 520, rel=0.01)
    assert narrow == pytest.approx(-0.25 * tension / 520, rel=0.05)


def test_cantilever_bends_under_its_weight():
    # z(L) = w L^4 / 8 B
    w = 0.1
    design = cloth(poisson=0.0, areal_density=w / G, gravity=(0.0, 0.0, -G), support="clamped")
    tip = -shape(design)[-1, :, 2]
    assert tip == pytest.approx(w * 0.2**4 / (8 * 0.006), rel=0.03)


def test_isometric_muscle_pulls_as_on_the_bench():
    # both ends held, in the mid-surface lest the cloth's slope there moves them: F = F(p, 0)
    ends = ((0.1, 0.05), (0.1, 0.15))
    kind = replace(laced().muscle_types["EM20"], axis_offset=0.0)
    design = cloth(
        Muscle("EM20", "front", 0, ends, 0.1), types={"EM20": kind}, hung=around(ends, 0.01), gravity=(0.0, 0.0, 0.0)
    )
    law = MuscleLaw.fit(kind.bench)
    cases = [held(design, (kpa,)) for kpa in (100.0, 200.0, 300.0)]
    motions = SIMULATOR.run(cases, [np.array([0.5])] * 3)
    for case, motion in zip(cases, motions, strict=True):
        assert motion.tension[-1, 0] == pytest.approx(float(law.tension(case.program.pressure[0, 0], 0.0)), rel=0.01)


def test_equal_pressures_front_and_back_shorten_without_bending():
    design = laced(gravity=(0.0, 0.0, 0.0), hung="none")
    flat = shape(design, (100,) * 4)
    assert np.abs(flat[..., 2] - flat[..., 2].mean()).max() < 1e-5
    assert np.ptp(flat[:, 20, 1]) < 0.199


def test_bare_sheet_moves():
    # released from rest: it stays in its equilibrium
    motion = SIMULATOR.run([held(cloth())], [np.array([0.0, 0.2])])[0]
    assert np.abs(motion.middle[1] - motion.middle[0]).max() < 1e-5
    assert motion.tension.shape == (2, 0)


@pytest.mark.parametrize("gravity", [(0.0, -G, 0.0), (0.0, 0.0, -G)])
def test_free_cloth_starts_flat_and_falls(gravity):
    # -g t^2 / 2 of every point, with muscles without pressure or none, for 11 m
    times = np.array([0.0, 0.1, 0.5, 1.5])
    flat = np.stack([*np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, -0.2, 41)), np.zeros((41, 41))], axis=-1)
    designs = [change(hung="none", gravity=gravity, air_damping=0.0) for change in (cloth, laced)]
    cases = [held(designs[0]), held(designs[1], (0,) * 4)]
    for motion in SIMULATOR.motions(cases, [times] * 2):
        for points, time in zip(motion, times, strict=True):
            fallen = np.array(gravity) * time**2 / 2
            off = np.abs(middle(points) - flat - fallen).max()
            assert off < 1e-7 + 1e-3 * np.linalg.norm(fallen)


@pytest.mark.parametrize(
    ("design", "times", "problem"),
    [
        (laced(), np.arange(20_000) / 1e4, "20000 frames in 1.9999 s with 21 grid points a side take 2.6 GB"),
        (laced(fixed_point_pitch=0.001), np.zeros(1), "740 fixed points in a design; expected at most 528"),
    ],
)
def test_what_memory_cannot_hold_is_refused(design, times, problem):
    with pytest.raises(InputError, match=problem):
        SIMULATOR.motions([held(design, (0,) * 4)], [times])


@pytest.mark.parametrize(
    ("gravity", "changes"),
    [
        ((0.0, -G, 6.0), {}),
        ((0.0, 0.0, -G), {}),
        ((3.0, -G, 0.0), {"hung": ((0.0, 0.0), (0.2, 0.0))}),
        ((0.0, 0.0, -G), {"support": "clamped"}),
    ],
)
def test_rest_is_rest_whichever_way_it_hangs(gravity, changes):
    design = laced(gravity=gravity, **changes)
    motion = SIMULATOR.run([held(design, (0,) * 4)], [np.array([0.0, 0.5])])[0]
    assert np.abs(motion.middle[1] - motion.middle[0]).max() < 1e-4
    if not changes:  # a hinge: along gravity, but for the muscles' bending
        lower = motion.middle[0, -1].mean(axis=0)
        assert lower / np.linalg.norm(lower) == pytest.approx(np.array(gravity) / np.linalg.norm(gravity), abs=3e-3)

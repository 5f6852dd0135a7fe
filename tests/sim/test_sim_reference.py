"""The kernels against the slow float64 reference, and the reference against its own energy."""

import numpy as np
import pytest

from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator
from tests.sim.sim_reference import ReferenceSheet
from tests.sim.sim_reference_effects import ReferenceWithEffects
from tests.sim_designs import cloth, held, laced, middle

EXACT = Simulator(points_per_side=11, time_step=1 / 240, calm_steps=1, iterations=60, tolerance=1e-8)
N = EXACT.points_per_side


@pytest.mark.parametrize("support", ["pinned", "clamped"])
def test_reference_force_is_the_gradient_of_its_energy(support):
    # f . w = -dE/dw, central difference
    design = cloth(
        gravity=(0.0, 0.0, 0.0), membrane_stiffness=(500.0, 300.0), bending_stiffness=(0.006, 0.004), support=support
    )
    sheet, random = ReferenceSheet(design, 7), np.random.default_rng(0)
    x = sheet.rest + 0.003 * random.standard_normal(sheet.rest.shape)
    w = random.standard_normal(x.shape)
    force, _ = sheet.evaluate(x, 0 * x, [])
    slope = (sheet.energy(x + 1e-6 * w) - sheet.energy(x - 1e-6 * w)) / 2e-6
    assert -np.sum(force * w) == pytest.approx(slope, rel=1e-6)


def test_muscles_exert_no_resultant_and_no_moment():
    design = laced(gravity=(0.0, 0.0, 0.0))
    sheet, random = ReferenceSheet(design, 9), np.random.default_rng(0)
    x = sheet.rest + 0.002 * random.standard_normal(sheet.rest.shape)
    force, _ = sheet.evaluate(x, 0 * x, [2e5] * 4)
    assert np.abs(force.sum(0)).max() < 1e-12 * np.abs(force).sum()
    assert np.abs(np.cross(x, force).sum(0)).max() < 1e-12 * np.abs(force).sum()


def test_equilibrium_and_motion_follow_the_reference():
    # the same space and time discretisation, solved tightly: rounding is what is left
    design = laced(membrane_stiffness=(520.0, 400.0), bending_stiffness=(0.006, 0.004))
    sheet, pressure = ReferenceSheet(design, N), [200.0, 100.0, 0.0, 50.0]
    rest = sheet.equilibrium(np.zeros(4))
    steps = np.array([0, 4, 10])
    h = EXACT.time_step
    frames = sheet.motion(lambda t: np.array(pressure) * 1e3, h, 10, rho=EXACT.rho, start=rest, jumps=(0,))[steps]
    motion = EXACT.run([held(design, pressure)], [steps * h])[0]
    assert np.abs(frames[-1] - rest).max() > 5e-3
    assert np.abs(motion.middle.reshape(3, -1, 3) - frames).max() < 1e-5
    assert motion.contraction[-1] == pytest.approx(sheet.contraction, abs=2e-5)
    final = sheet.equilibrium(np.array(pressure) * 1e3, start=frames[-1]).reshape(N, N, 3)
    shape = middle(EXACT.equilibria([held(design, pressure)])[0])[:: 40 // (N - 1), :: 40 // (N - 1)]
    assert np.abs(shape - final).max() < 2e-5


def test_clamped_edge_follows_the_reference():
    design = cloth(support="clamped", gravity=(0.0, -7.0, -7.0), bending_stiffness=(0.006, 0.003))
    sheet = ReferenceSheet(design, N)
    final = sheet.equilibrium().reshape(N, N, 3)
    shape = middle(EXACT.equilibria([held(design)])[0])[:: 40 // (N - 1), :: 40 // (N - 1)]
    assert np.abs(final[-1, :, 2]).min() > 0.03
    assert np.abs(shape - final).max() < 2e-5


EFFECTS = {
    "muscle_creep": ({"share": 0.6, "time": 0.02, "on_bench": 0.9}, {"creep": (0.6, 0.02, 0.9)}),
    "braid_hysteresis": (
        {"friction": 0.004, "friction_at_zero": 0.1, "slip": 0.004}, {"hysteresis": (4e-6, 0.1, 0.004)},
    ),
    "line_loss": ({"share": 0.4}, {"loss": 0.4}),
    "odd_muscle": ({"channel": 0.0, "factor": 0.7}, {"gains": {0: 0.7}}),
    "air_drag": ({"coefficient": 20.0}, {"drag": 20.0}),
    "rest_curvature": ({"across": 1.0, "down": 2.0, "twist": 0.7}, {"curl": (1.0, 2.0, 0.7)}),
    "threshold_pressure": ({"threshold": 60.0, "width": 15.0}, {"threshold": (60e3, 15e3 * np.tanh(4.0))}),
    "muscle_viscosity": ({"contracting": 30.0, "lengthening": 10.0}, {"viscous": (30.0, 10.0)}),
    "local_stiffening": (
        {"u": 0.07, "v": 0.06, "radius": 0.05, "factor": 4.0}, {"patch": (0.07, 0.06, 0.05, 4.0)},
    ),
    "stress_relaxation": ({"share": 0.4, "time": 0.03}, {"relaxation": (0.4, 0.03)}),
    "learned": ({"stroke": 15.0, "spring": -6.0}, {"learned": (15.0, -6.0)}),
    "added_mass": ({"u": 0.13, "v": 0.17, "mass": 0.005}, {"added": (0.13, 0.17, 0.005)}),
}  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_follow_the_reference(name, without_effects):
    # up and, 6 steps later, down again: friction turns round, creep goes back
    values, options = EFFECTS[name]
    h, times = EXACT.time_step, EXACT.time_step * np.arange(11)
    case = Case(laced(), PressureProgram(np.array([0.0, 6 * h]), UP_AND_DOWN, 1.0), effects=(Term(name, values),))
    [motion] = EXACT.run([case], [times])
    expected = _reference(ReferenceWithEffects(laced(), N, **options))
    error = np.abs(motion.middle.reshape(11, -1, 3) - expected).max()
    assert error < 2e-5 < np.abs(expected - without_effects).max() / 5


UP_AND_DOWN = np.array([[200.0, 100.0, 0.0, 50.0], [100.0, 150.0, 0.0, 50.0]]) * 1e3  # Pa


@pytest.fixture(scope="module")
def without_effects():
    return _reference(ReferenceSheet(laced(), N))


def _reference(sheet):
    """Frames after every step under UP_AND_DOWN."""
    h, rest = EXACT.time_step, sheet.equilibrium(np.zeros(4))
    return sheet.motion(lambda t: UP_AND_DOWN[int(t >= 6 * h)], h, 10, rho=EXACT.rho, start=rest, jumps=(0, 6))

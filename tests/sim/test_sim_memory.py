"""A force with memory (examples/cloth_creep.py): its closed form, at rest at the start, at its limit, alone and among
others."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from fabdesign.effects import EFFECTS, register_file
from fabdesign.nouns.forward import Term
from sim import Simulator, state
from sim.forces.added import AddedForce
from sim.materials import Constant, declare
from tests.conftest import ROOT
from tests.sim_designs import cloth, held, laced

SIMULATOR = Simulator(points_per_side=21)
SHARES, TIMES = (0.15, 0.25), (0.1, 0.5)  # s
CREEP = (Term("cloth_creep", {"share_1": SHARES[0], "share_2": SHARES[1]}),)


@pytest.fixture(scope="module", autouse=True)
def known():
    """The effect of the example, known to these tests alone."""
    register_file(ROOT / "examples" / "cloth_creep.py")
    yield
    del EFFECTS["cloth_creep"]


def strain(middle):
    """Mean strain along v of the topmost edges, which carry nearly all of the cloth's weight."""
    return (middle[..., 0, :, 1] - middle[..., 1, :, 1]).mean(-1) / (0.2 / 20) - 1


@pytest.fixture(scope="module")
def hanging():
    """Frames and strains under its own weight of a strip without transverse contraction, light damping."""
    times = np.array([0.0, 0.1, 0.2, 0.4, 0.8])
    case = replace(held(cloth(poisson=0.0, areal_density=6.0, air_damping=20.0), ()), effects=CREEP)
    return case, times, SIMULATOR.run([case], [times])[0]


def test_creep_under_a_weight_is_its_closed_form(hanging):
    # K (e - z_1 - z_2) = T: d z_i / d t = (s_i (T / K + z_1 + z_2) - z_i) / tau_i, from z = 0
    _, times, motion = hanging
    shares, taus = np.array(SHARES), np.array(TIMES)
    rate = (shares[:, None] - np.eye(2)) / taus[:, None]
    limit = np.linalg.solve(-rate, shares / taus)
    grown = [1 + (limit - scipy.linalg.expm(rate * t) @ limit).sum() for t in times]
    strains = strain(motion.middle.astype(float))
    assert strains[0] == pytest.approx(6.0 * 9.81 * 0.195 / 520, rel=1e-3)  # elastic: memory is at rest at the start
    assert strains / strains[0] == pytest.approx(grown, abs=0.015)  # of first order: steps of 1/240 s against 0.1 s
    assert grown[-1] > 1.4


def test_creep_does_not_depend_on_how_often_a_step_evaluates(hanging):
    case, times, motion = hanging
    [again] = replace(SIMULATOR, iterations=32, tolerance=2e-8).run([case], [times])
    crept = np.abs(motion.middle[-1] - motion.middle[0]).max()
    assert np.abs(again.middle - motion.middle).max() < 0.01 * crept


def test_creep_halves_its_error_with_the_steps(hanging):
    case, times, motion = hanging
    halves, quarters = (
        replace(SIMULATOR, calm_steps=calm).run([case], [times])[0].middle.astype(float) for calm in (4, 2)
    )
    strains = strain(motion.middle.astype(float))
    assert np.abs(strain(halves) - strain(quarters))[2:].max() < 0.7 * np.abs(strains - strain(halves))[2:].max()


def test_equilibrium_has_memory_at_its_limit():
    case = replace(held(cloth(poisson=0.0, areal_density=6.0), (0,)), effects=CREEP)
    crept, elastic = SIMULATOR.equilibria([case, replace(case, effects=())])
    below = (shape.reshape(2, 41, 41, 3)[:, -1, :, 1].mean() + 0.2 for shape in (crept.astype(float), elastic))
    assert next(below) / next(below) == pytest.approx(1 / (1 - sum(SHARES)), rel=0.02)


def test_lanes_with_and_without_ride_together_and_leave_nothing():
    design, times = laced(), np.array([0.02, 0.05])
    plain = held(design, (200, 100, 0, 50))
    crept = replace(plain, effects=CREEP)
    first, second = SIMULATOR.run([plain, crept], [times] * 2)
    [alone] = SIMULATOR.run([crept], [times])
    [bare] = SIMULATOR.run([plain], [times])
    assert np.array_equal(second.middle, alone.middle)  # and nothing of the batch before is remembered
    assert np.array_equal(first.middle, bare.middle)
    assert np.abs(first.middle - second.middle).max() > 1e-5


def test_a_force_declares_what_it_remembers():
    plane = state.Plane("slip", "interval", "m", state.WORK, "of a muscle through its fixed points")
    with pytest.raises(ValueError, match="planes of an added force are loaded or remembered"):
        AddedForce(planes=(plane,))
    with pytest.raises(ValueError, match="constant 'S': there is one of this name already"):
        declare("S", Constant("N/m", "another", lambda lane: 0.0))

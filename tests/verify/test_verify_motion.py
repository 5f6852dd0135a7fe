"""Free swings of undamped sheets, set going by a short pulse of a weak muscle: modes, momentum, energy."""

from functools import cache

import numpy as np
import pytest
from scipy.special import j0, jn_zeros

from fabdesign.forward import Case
from fabdesign.muscle import Muscle
from fabdesign.pressure import PressureProgram
from sim import Simulator
from tests.sim_designs import cloth, linear_muscle
from tests.sim_reference import ReferenceSheet

SIMULATOR = Simulator(points_per_side=21)
G, L, PULSE = 9.81, 0.2, 0.05
UNDAMPED = {"viscosity": 0.0, "air_damping": 0.0}


def pulsed(times, pull, **changes):
    """A design with one massless front muscle of `pull` [N] down its middle, and its motion after 50 ms of that."""
    muscle = Muscle("linear", "front", 0, ((L / 2, 0.0), (L / 2, L)), 0.02)
    design = cloth(muscle, types={"linear": linear_muscle(1e-3, pull)}, **UNDAMPED, **changes)
    program = PressureProgram(np.array([0.0, PULSE]), np.array([[1e5], [0.0]]), float(times[-1]))
    return design, SIMULATOR.run([Case(design, program)], [times])[0].middle.astype(float)


@cache
def swing():
    times = PULSE + np.arange(1, 6 * 240) / 240
    return times, *pulsed(times, 0.02, bending_stiffness=(1e-5, 1e-5), poisson=0.0)


def test_modes(record):
    # a hanging chain: f_k = z_k sqrt(g / L) / 4 pi, J_0(z_k) = 0
    times, _, frames = swing()
    frequency = np.fft.rfftfreq(16 * len(times), times[1] - times[0])
    height, width = np.linspace(1, 0, 21), np.r_[0.5, np.ones(19), 0.5]
    for k, zero in enumerate(jn_zeros(0, 2), start=1):
        expected = zero * np.sqrt(G / L) / (4 * np.pi)
        share = np.outer(width * j0(zero * np.sqrt(height)), width)  # projects on the mode
        signal = np.einsum("tij,ij->t", frames[..., 2], share) * np.hanning(len(times))
        found = frequency[np.argmax(np.abs(np.fft.rfft(signal, 16 * len(times))))]
        record(f"hanging sheet, mode {k}", "3 %", f"{abs(found / expected - 1):.2%}")
        assert found == pytest.approx(expected, rel=0.03)


def test_energy_of_an_unforced_sheet(record):
    # cloth's energy + weight + kinetic at most its start + 0.1 % of its peak kinetic part
    times, design, frames = swing()
    sheet = ReferenceSheet(design, 21)
    x = frames.reshape(len(times), -1, 3)
    v = (x[2:] - x[:-2]) / (times[2] - times[0])
    kinetic = 0.5 * np.einsum("n,tnc,tnc->t", sheet.mass, v, v)
    total = kinetic + [sheet.energy(y) - np.sum(sheet.mass[:, None] * sheet.gravity * y) for y in x[1:-1]]
    gain = float((total - total[0]).max() / kinetic.max())
    record("energy of an unforced sheet, 6 s", "+0.1 %", f"{gain:+.3%} of the peak kinetic part")
    assert gain < 1e-3


def test_free_sheet_keeps_its_momentum(record):
    # no gravity, no support: the muscle's pulse adds none; scales: sum m |v|, sum m |r| |v|
    times = PULSE + np.arange(1, 361) / 240
    design, frames = pulsed(times, 2.0, hung="none", gravity=(0.0, 0.0, 0.0))
    sheet = ReferenceSheet(design, 21)
    x = frames.reshape(len(times), -1, 3)
    v = (x[2:] - x[:-2]) / (times[2] - times[0])
    r = x[1:-1] - x[0].mean(0)
    mass = sheet.mass[:, None]
    linear = np.abs((mass * v).sum(1)).max() / (mass * np.abs(v)).sum((1, 2)).max()
    angular = np.abs((mass * np.cross(r, v)).sum(1)).max()
    angular /= (sheet.mass * np.linalg.norm(r, axis=-1) * np.linalg.norm(v, axis=-1)).sum(1).max()
    record("free sheet, linear and angular momentum, 1.5 s", "1e-3", f"{linear:.1e}, {angular:.1e}")
    assert linear < 1e-3 and angular < 1e-3


def test_free_sheet_spinning():
    pytest.skip("1 rad/s at the start: every motion starts from rest; the pulse above stands in")

"""Free swings of undamped sheets, thrown or set going by a short pulse of a weak muscle: modes, momentum, energy."""

import numpy as np
import pytest
from scipy.special import j0, jn_zeros

from fabdesign.nouns.forward import Case
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator
from tests.sim.sim_reference import ReferenceSheet
from tests.sim_designs import cloth, linear_muscle
from tests.thrown import thrown

SIMULATOR = Simulator(points_per_side=21)
G, L, PULSE = 9.81, 0.2, 0.05
PITCH, SLACK = 0.02, 1e-3  # of the muscle that gives the pulse: m; N, its stiffness without pressure
UNDAMPED = {"viscosity": 0.0, "air_damping": 0.0}


def pulsed(times, pull, **changes):
    """A design with one massless front muscle of `pull` [N] down its middle, and its motion with 50 ms of that."""
    muscle = Muscle("linear", "front", 0, ((L / 2, 0.0), (L / 2, L)), PITCH)
    design = cloth(muscle, types={"linear": linear_muscle(SLACK, pull)}, **UNDAMPED, **changes)
    program = PressureProgram(np.array([0.0, PULSE]), np.array([[1e5], [0.0]]), float(times[-1]))
    return design, SIMULATOR.run([Case(design, program)], [times])[0]


def test_modes(record):
    # a hanging chain: f_k = z_k sqrt(g / L) / 4 pi, J_0(z_k) = 0, w_k = J_0(z_k sqrt(1 - v / L)); B k^4 is small
    times = np.arange(1, 6 * 240) / 240
    design = cloth(bending_stiffness=(1e-6, 1e-6), poisson=0.0, **UNDAMPED)
    frequency = np.fft.rfftfreq(16 * len(times), times[1] - times[0])
    height, width = np.linspace(1, 0, 21), np.r_[0.5, np.ones(19), 0.5]
    for k, zero in enumerate(jn_zeros(0, 2), start=1):
        expected = zero * np.sqrt(G / L) / (4 * np.pi)
        mode = np.outer(j0(zero * np.sqrt(height)), np.ones(21))
        start = 2e-3 * 2 * np.pi * expected * mode  # m/s: an amplitude of 2 mm
        frames = thrown(SIMULATOR, design, np.stack([0 * mode, 0 * mode, start], axis=-1), times)
        signal = np.einsum("tij,ij->t", frames[..., 2], mode * width[:, None] * width) * np.hanning(len(times))
        peak = frequency[np.argmax(np.abs(np.fft.rfft(signal, 16 * len(times))))]
        record(f"hanging sheet, mode {k}", "3 %", f"{abs(peak / expected - 1):.2%}")
        assert peak == pytest.approx(expected, rel=0.03)


def test_energy_of_an_unforced_sheet(record):
    # energy of cloth and slack muscle + weight + kinetic at most its start + 0.1 % of its peak kinetic part; velocities
    # over 0.5 ms, for the pulse leaves swings that differences over 1/120 s miss
    short = 1 / 3840
    times = np.add.outer(PULSE + np.arange(1, 6 * 240) / 240, (-short, 0.0, short))
    design, motion = pulsed(times.ravel(), 0.02, bending_stiffness=(1e-5, 1e-5), poisson=0.0)
    sheet = ReferenceSheet(design, 21)
    x = motion.middle.astype(float).reshape(len(times), 3, -1, 3)
    v = (x[:, 2] - x[:, 0]) / (2 * short)
    kinetic = 0.5 * np.einsum("n,tnc,tnc->t", sheet.mass, v, v)
    muscle = 0.5 * SLACK * PITCH * np.square(motion.contraction[1::3]).sum(axis=1)
    cloth_and_weight = [sheet.energy(y) - np.sum(sheet.mass[:, None] * sheet.gravity * y) for y in x[:, 1]]
    total = kinetic + muscle + cloth_and_weight
    gain = float((total - total[0]).max() / kinetic.max())
    record("energy of an unforced sheet, 6 s", "+0.1 %", f"{gain:+.3%} of the peak kinetic part")
    assert gain < 1e-3


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_free_sheet_keeps_its_momentum(axis, record):
    # 1 rad/s about its middle, no gravity, no support; scales: sum m |v|, the angular momentum at the start
    times = np.arange(1, 361) / 240
    design = cloth(hung="none", gravity=(0.0, 0.0, 0.0), **UNDAMPED)
    along = np.linspace(-L / 2, L / 2, 21)
    arm = np.stack(np.broadcast_arrays(along, -along[:, None], 0.0), axis=-1)
    frames = thrown(SIMULATOR, design, np.cross(axis, arm), times)
    mass = ReferenceSheet(design, 21).mass[:, None]
    x = frames.reshape(len(times), -1, 3)
    v = (x[2:] - x[:-2]) / (times[2] - times[0])
    linear = np.abs((mass * v).sum(1)).max() / (mass * np.abs(v)).sum((1, 2)).max()
    arm = arm.reshape(-1, 3)
    start = (mass * np.cross(arm, np.cross(axis, arm))).sum(0)
    momentum = (mass * np.cross(x[1:-1] - x[1:-1].mean(1, keepdims=True), v)).sum(1)
    angular = np.abs(momentum - start).max() / np.linalg.norm(start)
    record(f"free sheet spinning about {axis}, momentum, 1.5 s", "1e-3", f"{linear:.1e}, {angular:.1e}")
    assert linear < 1e-3 and angular < 1e-3

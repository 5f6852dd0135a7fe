"""A cloth that was seen leads a motion: the pull in closed form, a motion led along its own, and along another."""

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.geometry.shape import normals
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.column import SPRINGS
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.lead import BEGIN, DAMPERS, Lead, Way
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator

SIMULATOR = Simulator(21)
PROGRAM = PressureProgram(np.array([0.0, 0.5]), np.array([[3e5, 0, 0, 1e5], [0, 2e5, 0, 0]]), 1.0)
CASE = Case(build("basic", muscles=4), PROGRAM)
OTHER = Case(CASE.design, PROGRAM, {"muscle_gain": 1.1}, (Term("frame_tilt", {"about_x": 5.0, "about_z": 0.0}),))
TIMES = np.arange(1, 31) / 30  # s


def test_pull_is_of_springs_and_dampers_along_the_normal():
    """g = s (k (x_seen - x) + c (v_seen - v)) . n n, s rising to 1 within BEGIN."""
    u, v = np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.2, 5))
    flat, speed = np.stack([u, -v, 0 * u], axis=-1), np.array([0.0, 0.0, 0.3])
    normal = normals(flat[None])[0]
    time = np.linspace(0.0, 1.0, 6)
    lead = Lead(time, np.array([flat + t * speed for t in time]))
    there = flat + 0.5 * speed
    assert lead.pull(0.5, there, np.broadcast_to(speed, flat.shape), normal) == pytest.approx(np.zeros(flat.shape))
    away = lead.pull(0.5, there - 2e-3 * normal, np.zeros(flat.shape), normal)
    along = SPRINGS * 2e-3 + DAMPERS * (normal @ speed)[0, 0]
    assert away == pytest.approx(along * normal)
    early = 0.25 * BEGIN
    pulled = lead.pull(early, flat + early * speed + [0.1, 0.1, 1e-3], np.broadcast_to(speed, flat.shape), normal)
    assert pulled == pytest.approx(np.broadcast_to([0.0, 0.0, -0.25 * SPRINGS * 1e-3], flat.shape))
    assert lead.ahead(np.array([2.0]))[0] == pytest.approx(flat + speed)  # beyond the last frame it stands


@pytest.fixture(scope="module")
def motions():
    return SIMULATOR.run([CASE, OTHER], [TIMES, TIMES])


def apart(one, other):
    """(T,) m RMS over nodes, along the normals."""
    off = ((one - other) * normals(other)).sum(axis=-1)
    return np.sqrt(np.square(off).mean(axis=(1, 2)))


def test_a_motion_led_along_its_own_stays_as_it_is(motions):
    plain, other = motions
    fine = np.linspace(0.01, 1.0, 100)
    tracks = [Lead(fine, motion.middle.astype(float)) for motion in SIMULATOR.run([CASE, OTHER], [fine, fine])]
    led = SIMULATOR.led([CASE, OTHER, CASE], [*(Way(TIMES, track) for track in tracks), Way(TIMES)])
    assert apart(led[0].middle, plain.middle).max() < 2e-4 and apart(led[1].middle, other.middle).max() < 2e-4
    assert apart(led[2].middle, plain.middle).max() < 1e-4  # beside them, without a lead


def test_a_motion_that_is_led_has_the_bounds_of_others():
    for move in (SIMULATOR.run, lambda cases, times: SIMULATOR.led(cases, [*map(Way, times)])):
        with pytest.raises(InputError, match=r"^a motion of 1e\+06 s; expected at most "):
            move([CASE], [np.array([0.0, 1e6])])


def test_a_motion_led_along_another_comes_near_it(motions):
    plain, other = motions
    [led] = SIMULATOR.led([CASE], [Way(TIMES, Lead(TIMES, other.middle.astype(float)))])
    before, after = apart(plain.middle, other.middle), apart(led.middle, other.middle)
    assert before[10:].mean() > 3e-3 and after[10:].mean() < 0.3 * before[10:].mean()

"""Motions whose pressures jump at other instants, side by side: bits, packed, and which frames a step holds."""

import os
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fabdesign.effects import ActingPressure
from fabdesign.nouns.forward import Case
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator
from sim.chunks import pack
from sim.grid import Support
from sim.kernels.fields import LANES
from sim.schedule import FACTORISED, IDLE, Batch, of_motions
from sim.time_steps import LARGE, Steps, jumps_of, steps_of
from tests.sim_designs import laced

TICK, CALM = 1 / 1920, 8


def program(*rows, duration=1.0):
    """Of rows (time [s], pressures [kPa])."""
    time, pressure = zip(*rows, strict=True)
    return PressureProgram(np.array(time), 1e3 * np.array(pressure, float), duration)


def test_motions_with_other_jumps_give_the_bits_they_give_alone():
    design = laced("cross", 2)
    programs = (
        program((0.0, (150, 0))),
        program((0.0, (0, 0)), (0.03, (0, 200)), (0.07, (100, 0))),
        program((0.0, (0, 0)), (0.0301, (0, 30))),  # small jump, within a step
        program(*((k / 60, (20 * k, 0)) for k in range(6))),
    )
    times = [np.array([0.05, 0.12]), np.array([0.0, 0.031, 0.1]), np.array([0.06]), np.array([0.0999, 0.15])]
    simulator = Simulator(points_per_side=21)
    together = simulator.run([Case(design, p) for p in programs], times)
    for one, p, t in zip(together, programs, times, strict=True):
        [alone] = simulator.run([Case(design, p)], [t])
        assert np.array_equal(one.middle, alone.middle)
        assert np.array_equal(one.tension, alone.tension)
        assert one.middle.shape == (len(t), 21, 21, 3) and np.isfinite(one.middle).all()
    assert np.abs(together[0].middle[0] - together[1].middle[1]).max() > 1e-3  # they are not the same motion


@given(st.lists(st.integers(0, 6), min_size=1, max_size=70))
def test_packing(kinds):
    blocks = pack([(k,) for k in kinds])
    assert all(len(block) == LANES for block in blocks)
    seated = [i for block in blocks for i in dict.fromkeys(block)]
    assert sorted(seated) == list(range(len(kinds)))  # each in one block
    full_blocks = sum(kinds.count(kind) // LANES for kind in set(kinds))
    unlike = [block for block in blocks if len({kinds[i] for i in block}) > 1]
    assert len(blocks) - full_blocks >= len(unlike)  # whole groups stay together
    threads = os.cpu_count() or 1
    assert len(blocks) - full_blocks <= -(-(len(kinds) - full_blocks * LANES) // LANES) + threads - 1


@given(
    st.dictionaries(st.integers(1, 400), st.sampled_from([0.0, 20.0, 100.0, 200.0]), max_size=4),
    st.lists(st.floats(0, 0.2), max_size=6),
)
def test_steps_of_a_motion(later, times):
    # steps tile the time, short after large jumps; each frame lies in its step
    rows = sorted({0: 100.0, **later}.items())
    kpa = np.array([value for _, value in rows])
    p, times = program(*((k * TICK, (value,)) for k, value in rows)), np.sort(times)
    jumps = jumps_of(p, TICK)
    ticks = max(1, int(np.ceil(times[-1] / TICK - 1e-6))) if len(times) else 1
    steps = steps_of(ActingPressure(p, ticks, TICK), times, jumps, calm=CALM)
    edges = np.concatenate([[0], np.cumsum(steps.ticks)])
    assert edges[-1] * TICK >= (times[-1] if len(times) else 0) - 1e-9
    large = [k for (k, _), change in zip(rows, np.diff(kpa, prepend=0.0), strict=True) if 1e3 * abs(change) > LARGE]
    assert list(jumps.large) == large
    for k, (begin, end) in enumerate(pairwise(edges)):
        assert steps.jumps[k] == any(begin <= jump < end for jump in jumps.every)
        assert steps.ticks[k] == 1 or not any(jump <= begin < jump + CALM for jump in large)
        held = [kpa[sum(at <= tick for at, _ in rows) - 1] for tick in range(begin, end)]
        assert np.isclose(steps.pressure[k, 0], 1e3 * np.mean(held))
    assert np.allclose((edges[steps.due] + steps.theta * steps.ticks[steps.due]) * TICK, times, atol=1e-8)


def test_schedule_of_lanes_with_other_ends():
    def motion(ticks, jumps, due):
        rising = np.arange(float(len(ticks)))[:, None]
        return Steps(np.array(ticks), np.array(jumps), rising, np.array(due), np.zeros(len(due)), (0.0, (), ()))

    motions = [
        motion([1, 1, 8, 8, 8], [True, False, False, False, False], [0, 0, 4]),
        motion([8, 8], [False, False], [1]),
    ]
    packed = [0] * (LANES - 1) + [1] + [1] * LANES
    schedule, begins = of_motions(Batch(2, 9, 9, 0, Support.TOP, 1), packed, motions, tick=TICK, rho=0.6)
    assert begins.tolist() == [0, 3, 4]
    h = schedule.scheme[:, :, 0]
    assert np.allclose(h[:, 0, 0] / TICK, [1, 1, 8, 8, 8]) and np.allclose(h[:, 0, -1] / TICK, 8)
    assert schedule.work[:, 0].tolist() == [
        FACTORISED,
        FACTORISED,
        FACTORISED,
        0,
        0,
    ]  # the rule changes, then the length
    assert schedule.work[:, 1].tolist() == [FACTORISED, 0, IDLE, IDLE, IDLE]
    assert schedule.pressure[:, 0, 0, -1].tolist() == [0, 1, 1, 1, 1]
    first = schedule.first
    assert first[:, 0, 0].tolist() == [0, 2, 2, 2, 2, 3] and first[:, 0, LANES - 1].tolist() == [3, 3, 4, 4, 4, 4]
    assert not first[:, 1].any()  # spare lanes keep no frames

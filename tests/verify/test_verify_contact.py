"""A soft cloth rolled up: its layers stay apart, and what that costs."""

import time
from dataclasses import replace

import numpy as np

from sim import Simulator
from tests.layers import depth
from tests.sim_designs import rolled
from tests.thrown import tried_once


def test_rolled_up_cloth(record):
    # on: no point deeper than half a thickness in another layer; off: layers pass through each other
    # frames are closer around the landing, at 0.5 s
    case, times = rolled(), np.unique(np.r_[np.arange(1, 31) / 30, np.arange(114, 139) / 240])
    simulator = Simulator(calm_steps=1)
    simulator.run([case], [times[:1]])  # loads the kernels
    deepest, seconds = [], []
    for on in (True, False):
        begin = time.process_time()
        motion = tried_once(replace(simulator, self_contact=on), [case], [times])[0]
        seconds.append(time.process_time() - begin)
        assert motion.diverged is None  # at once: the times are of one try
        deepest.append(max(depth(x, case.design) for x in motion.middle.astype(float)))
    off = "through" if deepest[1] == np.inf else f"{deepest[1]:.2f}"
    record("rolled up soft cloth, depth with contact on; off", "0.5 thicknesses", f"{deepest[0]:.2f}; {off}")
    record("the same, processor time on; off", "printed", f"{seconds[0]:.1f} s; {seconds[1]:.1f} s")
    assert deepest[0] < 0.5 < deepest[1]

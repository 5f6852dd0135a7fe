"""Motions that start with a velocity, which the public way in has none of."""

import numpy as np

from fabdesign.effects import ActingPressure
from sim.kernels import fields
from sim.kernels.fields import LANES, F
from sim.simulator import Simulator
from sim.time.steps import Jumps, steps_of
from tests.sim_designs import held


def thrown(simulator: Simulator, design, velocity, times, *, positions=None):
    """(T, n, n, 3) m, mid-surface of the design without pressure, from its equilibrium or from `positions` (n, n, 3) m,
    at `velocity` (n, n, 3) m/s."""
    case, n = held(design, (0,)), simulator.points_per_side
    with fields.lock:
        packed = [0] * LANES
        batch = simulator._at_rest([case], packed)
        state = F.node3.to_numpy()
        for first, values in ((F.v0, velocity), (F.x0, positions)):
            if values is not None:
                plane = np.zeros((n + 2, n + 2, 3))
                plane[1:-1, 1:-1] = values
                state[0, first : first + (n + 2) ** 2] = np.repeat(plane.reshape(-1, 3), LANES, axis=1)
        F.node3.from_numpy(state)
        ticks = int(np.ceil(times[-1] / simulator.time_step - 1e-6))
        acting = ActingPressure(case.program, ticks, simulator.time_step)
        steps = steps_of(acting, times, Jumps((), ()), calm=simulator._calm)
        [motion] = simulator._simulate(batch, packed, [case], [times], [steps])
    return motion.middle.astype(float)

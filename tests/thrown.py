"""Motions that start otherwise than the public way in lets them: with a velocity, or off in the last digit."""

import numpy as np
import pytest

from fabdesign.effects import ActingPressure
from sim.chunks import Chunk
from sim.equilibrium import Approach
from sim.kernels import fields
from sim.kernels.fields import LANES, F
from sim.schedule import of_motions
from sim.simulator import Simulator
from sim.step import advance
from sim.time_steps import Jumps, steps_of
from tests.sim_designs import held


def tried_once(simulator: Simulator, cases, times, approach=Approach.USUAL):
    """Its motions, as the first try has them, or with patience the second."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Simulator, "tries", lambda self, _, count: [(self, approach, [*range(count)])])
        return simulator.run(cases, times)


def thrown(simulator: Simulator, design, velocity, times, *, positions=None):
    """(T, n, n, 3) m, mid-surface of the design without pressure, from its equilibrium or from `positions` (n, n, 3) m,
    at `velocity` (n, n, 3) m/s."""
    case, n = held(design, (0,)), simulator.points_per_side
    with fields.lock:
        packed = [0] * LANES
        batch = _at_rest(simulator, [case], packed, Approach.PATIENT)
        state = F.node3.to_numpy()
        for first, values in ((F.v0, velocity), (F.x0, positions)):
            if values is not None:
                plane = np.zeros((n + 2, n + 2, 3))
                plane[1:-1, 1:-1] = values
                state[0, first : first + (n + 2) ** 2] = np.repeat(plane.reshape(-1, 3), LANES, axis=1)
        F.node3.from_numpy(state)
        ticks = int(np.ceil(times[-1] / simulator.time_step - 1e-6))
        acting = ActingPressure(case.program, ticks, simulator.time_step)
        steps = steps_of(acting, times, Jumps((), ()), calm=simulator.calm)
        [middle] = _moved(simulator, batch, packed, [steps])
    return middle


def off_in_the_last_digit(simulator: Simulator, cases, times, first):
    """(T, n, n, 3) m each, mid-surfaces of at most 8 hung cases; from the case `first` on, each node's x and y start
    from the float32 next to their own, above or below by chance."""
    case_of = [*range(len(cases)), *[len(cases) - 1] * (LANES - len(cases))]
    with fields.lock:
        batch = _at_rest(simulator, cases, case_of, Approach.USUAL)
        state, nodes = F.node3.to_numpy(), slice(F.x0, F.x0 + (simulator.points_per_side + 2) ** 2)
        for lane in range(first, len(cases)):
            rng = np.random.default_rng(lane)
            for axis in range(2):
                coordinates = state[0, nodes, axis * LANES + lane]
                towards = np.where(rng.random(coordinates.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
                state[0, nodes, axis * LANES + lane] = np.nextafter(coordinates, towards)
        F.node3.from_numpy(state)
        return _moved(simulator, batch, case_of, [simulator.steps(case, times) for case in cases])


def _at_rest(simulator, cases, packed, approach):
    """The batch of the cases in the fields, at equilibrium without pressure."""
    batch, _ = simulator.started(Chunk([*range(len(cases))], cases, packed), approach)
    return batch


def _moved(simulator, batch, packed, steps):
    """(T, n, n, 3) m each, mid-surfaces of the motions from where the batch is."""
    schedule, begins = of_motions(batch, packed, steps, tick=simulator.time_step, rho=simulator.rho)
    shapes, _ = advance(batch, schedule, simulator.solve(batch), frames=int(begins[-1]))
    return [frames.reshape(-1, batch.nv, batch.nu, 3).astype(float) for frames in np.split(shapes, begins[1:-1])]

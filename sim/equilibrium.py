"""To rest: where a motion starts, and the shape under constant pressures."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import RISE, Case
from sim.kernels.transfer import halt
from sim.step import Solve, advance
from sim.time.batch import Batch
from sim.time.schedule import alike
from sim.time.scheme import Integrator, Memory, Scheme

RESTED = 3e-5  # m, RMS over nodes of what the last of the steps to rest may still move
# (step [s], duration [s], times the tolerance) with backward Euler and so much air damping that a swing of SWING rad/s
# dies out: the pressures' rise, then rest
STAGES = ((1 / 48, RISE, 5), (1 / 30, 1.0, 2))
# where only inertia holds the rigid motions, it must show in float32
STAGES_FREE = ((1 / 240, RISE, 1), (1 / 240, 2.0, 1))
SWING = 8.0  # rad/s
# (step [s], steps) to the shape without pressure, from the flat cloth: velocities are forgotten after each long step
IN_PLANE = ((0.05, 4), (0.5, 8))


def equilibrate_in_plane(batch: Batch, pressure: NDArray[np.float32], solve: Solve) -> None:
    """From the flat cloth to equilibrium in its plane."""
    for h, steps in IN_PLANE:
        if not batch.support.is_edge:  # nothing but inertia holds the rigid motions: float32 wants a share of it
            h = min(h, 1 / 30)
        scheme = Scheme(h, Integrator.BACKWARD_EULER, memory=Memory.AT_REST)
        for k in range(steps):
            advance(batch, alike(batch, scheme, pressure[None], anew=k == 0), solve)
            halt(*batch.grid)


def equilibrate(batch: Batch, pressure: NDArray[np.float32], solve: Solve, *, patient: bool, memory: Memory) -> None:
    """A damped motion to rest under `pressure`, which rises linearly within RISE seconds."""
    begin = 0.0
    stages: tuple[tuple[float, float, int], ...] = STAGES if batch.support.is_edge else STAGES_FREE
    if patient:
        stages = (*((h / 2, duration, 1) for h, duration, _ in stages), (stages[-1][0] / 2, 2.0, 1))
    for h, duration, loose in stages:
        steps, iterations = round(duration / h), solve.iterations if loose == 1 else 3 * solve.iterations // 4
        share = np.minimum(1.0, (begin + h * np.arange(1, steps + 1)) / RISE).astype(np.float32)
        begin += duration
        scheme = Scheme(h, Integrator.BACKWARD_EULER, memory=memory)
        schedule = alike(batch, scheme, share[:, None, None, None] * pressure)
        advance(batch, schedule, replace(solve, iterations=iterations, tolerance=loose * solve.tolerance))


def damped(case: Case) -> Case:
    """The same equilibrium with critical air damping of a swing."""
    fabric = case.design.fabric
    drag = max(fabric.air_damping, 2 * SWING * fabric.areal_density)
    return replace(case, design=replace(case.design, fabric=replace(fabric, air_damping=drag)))

"""To rest: where a motion starts, and the shape under constant pressures."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import RISE, Case
from sim.kernels.fields import LANES
from sim.kernels.transfer import halt, put
from sim.step import Solve, advance
from sim.time.batch import Batch
from sim.time.schedule import alike
from sim.time.scheme import Integrator, Scheme

RESTED = 3e-5  # m, RMS over nodes of what the last of the steps to rest may still move
# (step [s], duration [s], times the tolerance) with backward Euler and so much air damping that a swing of SWING rad/s
# dies out: after the pressures' rise, which takes (step, times the tolerance)
RISING, STAGES = (1 / 48, 5), ((1 / 30, 1.0, 2),)
# where only inertia holds the rigid motions, it must show in float32
RISING_FREE, STAGES_FREE = (1 / 240, 1), ((1 / 240, 2.0, 1),)
SWING = 8.0  # rad/s
LEAST_HOLD = 1e-6  # s
# (step [s], steps) to the shape without pressure, from the flat cloth: velocities are forgotten after each long step
FROM_FLAT = ((0.05, 4), (0.5, 8))  # within 0.01 mm of where a damped motion leads
FOLLOWING_STEP, FOLLOWING = 0.5, 4  # s, steps to the shape at rest from one nearby: within 0.02 mm of it


def long_steps(
    batch: Batch, pressure: NDArray[np.float32], solve: Solve, stages: tuple[tuple[float, int], ...]
) -> None:
    """From the flat cloth to equilibrium, where no buckling is on the way."""
    for h, steps in stages:
        if not batch.support.is_edge:  # nothing but inertia holds the rigid motions: float32 wants a share of it
            h = min(h, 1 / 30)
        scheme = Scheme(h, Integrator.BACKWARD_EULER, ages=0.0)
        for k in range(steps):
            advance(batch, alike(batch, scheme, pressure[None], anew=k == 0), solve)
            halt(*batch.grid)


def equilibrate(
    batch: Batch,
    pressure: NDArray[np.float32],
    solve: Solve,
    *,
    rise: float = RISE,
    hold: float | None = None,
    patient: bool = False,
) -> None:
    """A damped motion to rest under `pressure`, which rises linearly within `rise` s. Memory of forces ages by the rise
    and `hold` s more (LEAST_HOLD at least: none at all would say that it is at rest); None: it stays at rest. patient:
    with shorter steps, and 2 s more."""
    (h, loose), rest = (RISING, STAGES) if batch.support.is_edge else (RISING_FREE, STAGES_FREE)
    stages = [(min(h, rise / 24), rise, loose), *rest]
    if patient:
        stages = [*((h / 2, duration, 1) for h, duration, _ in stages), (stages[-1][0] / 2, 2.0, 1)]
    counts = [round(duration / h) for h, duration, _ in stages]
    for k, ((h, _, loose), steps) in enumerate(zip(stages, counts, strict=True)):
        share = (np.arange(1, steps + 1) / steps if k == 0 else np.ones(steps)).astype(np.float32)
        ages = 0.0 if hold is None else rise / steps if k == 0 else max(hold, LEAST_HOLD) / sum(counts[1:])
        scheme = Scheme(h, Integrator.BACKWARD_EULER, ages=ages)
        schedule = alike(batch, scheme, share[:, None, None, None] * pressure)
        iterations = solve.iterations if loose == 1 else 3 * solve.iterations // 4
        advance(batch, schedule, replace(solve, iterations=iterations, tolerance=loose * solve.tolerance))


def carried_on(batch: Batch, middle: NDArray[np.float32]) -> None:
    """Put all lanes of the batch at `middle` (n, n, 3) m, at rest there."""
    padded = np.pad(middle, ((1, 1), (1, 1), (0, 0))).reshape(-1, 3)
    every = np.repeat(np.repeat(padded[None, :, :, None], LANES, axis=3), batch.blocks, axis=0).astype(np.float32)
    put(batch.blocks, {"x0": every, "q": every})


def damped(case: Case) -> Case:
    """The same equilibrium with critical air damping of a swing."""
    fabric = case.design.fabric
    drag = max(fabric.air_damping, 2 * SWING * fabric.areal_density)
    return replace(case, design=replace(case.design, fabric=replace(fabric, air_damping=drag)))

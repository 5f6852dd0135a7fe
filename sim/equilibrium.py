"""Steps to rest: those that lead to where a motion starts, and to the shape under constant pressures."""

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import acting_pressure, active, specimen_of
from fabdesign.effects.declaration import Specimen
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import SWING, Fabric
from fabdesign.nouns.forward import RISE, Case
from fabdesign.nouns.pressure import RISE_STEPS, rising_program
from sim.grid import Support
from sim.kernels.fields import LANES, F
from sim.kernels.transfer import Values
from sim.loading import ringed
from sim.materials import REST_CURVATURES
from sim.schedule import Batch, Schedule, alike
from sim.step import Solve
from sim.time_steps import Integrator, Scheme

Stages = Iterator[tuple[Schedule, Solve]]  # what `advance` takes one after another
RESTED = 3e-5  # m, RMS over nodes of what the last of the steps to rest may still move
# (step [s], duration [s], times the tolerance) with backward Euler and so much air damping that a swing of SWING rad/s
# dies out: after the pressures' rise, which takes (step, times the tolerance)
RISING, STAGES = (1 / 48, 5), ((1 / 30, 1.0, 2),)
# where only inertia holds the rigid motions, it must show in float32
RISING_FREE, STAGES_FREE = (1 / 240, 1), ((1 / 240, 2.0, 1),)
LEAST_HOLD = 1e-6  # s
_MOST_TICKS = 2000  # in which pressures are followed to rest through what lies between regulator and muscle
# (step [s], steps) to the shape without pressure, from the flat cloth: velocities are forgotten after each long step
FROM_FLAT = ((0.05, 4), (0.5, 8))  # within 0.01 mm of where a damped motion leads
FOLLOWING_STEP, FOLLOWING = 0.5, 4  # s, steps to the shape at rest from one nearby: within 0.02 mm of it


class Start(Enum):
    """How a batch comes to rest without pressure, where its motions start."""

    FLAT = auto()  # a free cloth lies flat
    LONG_STEPS = auto()  # from the flat cloth, in its plane
    CHECKED = auto()  # the same; gravity or curvature lead out of the plane, so that it may not have come to rest
    DAMPED = auto()  # a damped motion


class Approach(Enum):
    """How a cloth is brought to rest by a damped motion."""

    USUAL = auto()
    PATIENT = auto()  # by shorter steps, and for 2 s more


def start_of(case: Case, approach: Approach) -> Start:
    """Return the state at the start and the steps to it: with patience by a damped motion, where the cloth leaves its
    plane."""
    support = Support.of(case.design.fabric)
    if support == Support.NONE:
        return Start.FLAT
    if not swings_to_rest(specimen_of(case)):
        return Start.LONG_STEPS
    return Start.DAMPED if approach is Approach.PATIENT or not support.is_edge else Start.CHECKED


def to_start(batch: Batch, start: Start, solve: Solve, channels: int) -> Stages:
    """Return the steps to rest without pressure in so many channels, velocities then zero."""
    nothing = np.zeros((batch.blocks, channels, LANES), np.float32)
    if start is Start.DAMPED:
        *stages, (last, how) = damped_motion(batch, nothing, solve, approach=Approach.PATIENT)
        yield from (*stages, (replace(last, halts=True), how))
    elif start is not Start.FLAT:
        yield from long_steps(batch, nothing, solve, FROM_FLAT)


def long_steps(
    batch: Batch, pressure: NDArray[np.float32], solve: Solve, stages: tuple[tuple[float, int], ...]
) -> Stages:
    """Return the steps from the flat cloth to equilibrium, where no buckling is on the way."""
    for h, steps in stages:
        if not batch.support.is_edge:  # nothing but inertia holds the rigid motions: float32 wants a share of it
            h = min(h, 1 / 30)
        scheme = Scheme(h, Integrator.BACKWARD_EULER, ages=0.0)
        for k in range(steps):
            yield alike(batch, scheme, pressure[None], anew=k == 0, halts=True), solve


def damped_motion(
    batch: Batch,
    pressure: NDArray[np.float32],
    solve: Solve,
    *,
    rise: float = RISE,
    hold: float | None = None,
    approach: Approach = Approach.USUAL,
) -> Stages:
    """Return a damped motion to rest under `pressure`, which rises linearly within `rise` s. Memory of forces ages by
    the rise and `hold` s more (LEAST_HOLD at least: none at all would say that it is at rest); None: it stays at
    rest."""
    (h, loose), rest = (RISING, STAGES) if batch.support.is_edge else (RISING_FREE, STAGES_FREE)
    stages = [(min(h, rise / 24), rise, loose), *rest]
    if approach is Approach.PATIENT:
        stages = [*((h / 2, duration, 1) for h, duration, _ in stages), (stages[-1][0] / 2, 2.0, 1)]
    counts = [round(duration / h) for h, duration, _ in stages]
    for k, ((h, _, loose), steps) in enumerate(zip(stages, counts, strict=True)):
        share = (np.arange(1, steps + 1) / steps if k == 0 else np.ones(steps)).astype(np.float32)
        ages = 0.0 if hold is None else rise / steps if k == 0 else max(hold, LEAST_HOLD) / sum(counts[1:])
        scheme = Scheme(h, Integrator.BACKWARD_EULER, ages=ages)
        schedule = alike(batch, scheme, share[:, None, None, None] * pressure)
        iterations = solve.iterations if loose == 1 else 3 * solve.iterations // 4
        yield schedule, replace(solve, iterations=iterations, tolerance=loose * solve.tolerance)


def rested(batch: Batch) -> NDArray[np.bool_]:
    """Return (lanes,) whether the last step moved them by less than RESTED."""
    moved = batch.positions(F.x0) - batch.positions(F.xp)
    return np.asarray(np.sqrt(np.square(moved).sum(axis=-1).mean(axis=(1, 2))) < RESTED)  # NaN compares false


def lying_at(batch: Batch, middle: NDArray[np.float32]) -> Values:
    """Return the state of all lanes at `middle` (n, n, 3) m, at rest there."""
    every = ringed(np.broadcast_to(middle, (batch.blocks * LANES, *middle.shape)))
    return {"x0": every, "q": every}


def pressure_at_rest(case: Case, rise: float, hold: float) -> Array:
    """Return (channels,) Pa that act at rest, once the program's last pressures have risen and were held, s."""
    last = case.program.pressure[-1]
    if not any(effect.pressure for effect, _, _ in active(case)):
        return last
    duration = rise + hold
    tick = max(rise / RISE_STEPS, duration / _MOST_TICKS)
    rising = replace(case, program=rising_program(last, rise, duration))
    return np.asarray(acting_pressure(rising, int(np.ceil(duration / tick)), tick).means[-1])


def damped(case: Case) -> Case:
    """Return the same equilibrium with critical air damping of a swing."""
    fabric = case.design.fabric
    drag = max(fabric.air_damping, 2 * SWING * fabric.areal_density)
    return replace(case, design=replace(case.design, fabric=replace(fabric, air_damping=drag)))


def is_free(fabric: Fabric) -> bool:
    """Return whether nothing holds the cloth: what it would come to rest at is not there."""
    return Support.of(fabric) == Support.NONE


def swings_to_rest(specimen: Specimen) -> bool:
    """Return whether the cloth without pressure leaves the plane of the flat cloth, or turns in it."""
    fabric = specimen.design.fabric
    curved = any(specimen.constants.get(name) for name in REST_CURVATURES)
    return curved or fabric.gravity[2] != 0 or (Support.of(fabric) == Support.POINTS and any(fabric.gravity))

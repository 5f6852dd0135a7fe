"""The motion of a scene: BDF2 for position and velocity.

Hairer, Wanner 1996, "Solving Ordinary Differential Equations II", V.1 (BDF). History before the first step is the rest
shape. A force that is there from one step on acts half a step late: a constant one, from rest, gives
x_n = (n^2 - n) a h^2 / 2. So a step takes the mean pressure from half a step before its instant to half a step after,
and the first step ends at t = 0. Force memory (friction, creep, relaxation) is updated once a step.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.rig.muscle import pressure_at_intervals, settle
from studies.rig.scene import Scene, StepReport
from studies.rig.solver import MAX_ITERATIONS, RigDiverged, RigSolver

Array = NDArray[np.float64]
EQUILIBRIUM_TOLERANCE = 1e-9  # m, largest Newton correction


@dataclass(frozen=True, eq=False)
class RigMotion:
    """Control points at every step, from `start` [s] on: position (steps + 1, n, 3) m, velocity m/s, step in s."""

    position: Array
    velocity: Array
    step: float
    start: float

    def at(self, time: float) -> Array:
        """Return (n, 3) control points [m] at `time` [s]: cubic Hermite between steps."""
        h, since = self.step, (time - self.start) / self.step
        k = min(int(since + 1e-9), len(self.position) - 2)
        s = since - k
        x0, x1, v0, v1 = self.position[k], self.position[k + 1], self.velocity[k], self.velocity[k + 1]
        return np.asarray(
            (1 + 2 * s) * (1 - s) ** 2 * x0 + s * s * (3 - 2 * s) * x1 + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
        )


def equilibrium(scene: Scene, x: Array, pressure: Array) -> Array:
    """Return control points at rest under gravity and `pressure` (channels,) Pa, from x: damped steps of growing
    length.

    Raises RigDiverged.
    """
    solver = RigSolver(scene)
    p = pressure_at_intervals(scene, pressure)
    no_rate, no_cable_rate = np.zeros((len(scene.uv), 3)), np.zeros(len(scene.cables.rest))
    weight = scene.mass @ np.broadcast_to(scene.gravity, x.shape)
    at_rest = np.zeros_like(x)
    pseudo = 1e3  # 1/s^2, a mass term that keeps a step short
    for _ in range(60):
        start, size = x, np.inf
        for _ in range(MAX_ITERATIONS):
            r = solver.internal(x, p, 0.0, no_rate, no_cable_rate) - weight + pseudo * (scene.mass @ (x - start))
            for load in scene.loads:
                r -= load(0.0, x, at_rest)
            solver.refactor(x, 0.0, no_rate, max(pseudo, 1e-6), 0.0)
            dx = solver.correction(r)
            size = float(np.abs(dx).max())
            x = x + dx * min(1.0, 0.01 / max(size, 1e-12))
            if size < EQUILIBRIUM_TOLERANCE or (pseudo > 0 and size < 1e-6):
                break
        if pseudo == 0.0 and size < EQUILIBRIUM_TOLERANCE:
            return x
        pseudo = 0.0 if float(np.abs(x - start).max()) < 1e-5 or pseudo < 0.1 else pseudo / 4
    raise RigDiverged("no equilibrium was found")


def run(scene: Scene, pressures: Array, step: float, *, start: float = 0.0) -> RigMotion:
    """Return the motion from equilibrium at zero pressure, of a free cloth from where it lies flat.

    pressures (steps + 1, channels) Pa: row n for start + n * step s. Raises RigDiverged.
    """
    s, solver = scene, RigSolver(scene)
    for hook in s.pressure_hooks:
        pressures = hook(pressures, step)
    idle = np.zeros(pressures.shape[1])
    flat, free = s.patch.flat(), s.design.fabric.hung == "none"
    x = flat if free else equilibrium(s, flat, idle)
    fall = np.broadcast_to(s.gravity if free else np.zeros(3), x.shape)  # as if it fell before, and came to rest here
    before_start = (x + fall * step**2 / 2, -fall * step)
    positions, velocities = np.tile(x, (len(pressures), 1, 1)), np.zeros((len(pressures), *x.shape))
    solver.internal(x, pressure_at_intervals(s, idle), 0.0, np.zeros((len(s.uv), 3)), np.zeros(len(s.cables.rest)))
    settle(s, pressure_at_intervals(s, idle), solver.contraction)
    if s.prony:  # the hanging cloth has relaxed long ago
        solver.memory[:] = solver.strain - s.rest_strain
    strains = [solver.strain[:, :3].copy()] * 2
    contractions = [solver.contraction] * 2
    for k in range(1, len(pressures)):
        p, time = pressure_at_intervals(s, pressures[k]), start + k * step
        last = (positions[k - 1], velocities[k - 1])
        before = (positions[k - 2], velocities[k - 2]) if k > 1 else before_start
        try:
            positions[k], velocities[k] = _step(solver, time, step, p, last, before, strains, contractions)
        except RigDiverged as failure:
            raise RigDiverged(f"{failure} at {time:.4f} s") from None
        strains = [solver.strain[:, :3].copy(), strains[0]]
        contractions = [solver.contraction, contractions[0]]
        settle(s, p, solver.contraction)
        if s.prony:
            solver.memory += (solver.strain - s.rest_strain - solver.memory) * -np.expm1(-step / s.prony_time)
        report = StepReport(time, step, p, solver.contraction, solver.tension, solver.strain)
        for after in s.after_step:
            after(s, report)
    return RigMotion(positions, velocities, step, start)


def _step(
    solver: RigSolver,
    time: float,
    h: float,
    p: Array,
    last: tuple[Array, Array],
    before: tuple[Array, Array],
    strains: list[Array],
    contractions: list[Array],
) -> tuple[Array, Array]:
    """Return the position and velocity at `time`, one step h after `last`; p (intervals,) Pa."""
    s = solver.scene
    (x1, v1), (x2, v2) = last, before
    gain = 1.5 / h
    rate_history = (strains[1] - 4.0 * strains[0]) / (2 * h)
    cable_history = (contractions[1] - 4.0 * contractions[0]) / (2 * h)
    weight = s.mass @ np.broadcast_to(s.gravity, x1.shape)

    def velocity(x: Array) -> Array:
        return np.asarray((3.0 * x - 4.0 * x1 + x2) / (2 * h))

    def residual(x: Array) -> Array:
        v = velocity(x)
        acceleration = (3.0 * v - 4.0 * v1 + v2) / (2 * h)
        r = solver.internal(x, p, gain, rate_history, cable_history) - weight + s.mass @ acceleration + s.drag @ v
        for load in s.loads:
            r -= load(time, x, v)
        return r

    def refactor(x: Array) -> None:
        solver.refactor(x, gain, rate_history, gain * gain, gain)

    x = solver.newton(x1 + h * v1 + 0.5 * h * (v1 - v2), residual, refactor)
    return x, velocity(x)

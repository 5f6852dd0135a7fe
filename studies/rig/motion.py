"""The motion of a scene: residual, stiffness and Newton iterations of a step; BDF2 for position and velocity.

Hairer, Wanner 1996, "Solving Ordinary Differential Equations II", V.1 (BDF). History before the first step is the rest
shape. A force that is there from one step on acts half a step late: a constant one, from rest, gives
x_n = (n^2 - n) a h^2 / 2. So a step takes the mean pressure from half a step before its instant to half a step after,
and the first step ends at t = 0. Force memory (friction, creep, relaxation) is updated once a step.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.sparse as sp
from scipy.linalg.lapack import dpbtrf, dpbtrs

from fabdesign.errors import SimulationError
from fabdesign.nouns.array import Array
from studies.rig import shell
from studies.rig.cables import forces, pressure_at_intervals, settle, spans, stiffness, tension
from studies.rig.scene import Scene, StepReport
from studies.rig.shell import GAUSS

TOLERANCE = 1e-7  # m, largest Newton correction of a control point that ends a step
HELD = 1e15  # N/m, on the diagonal of a held value
MAX_ITERATIONS = 60
TOGETHER = 60  # elements whose stiffness is there at once
KEEP = 0.35  # a factor that shrinks corrections at least so is kept


class RigDiverged(SimulationError):
    """Newton found no solution of a step; says when."""


class RigSolver:
    """One scene's moving state, its residual and its factored stiffness."""

    def __init__(self, scene: Scene) -> None:
        self.scene = s = scene
        self._nodes, self._basis = s.patch.local(s.uv, shell.DERIVATIVES)
        widest = int(np.ptp(self._nodes, axis=1).max())  # of masses and ties too, which act at points
        if s.cables.touched.size:
            widest = max(widest, int(np.ptp(s.cables.touched, axis=1).max()))
        self.band_width = 3 * widest + 2  # half of it
        self.memory = np.zeros((len(s.uv), 6))
        self.factor: Array | None = None
        self._surface = sp.vstack([s.patch.matrix(s.uv, *each) for each in shell.DERIVATIVES]).tocsr()
        self._mass_band = _to_band(s.mass, self.band_width)
        self._drag_band = _to_band(s.drag, self.band_width)

    @np.errstate(all="ignore")  # of a motion that diverges
    def internal(self, x: Array, pressure: Array, rate_gain: float, rate_history: Array, cable_history: Array) -> Array:
        """Return the internal force (n, 3) N at x. Rates are rate_gain * value + history."""
        s, c = self.scene, self.scene.cables
        self._strained = shell.strained((self._surface @ x).reshape(5, -1, 3).swapaxes(0, 1))
        self.strain = self._strained.strain
        rate = rate_gain * self.strain[:, :3] + rate_history
        elastic = self.strain - s.rest_strain - s.prony * self.memory
        self._stress = np.einsum("qrs,qs->qr", shell.moduli(s.stiffness), elastic)
        self._stress[:, :3] += s.viscosity[:, None] * shell.VISCOUS * rate
        force = s.weight[:, None, None] * shell.forces(self._strained, self._stress)
        out = np.asarray(self._surface.T @ force.swapaxes(0, 1).reshape(-1, 3))
        self._spans = spans(c, x)
        self.contraction = 1.0 - self._spans.length / c.rest
        rate = rate_gain * self.contraction + cable_history
        self.tension, slope = tension(s, pressure, self.contraction, rate, rate_gain)
        self._axial = -slope / c.rest  # N/m, tension gained per length
        forces(c, self._spans, self.tension, out)
        if len(s.tied_to):
            out += s.ties.T @ (s.tie_stiffness[:, None] * (s.ties @ x - s.tied_to))
        return out

    @np.errstate(all="ignore")
    def refactor(self, rate_gain: float, mass_gain: float, drag_gain: float, exact: bool = True) -> None:
        """Factor mass_gain M + drag_gain D + K at the state of the last residual.

        Where the exact stiffness is indefinite (about to buckle), its definite part serves.
        """
        s = self.scene
        band = mass_gain * self._mass_band + drag_gain * self._drag_band
        tangent = shell.moduli(s.stiffness)
        tangent[:, range(3), range(3)] += rate_gain * s.viscosity[:, None] * shell.VISCOUS
        points = np.arange(len(s.uv)).reshape(-1, GAUSS**2)  # of each element
        for some in np.array_split(points, 1 + len(points) // TOGETHER):
            at = shell.Strained(*(array[some.ravel()] for array in self._strained))
            h = shell.hessian(at, tangent[some.ravel()], self._stress[some.ravel()], exact)
            weighted = (h.T * s.weight[some.ravel()]).T.reshape(*some.shape, *h.shape[1:])
            shell.add_to_band(self._nodes[some[:, 0]], shell.element_stiffness(self._basis[some], weighted), band)
        stiffness(s.cables, self._spans, self.tension, np.maximum(self._axial, 0.0), exact, band)
        if len(s.tied_to):
            band += _to_band(s.ties.T @ sp.diags(s.tie_stiffness) @ s.ties, self.band_width)
        band[0, np.flatnonzero(s.held.ravel())] += HELD
        self.factor, info = dpbtrf(band, lower=1, overwrite_ab=1)
        if info and exact:
            self.refactor(rate_gain, mass_gain, drag_gain, exact=False)
        elif info:
            raise RigDiverged("the stiffness matrix is singular: is the cloth held, and does it have mass?")

    def newton(self, x: Array, residual: Callable[[Array], Array], refactor: Callable[[], None]) -> Array:
        """Return the root of `residual` near x. The factor is kept while corrections shrink by 1 / KEEP, and damped
        where they would grow (natural monotonicity: Deuflhard 2011, "Newton Methods for Nonlinear Problems", 3.3)."""
        r = residual(x)
        fresh = self.factor is None
        if fresh:
            refactor()
        dx, damping = self.correction(r), 1.0
        for _ in range(MAX_ITERATIONS):
            size = float(np.abs(dx).max())
            if size < TOLERANCE:
                return x + dx
            trial = x + damping * dx
            r = residual(trial)
            next_dx = self.correction(r)
            ratio = float(np.linalg.norm(next_dx) / np.linalg.norm(dx))
            if ratio < KEEP and damping == 1.0:
                x, dx, fresh = trial, next_dx, False
                continue
            if fresh and not ratio < 1.0 - damping / 4:
                damping /= 2
                if damping < 1e-3:
                    break
                continue
            if ratio < 1.0:
                x = trial
            else:
                r = residual(x)
            refactor()
            dx, damping, fresh = self.correction(r), min(1.0, 2 * damping) if fresh else 1.0, True
        raise RigDiverged(f"no solution: the last correction was {size:.1e} m")

    def correction(self, residual: Array) -> Array:
        residual = np.where(self.scene.held, 0.0, residual)
        dx, _ = dpbtrs(self.factor, residual.reshape(-1, 1), lower=1)
        return np.asarray(-dx.reshape(residual.shape))


def _to_band(matrix: sp.spmatrix, half: int) -> Array:
    """Return the lower band (half + 1, 3 n) of a scalar matrix that acts on x, y and z alike."""
    lower = sp.tril(sp.kron(matrix, sp.identity(3)), format="coo")
    band = np.zeros((half + 1, lower.shape[0]), order="F")
    band[lower.row - lower.col, lower.col] = lower.data
    return band


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


@dataclass(frozen=True, eq=False)
class StepState:
    """The state at the end of a step: position m and velocity m/s (n, 3), strain (points, 3), contraction
    (intervals,)."""

    x: Array
    v: Array
    strain: Array
    contraction: Array


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
            solver.refactor(0.0, max(pseudo, 1e-6), 0.0)
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
    positions, velocities = np.tile(x, (len(pressures), 1, 1)), np.zeros((len(pressures), *x.shape))
    solver.internal(x, pressure_at_intervals(s, idle), 0.0, np.zeros((len(s.uv), 3)), np.zeros(len(s.cables.rest)))
    s.muscle_state.contraction_before = solver.contraction
    solver.memory = solver.strain - s.rest_strain  # the hanging cloth has relaxed long ago
    last = StepState(x, np.zeros_like(x), solver.strain[:, :3], solver.contraction)
    before = replace(last, x=x + fall * step**2 / 2, v=-fall * step)
    for k in range(1, len(pressures)):
        p, time = pressure_at_intervals(s, pressures[k]), start + k * step
        try:
            last, before = _step(solver, time, step, p, last, before), last
        except RigDiverged as failure:
            raise RigDiverged(f"{failure} at {time:.4f} s") from None
        positions[k], velocities[k] = last.x, last.v
        settle(s, p, solver.contraction)
        solver.memory += (solver.strain - s.rest_strain - solver.memory) * -np.expm1(-step / s.prony_time)
        report = StepReport(time, step, p, solver.contraction, solver.tension, solver.strain)
        for after in s.after_step:
            after(s, report)
    return RigMotion(positions, velocities, step, start)


def _step(solver: RigSolver, time: float, h: float, p: Array, last: StepState, before: StepState) -> StepState:
    """Return the state at `time`, one step h after `last`; p (intervals,) Pa."""
    s, x1, v1 = solver.scene, last.x, last.v
    gain = 1.5 / h
    rate_history = (before.strain - 4.0 * last.strain) / (2 * h)
    cable_history = (before.contraction - 4.0 * last.contraction) / (2 * h)
    weight = s.mass @ np.broadcast_to(s.gravity, x1.shape)

    def velocity(x: Array) -> Array:
        return np.asarray((3.0 * x - 4.0 * x1 + before.x) / (2 * h))

    def residual(x: Array) -> Array:
        v = velocity(x)
        acceleration = (3.0 * v - 4.0 * v1 + before.v) / (2 * h)
        r = solver.internal(x, p, gain, rate_history, cable_history) - weight + s.mass @ acceleration + s.drag @ v
        for load in s.loads:
            r -= load(time, x, v)
        return r

    start = x1 + h * v1 + 0.5 * h * (v1 - before.v)
    x = solver.newton(start, residual, partial(solver.refactor, gain, gain * gain, gain))
    return StepState(x, velocity(x), solver.strain[:, :3], solver.contraction)

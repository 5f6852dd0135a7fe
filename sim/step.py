"""One time step of a batch, in solver order: predict, then repeat (forces, frames, global solve, step), finish.

Time: generalised-alpha (Chung and Hulbert 1993, their equations 8-13) with spectral radius rho at infinity. The unknown
is the position q at the evaluation time; velocity and acceleration there are linear in it, v = cv q + hv and
a = ca q + ha. The residual r(q) = f(q, v) - M a is the XPBD system of all constraints at once.
Space: a constraint C of compliance alpha gives f = -grad C^T C / alpha (sim/sheet.py, sim/lacing.py).
Solve: conjugate gradients on the nonlinear residual, the step length by the secant (Polak-Ribiere, restarted every
step), preconditioned by sim/preconditioner.py. A lane whose update is below the tolerance no longer moves, so that a
design's result does not depend on its neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim.fields import LANES, SPREAD, F, Timed, X
from sim.lacing import back, points_pos, points_rate, seg_to_points, tension
from sim.preconditioner import factor, frames, green, muscle_correct, spectral, unwarp, warp, woodbury
from sim.sheet import fabric_force

Lanes = ti.types.vector(LANES, ti.f32)
RZ, BETA, ACTIVE, ALPHA = 4, 5, 6, 7  # slots of F.reduce
DIVERGED = 1e4  # m^2, a squared update that no lane comes back from; others do not wait for it, nor for a NaN


@dataclass(frozen=True)
class Scheme:
    """Coefficients of one step of `h` seconds.

    rho in [0, 1]: generalised-alpha. rho = 2: the implicit midpoint rule, which needs no acceleration from before and
    so keeps second order where the pressure jumps. rho < 0: backward Euler.
    """

    h: float
    rho: float

    @property
    def coefficients(self) -> tuple[float, ...]:
        """h, alpha_m, alpha_f, gamma, 1 / (beta h^2), 1 / (1 - alpha_f), 1 / (2 beta) - 1."""
        if self.rho < 0:
            return self.h, 0.0, 0.0, 1.0, 1.0 / self.h**2, 1.0, 0.0
        if self.rho == 2:
            return self.h, 0.0, 0.5, 1.0, 2.0 / self.h**2, 2.0, 0.0
        am, af = (2 * self.rho - 1) / (self.rho + 1), self.rho / (self.rho + 1)
        gamma, beta = 0.5 - am + af, 0.25 * (1 - am + af) ** 2
        return self.h, am, af, gamma, 1 / (beta * self.h**2), 1 / (1 - af), 0.5 / beta - 1

    @property
    def ca(self) -> float:
        """d a / d q [1/s^2]."""
        _, am, _, _, ia, ry, _ = self.coefficients
        return (1 - am) * ia * ry

    @property
    def cv(self) -> float:
        """d v / d q [1/s]."""
        h, _, _, gamma, ia, _, _ = self.coefficients
        return h * gamma * ia


@dataclass(frozen=True)
class Batch:
    """Sizes of the batch that lies in the fields."""

    blocks: int
    nu: int
    nv: int
    points: int  # fixed points, the most of any lane; 0 without muscles
    hung: int  # 0 top, 1 bottom, 2 left, 3 right, 4 none or points
    reach: int  # nodes over which the preconditioner's frames are averaged

    @property
    def grid(self) -> tuple[int, int, int]:
        return self.blocks, self.nu, self.nv


def prepare(batch: Batch, scheme: Scheme) -> None:
    """Factor the preconditioner for this scheme's step."""
    _factor(*batch.grid, scheme.ca, scheme.cv)
    if batch.points:
        _green(*batch.grid, batch.points)


def march(
    batch: Batch, schemes: Sequence[Scheme], pressure: NDArray[np.float32], *, iterations: int, tolerance: float,
    refresh: Sequence[int] | int = 2,
) -> None:  # fmt: skip
    """Advance all lanes by len(schemes) steps under `pressure` (steps, blocks, channels, LANES) Pa.

    refresh: in so many of the first iterations the preconditioner turns with the shape.
    tolerance [m]: a lane has converged when the RMS over nodes of its preconditioned residual falls below it.
    """
    table = np.array([(*s.coefficients, s.ca, s.cv) for s in schemes], np.float32)
    turns = np.broadcast_to(np.asarray(refresh, np.int32), len(schemes)).copy()
    _march(
        *batch.grid, batch.points, batch.hung, batch.reach, iterations, tolerance, table, turns,
        np.ascontiguousarray(pressure),
    )  # fmt: skip


@ti.kernel
def _factor_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, ca: ti.f32, cv: ti.f32):
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            factor(task // SPREAD, nu, nv, ca, cv)


@ti.kernel
def _green_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32):
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            green(task // SPREAD, nu, nv, npt)


@ti.kernel
def _march_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, hung: ti.i32, reach: ti.i32, iterations: ti.i32,
    tolerance: ti.f32, table: ti.types.ndarray(dtype=ti.f32, ndim=2), turns: ti.types.ndarray(dtype=ti.i32, ndim=1),
    pressure: ti.types.ndarray(dtype=ti.f32, ndim=4),
):  # fmt: skip
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            b = task // SPREAD
            for m in range(table.shape[0]):
                ca = table[m, 7]
                cv = table[m, 8]
                for k_ in range(npt):
                    k = F.index[k_]
                    for lane in range(LANES):
                        F.point[b, X.pressure + k][lane] = pressure[m, b, F.channel[b, k][lane], lane]
                predict(
                    b, nu, nv, table[m, 0], table[m, 1], table[m, 2], table[m, 3], table[m, 4], table[m, 5], table[m, 6]
                )
                i = 0
                while i <= iterations:
                    F.count[b] += 1
                    fabric_force(b, nu, nv, hung, ca, cv)
                    if npt > 0:
                        muscles(b, nu, nv, npt, cv)
                    if i == 0:
                        first_residual(b, nu, nv)
                    else:
                        step_length(b, nu, nv)
                    if i < iterations:
                        if i < turns[m]:
                            frames(b, nu, nv, reach)
                            if npt > 0:
                                woodbury(b, nu, nv, npt)
                        if direction(b, nu, nv, npt, i, tolerance) == 0:
                            i = iterations
                    i += 1
                finish(
                    b, nu, nv, table[m, 0], table[m, 1], table[m, 2], table[m, 3], table[m, 4], table[m, 5], table[m, 6]
                )


@ti.func
def predict(b, nu, nv, h, am, af, ga, ia, ry, ba):
    """Histories hv, ha, and the first guess: the velocity goes on, so that viscous forces do."""
    n3 = 3 * (nu + 2) * (nv + 2)
    for k_ in range(n3):
        k = F.index[k_]
        x0 = F.node[b, F.x0 + k]
        v0 = F.node[b, F.v0 + k]
        a0 = F.node[b, F.a0 + k]
        a1 = -ia * (af * ry + 1.0) * x0 - ia * h * v0 - ba * a0
        F.node[b, F.xp + k] = x0
        F.node[b, F.vp + k] = v0
        F.node[b, F.ha + k] = (1 - am) * a1 + am * a0
        F.node[b, F.hv + k] = (1 - af) * (v0 + h * (1 - ga) * a0 + h * ga * a1) + af * v0
    for k_ in range(n3):
        k = F.index[k_]
        F.node[b, F.q + k] = (F.node[b, F.v0 + k] - F.node[b, F.hv + k]) / (h * ga * ia)


@ti.func
def muscles(b, nu, nv, npt, cv):
    """f += forces of the muscles."""
    points_pos(b, nu, nv, npt)
    points_rate(b, nu, nv, npt, F.v)
    tension(b, npt, cv)
    seg_to_points(b, npt, X.tension)
    back(b, nu, nv, npt, F.f)


@ti.func
def first_residual(b, nu, nv):
    """r = f where nodes are free; p = 0."""
    P = (nu + 2) * (nv + 2)
    for k_ in range(P):
        k = F.index[k_]
        free = F.node[b, F.free + k]
        x = F.node[b, F.f + k] * free
        y = F.node[b, F.f + P + k] * free
        z = F.node[b, F.f + 2 * P + k] * free
        F.node[b, F.r + k] = x
        F.node[b, F.r + P + k] = y
        F.node[b, F.r + 2 * P + k] = z
        F.node[b, F.p + k] = Lanes(0.0)
        F.node[b, F.p + P + k] = Lanes(0.0)
        F.node[b, F.p + 2 * P + k] = Lanes(0.0)
    F.reduce[b, RZ] = Lanes(0.0)
    F.reduce[b, ACTIVE] = Lanes(1.0)


@ti.func
def step_length(b, nu, nv):
    """f holds the residual at q + p: step alpha = p.r / p.(r - r(q + p)), and the residual there by interpolation."""
    P = (nu + 2) * (nv + 2)
    F.reduce[b, 1] = Lanes(0.0)
    F.reduce[b, 2] = Lanes(0.0)
    for k_ in range(P):
        k = F.index[k_]
        free = F.node[b, F.free + k]
        x = F.node[b, F.r + k] - F.node[b, F.f + k] * free
        y = F.node[b, F.r + P + k] - F.node[b, F.f + P + k] * free
        z = F.node[b, F.r + 2 * P + k] - F.node[b, F.f + 2 * P + k] * free
        u = F.node[b, F.p + k]
        v = F.node[b, F.p + P + k]
        w = F.node[b, F.p + 2 * P + k]
        F.node[b, F.f + k] = x
        F.node[b, F.f + P + k] = y
        F.node[b, F.f + 2 * P + k] = z
        F.reduce[b, 1] = F.reduce[b, 1] + (
            u * F.node[b, F.r + k] + v * F.node[b, F.r + P + k] + w * F.node[b, F.r + 2 * P + k]
        )
        F.reduce[b, 2] = F.reduce[b, 2] + (u * x + v * y + w * z)
    for lane in range(LANES):
        alpha = ti.f32(1.0)
        if F.reduce[b, 2][lane] > 0:
            alpha = ti.min(2.0, ti.max(0.1, F.reduce[b, 1][lane] / F.reduce[b, 2][lane]))
        F.reduce[b, ALPHA][lane] = alpha * F.reduce[b, ACTIVE][lane]
    alpha = F.reduce[b, ALPHA]
    more = alpha - F.reduce[b, ACTIVE]
    for k_ in range(P):
        k = F.index[k_]
        for c in ti.static(range(3)):
            F.node[b, F.q + c * P + k] = F.node[b, F.q + c * P + k] + more * F.node[b, F.p + c * P + k]
            F.node[b, F.rp + c * P + k] = F.node[b, F.r + c * P + k]
        x = F.node[b, F.r + k] - alpha * F.node[b, F.f + k]
        y = F.node[b, F.r + P + k] - alpha * F.node[b, F.f + P + k]
        z = F.node[b, F.r + 2 * P + k] - alpha * F.node[b, F.f + 2 * P + k]
        F.node[b, F.r + k] = x
        F.node[b, F.r + P + k] = y
        F.node[b, F.r + 2 * P + k] = z


@ti.func
def direction(b, nu, nv, npt, i, tolerance):
    """y = P^-1 r: solve for the cloth; with muscles, again with what their tensions answer. Then p = y + beta p and
    q += p in the lanes that have not converged; returns how many those are."""
    warp(b, nu, nv, F.r)
    passes = 1
    if npt > 0:
        passes = 2
    for m in range(passes):
        if m == 1:
            muscle_correct(b, nu, nv, npt)
        spectral(b, nu, nv, 0, 3)
    unwarp(b, nu, nv, F.y)
    P = (nu + 2) * (nv + 2)
    for slot in range(3):
        F.reduce[b, slot] = Lanes(0.0)
    for k_ in range(P):
        k = F.index[k_]
        x = F.node[b, F.y + k]
        y = F.node[b, F.y + P + k]
        z = F.node[b, F.y + 2 * P + k]
        F.reduce[b, 0] = F.reduce[b, 0] + (x * x + y * y + z * z)
        F.reduce[b, 1] = F.reduce[b, 1] + (
            x * F.node[b, F.r + k] + y * F.node[b, F.r + P + k] + z * F.node[b, F.r + 2 * P + k]
        )
        F.reduce[b, 2] = F.reduce[b, 2] + (
            x * F.node[b, F.rp + k] + y * F.node[b, F.rp + P + k] + z * F.node[b, F.rp + 2 * P + k]
        )
    active = 0
    for lane in range(LANES):
        beta = ti.f32(0.0)
        if i > 1 and F.reduce[b, RZ][lane] > 0:
            beta = ti.max(0.0, (F.reduce[b, 1][lane] - F.reduce[b, 2][lane]) / F.reduce[b, RZ][lane])
        F.reduce[b, BETA][lane] = beta
        F.reduce[b, RZ][lane] = F.reduce[b, 1][lane]
        if i > 0 and F.reduce[b, 0][lane] < tolerance * tolerance * nu * nv:  # a step is never left as it was guessed
            F.reduce[b, ACTIVE][lane] = 0.0
        if F.reduce[b, ACTIVE][lane] > 0 and F.reduce[b, 0][lane] < DIVERGED:
            active += 1
    beta = F.reduce[b, BETA]
    moving = F.reduce[b, ACTIVE]
    for k_ in range(3 * P):
        k = F.index[k_]
        d = (F.node[b, F.y + k] + beta * F.node[b, F.p + k]) * moving
        F.node[b, F.p + k] = d
        F.node[b, F.q + k] = F.node[b, F.q + k] + d
    return active


@ti.func
def finish(b, nu, nv, h, am, af, ga, ia, ry, ba):
    """From the evaluation point to the end of the step."""
    P = (nu + 2) * (nv + 2)
    for c in range(3):
        for i_ in range(P):
            i = F.index[i_]
            k = c * P + i
            x0 = F.node[b, F.x0 + k]
            v0 = F.node[b, F.v0 + k]
            a0 = F.node[b, F.a0 + k]
            d = ry * (F.node[b, F.q + k] - x0) * F.node[b, F.free + i]
            a1 = (ia * (d - h * v0) - ba * a0) * F.node[b, F.free + i]
            F.node[b, F.x0 + k] = x0 + d
            F.node[b, F.v0 + k] = v0 + h * ((1 - ga) * a0 + ga * a1)
            F.node[b, F.a0 + k] = a1
            F.node[b, F.carry + k] = F.node[b, F.r + k]


_factor, _green, _march = Timed(_factor_kernel), Timed(_green_kernel), Timed(_march_kernel)

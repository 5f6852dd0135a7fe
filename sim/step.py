"""One time step of a batch, in solver order: predict, then repeat (forces, frames, global solve, step), finish.

Time: generalised-alpha (Chung and Hulbert 1993, their equations 8-13) with spectral radius rho at infinity. The unknown
is the position q at the evaluation time; velocity and acceleration there are linear in it, v = cv q + hv and
a = ca q + ha. The residual r(q) = f(q, v) - M a is the XPBD system of all constraints at once.
Space: a constraint C of compliance alpha gives f = -grad C^T C / alpha (sim/sheet.py, sim/lacing.py).
Solve: conjugate gradients on the nonlinear residual, the step length by the secant (Polak-Ribiere, restarted every
step), preconditioned by sim/preconditioner.py. A lane whose update is below the tolerance no longer moves, so that a
design's result does not depend on its neighbours.
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim.fields import LANES, F, Timed, X
from sim.lacing import back, points_pos, points_rate, seg_to_points, tension
from sim.preconditioner import factor, frames, green, muscle_correct, spectral, unwarp, warp, woodbury
from sim.sheet import fabric_force

Lanes = ti.types.vector(LANES, ti.f32)
RZ, BETA, ACTIVE, ALPHA = 4, 5, 6, 7  # slots of F.reduce
FIRST, FULL, SECANT = 0, 1, 2  # what a residual is for: a step's first; one after a full step; the secant along p


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


def step(
    batch: Batch, scheme: Scheme, pressure: NDArray[np.float32], *, iterations: int, tolerance: float, refresh: int = 2
) -> int:
    """Advance all lanes by one step under `pressure` (blocks, channels, LANES) Pa; returns the iterations used.

    refresh: in so many of the first iterations the preconditioner turns with the shape.
    tolerance [m]: a lane has converged when the RMS over nodes of its preconditioned residual falls below it.
    """
    size = (*batch.grid, batch.points)
    _predict(*size, pressure, *scheme.coefficients)
    _residual(batch, scheme, FIRST)
    used = 0
    for i in range(iterations):
        if i < refresh:
            _refresh(*size, batch.reach)
        if not _direction(*size, int(i <= 1), tolerance if i else 0.0):  # a step is never left as it was guessed
            break
        _residual(batch, scheme, FULL if i == 0 else SECANT)
        used += 1
    _finish(*batch.grid, *scheme.coefficients)
    return used


def _residual(batch: Batch, scheme: Scheme, purpose: int) -> None:
    """r at q, from the forces of cloth and muscles and the inertia."""
    _cloth(*batch.grid, batch.hung, scheme.ca, scheme.cv)
    _muscles(*batch.grid, batch.points, scheme.cv, purpose)


@ti.kernel
def _factor_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, ca: ti.f32, cv: ti.f32):
    for b in range(nb):
        factor(b, nu, nv, ca, cv)


@ti.kernel
def _green_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32):
    for b in range(nb):
        green(b, nu, nv, npt)


@ti.kernel
def _predict_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, pressure: ti.types.ndarray(dtype=ti.f32, ndim=3),
    h: ti.f32, am: ti.f32, af: ti.f32, ga: ti.f32, ia: ti.f32, ry: ti.f32, ba: ti.f32,
):  # fmt: skip
    """Histories hv, ha, and the first guess: the velocity goes on, so that viscous forces do."""
    for b in range(nb):
        n3 = 3 * (nu + 2) * (nv + 2)
        for k in range(npt):
            for lane in range(LANES):
                F.point[b, X.pressure + k][lane] = pressure[b, F.channel[b, k][lane], lane]
        for k in range(n3):
            x0 = F.node[b, F.x0 + k]
            v0 = F.node[b, F.v0 + k]
            a0 = F.node[b, F.a0 + k]
            a1 = -ia * (af * ry + 1.0) * x0 - ia * h * v0 - ba * a0
            F.node[b, F.xp + k] = x0
            F.node[b, F.vp + k] = v0
            F.node[b, F.ha + k] = (1 - am) * a1 + am * a0
            F.node[b, F.hv + k] = (1 - af) * (v0 + h * (1 - ga) * a0 + h * ga * a1) + af * v0
        for k in range(n3):
            F.node[b, F.q + k] = (F.node[b, F.v0 + k] - F.node[b, F.hv + k]) / (h * ga * ia)


@ti.kernel
def _cloth_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, hung: ti.i32, ca: ti.f32, cv: ti.f32):
    """v = cv q + hv, and f = forces of the cloth - M a."""
    for b in range(nb):
        for k in range(3 * (nu + 2) * (nv + 2)):
            F.node[b, F.v + k] = cv * F.node[b, F.q + k] + F.node[b, F.hv + k]
        fabric_force(b, nu, nv, hung, ca)


@ti.kernel
def _muscles_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, cv: ti.f32, purpose: ti.i32):
    """f += forces of the muscles; then the residual r of the conjugate gradients."""
    for b in range(nb):
        if npt > 0:
            points_pos(b, nu, nv, npt)
            points_rate(b, nu, nv, npt, F.v)
            tension(b, npt, cv)
            seg_to_points(b, npt, X.tension)
            back(b, nu, nv, npt, F.f)
        if purpose == FIRST:
            first_residual(b, nu, nv)
        else:
            step_length(b, nu, nv, purpose)


@ti.kernel
def _refresh_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, reach: ti.i32):
    """Turn the preconditioner's frames, and with them the muscles' part."""
    for b in range(nb):
        frames(b, nu, nv, reach)
        if npt > 0:
            woodbury(b, nu, nv, npt)


@ti.func
def first_residual(b, nu, nv):
    P = (nu + 2) * (nv + 2)
    for c in range(3):
        for k in range(P):
            F.node[b, F.r + c * P + k] = F.node[b, F.f + c * P + k] * F.node[b, F.free + k]
            F.node[b, F.p + c * P + k] = Lanes(0.0)
    F.reduce[b, RZ] = Lanes(0.0)
    F.reduce[b, ACTIVE] = Lanes(1.0)


@ti.func
def dot_into(b, slot, n3, first, second):
    """F.reduce[slot] = first . second, in one fixed order."""
    F.reduce[b, slot] = Lanes(0.0)
    for m in range(n3 // 4):
        k = 4 * m
        F.reduce[b, slot] = (
            F.reduce[b, slot]
            + (F.node[b, first + k] * F.node[b, second + k] + F.node[b, first + k + 1] * F.node[b, second + k + 1])
            + (
                F.node[b, first + k + 2] * F.node[b, second + k + 2]
                + F.node[b, first + k + 3] * F.node[b, second + k + 3]
            )
        )
    for k in range(n3 // 4 * 4, n3):
        F.reduce[b, slot] = F.reduce[b, slot] + F.node[b, first + k] * F.node[b, second + k]


@ti.func
def step_length(b, nu, nv, purpose):
    """f holds the residual at q + p: step alpha = p.r / p.(r - r(q + p)), and the residual there by interpolation."""
    P = (nu + 2) * (nv + 2)
    n3 = 3 * P
    for c in range(3):
        for k in range(P):
            F.node[b, F.f + c * P + k] = F.node[b, F.r + c * P + k] - F.node[b, F.f + c * P + k] * F.node[b, F.free + k]
    dot_into(b, 1, n3, F.p, F.r)
    dot_into(b, 2, n3, F.p, F.f)
    for lane in range(LANES):
        alpha = ti.f32(1.0)
        if F.reduce[b, 2][lane] > 0 and purpose == SECANT:
            alpha = ti.min(2.0, ti.max(0.1, F.reduce[b, 1][lane] / F.reduce[b, 2][lane]))
        F.reduce[b, ALPHA][lane] = alpha * F.reduce[b, ACTIVE][lane]
    alpha = F.reduce[b, ALPHA]
    more = alpha - F.reduce[b, ACTIVE]
    for k in range(n3):
        r = F.node[b, F.r + k]
        F.node[b, F.q + k] = F.node[b, F.q + k] + more * F.node[b, F.p + k]
        F.node[b, F.rp + k] = r
        F.node[b, F.r + k] = r - alpha * F.node[b, F.f + k]


@ti.kernel
def _direction_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, restart: ti.i32, tolerance: ti.f32) -> ti.i32:
    """y = P^-1 r: solve for the cloth; with muscles, again with what their tensions answer. Then p = y + beta p and
    q += p in the lanes that have not converged; returns how many those are."""
    active = 0
    for b in range(nb):
        warp(b, nu, nv, F.r)
        passes = 1
        if npt > 0:
            passes = 2
        for m in range(passes):
            if m == 1:
                muscle_correct(b, nu, nv, npt)
            spectral(b, nu, nv, 0, 3)
        unwarp(b, nu, nv, F.y)
        n3 = 3 * (nu + 2) * (nv + 2)
        dot_into(b, 0, n3, F.y, F.y)
        dot_into(b, 1, n3, F.y, F.r)
        dot_into(b, 2, n3, F.y, F.rp)
        for lane in range(LANES):
            beta = ti.f32(0.0)
            if restart == 0 and F.reduce[b, RZ][lane] > 0:
                beta = ti.max(0.0, (F.reduce[b, 1][lane] - F.reduce[b, 2][lane]) / F.reduce[b, RZ][lane])
            F.reduce[b, BETA][lane] = beta
            F.reduce[b, RZ][lane] = F.reduce[b, 1][lane]
            if F.reduce[b, 0][lane] < tolerance * tolerance * nu * nv:
                F.reduce[b, ACTIVE][lane] = 0.0
            if F.reduce[b, ACTIVE][lane] > 0:
                ti.atomic_add(active, 1)
        beta = F.reduce[b, BETA]
        moving = F.reduce[b, ACTIVE]
        for k in range(n3):
            d = (F.node[b, F.y + k] + beta * F.node[b, F.p + k]) * moving
            F.node[b, F.p + k] = d
            F.node[b, F.q + k] = F.node[b, F.q + k] + d
    return active


@ti.kernel
def _finish_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32,
    h: ti.f32, am: ti.f32, af: ti.f32, ga: ti.f32, ia: ti.f32, ry: ti.f32, ba: ti.f32,
):  # fmt: skip
    """From the evaluation point to the end of the step."""
    for b in range(nb):
        P = (nu + 2) * (nv + 2)
        for c in range(3):
            for i in range(P):
                k = c * P + i
                x0 = F.node[b, F.x0 + k]
                v0 = F.node[b, F.v0 + k]
                a0 = F.node[b, F.a0 + k]
                d = ry * (F.node[b, F.q + k] - x0) * F.node[b, F.free + i]
                a1 = (ia * (d - h * v0) - ba * a0) * F.node[b, F.free + i]
                F.node[b, F.x0 + k] = x0 + d
                F.node[b, F.v0 + k] = v0 + h * ((1 - ga) * a0 + ga * a1)
                F.node[b, F.a0 + k] = a1


_factor, _green, _predict = Timed(_factor_kernel), Timed(_green_kernel), Timed(_predict_kernel)
_cloth, _muscles, _refresh = Timed(_cloth_kernel), Timed(_muscles_kernel), Timed(_refresh_kernel)
_direction, _finish = Timed(_direction_kernel), Timed(_finish_kernel)

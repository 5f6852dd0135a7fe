"""Conjugate gradients on the nonlinear residual of a step.

The step length is the secant's, beta is Polak-Ribiere's, restarted every step.
"""

import taichi as ti

from sim.fields import LANES, F
from sim.frames import unwarp, warp
from sim.model import FREE
from sim.muscle_solve import muscle_correct
from sim.sheet_solve import spectral
from sim.vectors import dot, load, store

Lanes = ti.types.vector(LANES, ti.f32)
RZ, BETA, ACTIVE, ALPHA = 4, 5, 6, 7  # slots of F.reduce
DIVERGED = 1e4  # m^2, a squared update that no lane comes back from; others do not wait for it, nor for a NaN


@ti.func
def first_residual(b, nu, nv):
    """r = f where nodes are free; p = 0."""
    P = (nu + 2) * (nv + 2)
    k = 0
    while k < P:
        free = F.node[b, F.free + k]
        x, y, z = load(b, F.f, P, k)
        store(b, F.r, P, k, x * free, y * free, z * free)
        store(b, F.p, P, k, Lanes(0.0), Lanes(0.0), Lanes(0.0))
        k = F.after[k]
    F.reduce[b, RZ] = Lanes(0.0)
    F.reduce[b, ACTIVE] = Lanes(1.0)


@ti.func
def step_length(b, nu, nv, hung):
    """f holds the residual at q + p: step alpha = p.r / p.(r - r(q + p)), and the residual there by interpolation."""
    P = (nu + 2) * (nv + 2)
    F.reduce[b, 1] = Lanes(0.0)
    F.reduce[b, 2] = Lanes(0.0)
    k = 0
    while k < P:
        free = F.node[b, F.free + k]
        rx, ry, rz = load(b, F.r, P, k)
        fx, fy, fz = load(b, F.f, P, k)
        px, py, pz = load(b, F.p, P, k)
        x = rx - fx * free
        y = ry - fy * free
        z = rz - fz * free
        store(b, F.f, P, k, x, y, z)
        F.reduce[b, 1] = F.reduce[b, 1] + dot(px, py, pz, rx, ry, rz)
        F.reduce[b, 2] = F.reduce[b, 2] + dot(px, py, pz, x, y, z)
        k = F.after[k]
    least = ti.f32(0.1)
    if hung == FREE:  # nodes held one by one are not in the preconditioner: what they hold is stiffer by far than there
        least = ti.f32(1e-6)
    for lane in range(LANES):
        alpha = ti.f32(1.0)
        if F.reduce[b, 2][lane] > 0:
            alpha = ti.min(2.0, ti.max(least, F.reduce[b, 1][lane] / F.reduce[b, 2][lane]))
        F.reduce[b, ALPHA][lane] = alpha * F.reduce[b, ACTIVE][lane]
    alpha = F.reduce[b, ALPHA]
    more = alpha - F.reduce[b, ACTIVE]
    k = 0
    while k < P:
        for c in ti.static(range(3)):
            r = F.node[b, F.r + c * P + k]
            F.node[b, F.q + c * P + k] = F.node[b, F.q + c * P + k] + more * F.node[b, F.p + c * P + k]
            F.node[b, F.rp + c * P + k] = r
            F.node[b, F.r + c * P + k] = r - alpha * F.node[b, F.f + c * P + k]
        k = F.after[k]


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
    k = 0
    while k < P:
        x, y, z = load(b, F.y, P, k)
        rx, ry, rz = load(b, F.r, P, k)
        ox, oy, oz = load(b, F.rp, P, k)
        F.reduce[b, 0] = F.reduce[b, 0] + dot(x, y, z, x, y, z)
        F.reduce[b, 1] = F.reduce[b, 1] + dot(x, y, z, rx, ry, rz)
        F.reduce[b, 2] = F.reduce[b, 2] + dot(x, y, z, ox, oy, oz)
        k = F.after[k]
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
    k = 0
    while k < 3 * P:
        d = (F.node[b, F.y + k] + beta * F.node[b, F.p + k]) * moving
        F.node[b, F.p + k] = d
        F.node[b, F.q + k] = F.node[b, F.q + k] + d
        k = F.after[k]
    return active

"""Preconditioned conjugate gradients on the tangent of the forces, one column after another, each lane its own."""

import taichi as ti

from sim.grid import EDGES
from sim.kernels.fields import LANES, F, T, indices
from sim.kernels.vectors import Lanes, Wide, sum3, thrice
from sim.solver.frames import rotate
from sim.solver.muscles import solve
from sim.tangent.cloth import fabric_tangent
from sim.tangent.muscles import muscle_tangent
from sim.time_steps import CA

SOLVED, UNSOLVED, INDEFINITE = range(3)  # what came of a column
RZ, ACTIVE = 4, 6  # slots of F.reduce
TINY = 1e-30


@ti.func
def apply_tangent(b, nu, nv, npt, support):
    """F.f <- the change of forces in the direction F.p."""
    fabric_tangent(b, nu, nv, support)
    if npt > 0:
        muscle_tangent(b, nu, npt)


@ti.func
def conjugate_gradients(b, nu, nv, npt, support, slot, iterations, tolerance):
    """T.x += the solution of -tangent x = F.r, until the preconditioned residual is below `tolerance` times that. What
    came of it to T.outcome at `slot`; a lane whose tangent is not positive definite stops."""
    count = (nu + 2) * (nv + 2)
    for k in indices(count):
        F.node3[b, F.p + k] = Wide(0.0)
    F.reduce[b, ACTIVE] = Lanes(1.0)
    i = 0
    while i <= iterations:
        rotate(b, nu, nv, F.r, True)
        solve(b, nu, nv, npt, support < EDGES)
        rotate(b, nu, nv, F.y, False)
        for n in range(3):
            F.reduce[b, n] = Lanes(0.0)
        for k in indices(count):
            y = F.node3[b, F.y + k]
            x = T.node3[b, T.x + k]
            F.reduce[b, 0] = F.reduce[b, 0] + sum3(y * F.node3[b, F.r + k])
            F.reduce[b, 1] = F.reduce[b, 1] + sum3(y * y)
            F.reduce[b, 2] = F.reduce[b, 2] + sum3(x * x)
        going = 0
        for lane in indices(LANES):
            rz = F.reduce[b, 0][lane]
            small = F.reduce[b, 1][lane] <= tolerance * tolerance * F.reduce[b, 2][lane]
            beta = ti.f32(0.0)
            if i > 0:
                beta = rz / ti.max(F.reduce[b, RZ][lane], TINY)
            F.reduce[b, 1][lane] = beta
            F.reduce[b, RZ][lane] = rz
            if F.reduce[b, ACTIVE][lane] > 0:
                T.outcome[b, slot][lane] = UNSOLVED
                if small or not rz > 0:
                    F.reduce[b, ACTIVE][lane] = 0.0
                    T.outcome[b, slot][lane] = SOLVED if small else INDEFINITE
                else:
                    going += 1
        if going == 0 or i == iterations:
            i = iterations
        else:
            advance(b, nu, nv, npt, support, slot)
        i += 1


@ti.func
def advance(b, nu, nv, npt, support, slot):
    """One direction further."""
    count = (nu + 2) * (nv + 2)
    beta, active = thrice(F.reduce[b, 1]), thrice(F.reduce[b, ACTIVE])
    for k in indices(count):
        d = active * (F.node3[b, F.y + k] + beta * F.node3[b, F.p + k])
        F.node3[b, F.p + k] = d
    apply_tangent(b, nu, nv, npt, support)
    F.reduce[b, 2] = Lanes(0.0)
    for k in indices(count):
        f = F.node3[b, F.f + k] - thrice(F.scheme[b, CA] * F.node[b, F.mass + k]) * F.node3[b, F.p + k]
        f = f * thrice(F.node[b, F.free + k])
        F.node3[b, F.f + k] = f
        F.reduce[b, 2] = F.reduce[b, 2] - sum3(F.node3[b, F.p + k] * f)
    for lane in indices(LANES):
        alpha = ti.f32(0.0)
        if F.reduce[b, ACTIVE][lane] > 0:
            if F.reduce[b, 2][lane] > 0:
                alpha = F.reduce[b, RZ][lane] / F.reduce[b, 2][lane]
            else:
                T.outcome[b, slot][lane] = INDEFINITE
                F.reduce[b, ACTIVE][lane] = 0.0
        F.reduce[b, 3][lane] = alpha
    step = thrice(F.reduce[b, 3])
    for k in indices(count):
        T.node3[b, T.x + k] = T.node3[b, T.x + k] + step * F.node3[b, F.p + k]
        F.node3[b, F.r + k] = F.node3[b, F.r + k] + step * F.node3[b, F.f + k]

"""Conjugate gradients on the nonlinear residual of a step.

The step length is the secant's, beta is Polak-Ribiere's, restarted every step. Where the step length is short, the
residual between both ends is like neither: such a lane looks again before it goes on.
"""

import taichi as ti

from sim.kernels.fields import LANES, F, indices
from sim.kernels.vectors import Lanes, Wide, sum3, thrice
from sim.solver.frames import rotate
from sim.solver.muscles import solve

RZ, BETA, ALPHA = 4, 5, 7  # slots of F.reduce
ACTIVE, UNCONVERGED, REEVALUATES = 6, 8, 9  # 1 where a lane moves, will still move after, and looks again first
SHORTEST_STEP = 1e-6  # what hangs at single nodes, or is folded, is stiffer by far than in the preconditioner
SHORT = 0.1  # step length below which the residual is evaluated anew; else snapping cloths run away
DIVERGED = 1e4  # m^2, a squared update that no lane comes back from; others do not wait for it, nor for a NaN


@ti.func
def first_residual(b, nu, nv):
    """r = f where nodes are free; p = 0."""
    for k in indices((nu + 2) * (nv + 2)):
        F.node3[b, F.r + k] = F.node3[b, F.f + k] * thrice(F.node[b, F.free + k])
        F.node3[b, F.p + k] = Wide(0.0)
    F.reduce[b, RZ] = Lanes(0.0)
    F.reduce[b, UNCONVERGED] = Lanes(1.0)
    F.reduce[b, REEVALUATES] = Lanes(0.0)


@ti.func
def step_length(b, nu, nv, edge):
    """f holds the residual at q + p: step alpha = p.r / p.(r - r(q + p)), and the residual there by interpolation.
    Leaves r - r(q + p) in f. edge: whether P knows all held nodes; if not, steps are short without being wrong."""
    P = (nu + 2) * (nv + 2)
    F.reduce[b, 1] = Lanes(0.0)
    F.reduce[b, 2] = Lanes(0.0)
    for k in indices(P):
        r = F.node3[b, F.r + k]
        p = F.node3[b, F.p + k]
        change = r - F.node3[b, F.f + k] * thrice(F.node[b, F.free + k])
        F.node3[b, F.f + k] = change
        F.reduce[b, 1] = F.reduce[b, 1] + sum3(p * r)
        F.reduce[b, 2] = F.reduce[b, 2] + sum3(p * change)
    for lane in indices(LANES):
        alpha = ti.f32(1.0)
        if F.reduce[b, 2][lane] > 0:
            alpha = ti.min(2.0, ti.max(SHORTEST_STEP, F.reduce[b, 1][lane] / F.reduce[b, 2][lane]))
        short = edge and alpha < SHORT and F.reduce[b, ACTIVE][lane] > 0
        if F.reduce[b, REEVALUATES][lane] > 0:  # with p = 0: r becomes f
            alpha = 1.0
            short = False
        F.reduce[b, REEVALUATES][lane] = ti.select(short, 1.0, 0.0)
        F.reduce[b, ALPHA][lane] = alpha * F.reduce[b, ACTIVE][lane]
    alpha = thrice(F.reduce[b, ALPHA])
    more = thrice(F.reduce[b, ALPHA] - F.reduce[b, ACTIVE])
    for k in indices(P):
        F.node3[b, F.q + k] = F.node3[b, F.q + k] + more * F.node3[b, F.p + k]
        F.node3[b, F.r + k] = F.node3[b, F.r + k] - alpha * F.node3[b, F.f + k]


@ti.func
def direction(b, nu, nv, npt, edge, same, tolerance):
    """y = P^-1 r, then p = y + beta p and q += p in the lanes that have not converged. Where y is below the tolerance
    that was the last time; returns how many lanes go on. same: whether P is that of the last iterations."""
    rotate(b, nu, nv, F.r, True)
    solve(b, nu, nv, npt, edge)
    rotate(b, nu, nv, F.y, False)
    P = (nu + 2) * (nv + 2)
    for slot in range(3):
        F.reduce[b, slot] = Lanes(0.0)
    for k in indices(P):
        y = F.node3[b, F.y + k]
        F.reduce[b, 0] = F.reduce[b, 0] + sum3(y * y)
        F.reduce[b, 1] = F.reduce[b, 1] + sum3(y * F.node3[b, F.r + k])
        F.reduce[b, 2] = F.reduce[b, 2] - sum3(y * F.node3[b, F.f + k])
    F.reduce[b, 2] = F.reduce[b, ALPHA] * F.reduce[b, 2]  # y . (r - r before)
    unconverged = 0
    F.reduce[b, ACTIVE] = F.reduce[b, UNCONVERGED]
    for lane in indices(LANES):
        beta = ti.f32(0.0)
        if same and F.reduce[b, RZ][lane] > 0:
            beta = ti.max(0.0, F.reduce[b, 2][lane] / F.reduce[b, RZ][lane])
        F.reduce[b, BETA][lane] = beta
        F.reduce[b, RZ][lane] = F.reduce[b, 1][lane]
        if F.reduce[b, 0][lane] < tolerance * tolerance * nu * nv and F.reduce[b, REEVALUATES][lane] == 0:
            F.reduce[b, UNCONVERGED][lane] = 0.0
        if F.reduce[b, UNCONVERGED][lane] > 0 and F.reduce[b, 0][lane] < DIVERGED:
            unconverged += 1
    beta = thrice(F.reduce[b, BETA])
    moving = thrice(F.reduce[b, ACTIVE] * (1.0 - F.reduce[b, REEVALUATES]))
    for k in indices(P):
        d = (F.node3[b, F.y + k] + beta * F.node3[b, F.p + k]) * moving
        F.node3[b, F.p + k] = d
        F.node3[b, F.q + k] = F.node3[b, F.q + k] + d
    return unconverged

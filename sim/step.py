"""One time step of a batch, in solver order: predict, then repeat (forces, step length, frames, global solve), finish.

Time: generalised-alpha (Chung and Hulbert 1993, their equations 8-13) with spectral radius rho at infinity. The unknown
is the position q at the evaluation time; velocity and acceleration there are linear in it, v = cv q + hv and
a = ca q + ha. The residual r(q) = f(q, v) - M a is the XPBD system of all constraints at once.
Space: a constraint C of compliance alpha gives f = -grad C^T C / alpha (sim/sheet.py, sim/lacing.py).
Solve: sim/conjugate_gradients.py, preconditioned by the linear problem of the flat cloth (sim/sheet_solve.py) and its
muscles (sim/muscle_solve.py) in frames that follow the shape (sim/frames.py), and by what a bent sheet's softest modes
are (sim/coarse_space.py). A lane whose update is below the
tolerance no longer moves, so that a design's result does not depend on its neighbours. What its residual then is, a
force, acts in the next step: errors of the solve cancel instead of adding up to a drift.
"""

from collections.abc import Sequence

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim.coarse_space import assemble
from sim.conjugate_gradients import LEFT, direction, first_residual, step_length
from sim.contact import contact
from sim.fields import LANES, SPREAD, F, Timed, X
from sim.frames import frames
from sim.lacing import back, points_pos, points_rate, sample, seg_to_points, tension
from sim.model import FREE
from sim.muscle_modes import green
from sim.muscle_solve import woodbury
from sim.scheme import Batch, Scheme
from sim.sheet import fabric_force
from sim.sheet_solve import factor
from sim.vectors import thrice


def prepare(batch: Batch, scheme: Scheme) -> None:
    """Factor the preconditioner for this scheme's step."""
    _prepare(*batch.grid, batch.points, scheme.ca, scheme.cv)


def march(
    batch: Batch, schemes: Sequence[Scheme], pressure: NDArray[np.float32], *, iterations: int, tolerance: float
) -> None:
    """Advance all lanes by len(schemes) steps under `pressure` (steps, blocks, channels, LANES) Pa.

    tolerance [m]: a lane has converged when the RMS over nodes of its preconditioned residual falls below it.
    """
    # where nodes are held one by one, long steps to rest have no use for what they carry: it keeps them from resting
    carried = [0.0 if batch.hung == FREE and scheme.rho < 0 else 1.0 for scheme in schemes]
    table = np.array(
        [(*s.coefficients, s.ca, s.cv, c, s.goes_on) for s, c in zip(schemes, carried, strict=True)], np.float32
    )
    turns = np.array([(s.turns, 1 if s.renews else 0) for s in schemes], np.int32)
    at_once = 1 if batch.touching else len(schemes)
    for first in range(0, len(schemes), at_once):
        run = slice(first, first + at_once)
        if batch.touching:
            batch.touching.refresh(batch.blocks, schemes[first].h)
        _march(
            *batch.grid, batch.points, batch.hung, batch.reach, iterations, tolerance, table[run], turns[run],
            np.ascontiguousarray(pressure[run]),
        )  # fmt: skip


@ti.kernel
def _march_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, hung: ti.i32, reach: ti.i32, iterations: ti.i32,
    tolerance: ti.f32, table: ti.types.ndarray(dtype=ti.f32, ndim=2), turns: ti.types.ndarray(dtype=ti.i32, ndim=2),
    pressure: ti.types.ndarray(dtype=ti.f32, ndim=4),
):  # fmt: skip
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            b = task // SPREAD
            for m in range(table.shape[0]):
                ca = table[m, 7]
                cv = table[m, 8]
                k = 0
                while k < npt:
                    lane = 0
                    while lane < LANES:
                        F.point[b, X.pressure + k][lane] = pressure[m, b, F.channel[b, k][lane], lane]
                        lane = F.after[lane]
                    k = F.after[k]
                predict(
                    b, nu, nv, table[m, 0], table[m, 1], table[m, 2], table[m, 3], table[m, 4], table[m, 5],
                    table[m, 6], table[m, 10],
                )  # fmt: skip
                i = 0
                last = iterations
                while i <= last:
                    fabric_force(b, nu, nv, hung, ca, cv)
                    if npt > 0:
                        muscles(b, nu, npt, cv)
                    contact(b, nu)
                    if i == 0:
                        first_residual(b, nu, nv)
                    else:
                        step_length(b, nu, nv, hung < FREE)
                    if i < last:
                        if i < turns[m, 0]:
                            frames(b, nu, nv, reach)
                            if npt > 0:
                                woodbury(b, nu, npt)
                            if hung < FREE and i < turns[m, 1]:
                                assemble(b, nu, nv, npt, ca, cv)
                        if direction(b, nu, nv, npt, hung < FREE, i > 1, tolerance) == 0:
                            last = i + 1
                    i += 1
                finish(
                    b, nu, nv, table[m, 0], table[m, 1], table[m, 2], table[m, 3], table[m, 4], table[m, 5],
                    table[m, 6], table[m, 9],
                )  # fmt: skip


@ti.func
def predict(b, nu, nv, h, am, af, ga, ia, ry, ba, goes_on):
    """Histories: v = cv (q - x0) + hv and a = ca (q - x0) + ha, and the first guess. Of q - x0, not of q: rounded
    coefficients of far larger terms would push the cloth. Where a lane did not converge, no acceleration is known."""
    known = thrice(goes_on * 0.5 * h * h * (1.0 - F.reduce[b, LEFT]))
    P = (nu + 2) * (nv + 2)
    k = 0
    while k < P:
        x0 = F.node3[b, F.x0 + k]
        v0 = F.node3[b, F.v0 + k]
        a0 = F.node3[b, F.a0 + k]
        a1 = -ia * h * v0 - ba * a0
        hv = (1 - af) * (v0 + h * (1 - ga) * a0 + h * ga * a1) + af * v0
        F.node3[b, F.xp + k] = x0
        F.node3[b, F.vp + k] = v0
        F.node3[b, F.ha + k] = (1 - am) * a1 + am * a0
        F.node3[b, F.hv + k] = hv
        F.node3[b, F.q + k] = x0 + (h * v0 + known * a0) / ry
        k = F.after[k]


@ti.func
def muscles(b, nu, npt, cv):
    """f += forces of the muscles."""
    sample(b, nu, npt, F.q, F.v, X.pos)
    points_pos(b, npt)
    points_rate(b, npt)
    tension(b, npt, cv)
    seg_to_points(b, npt, X.tension)
    back(b, nu, npt, F.f)


@ti.func
def finish(b, nu, nv, h, am, af, ga, ia, ry, ba, share):
    """From the evaluation point to the end of the step; what a lane that has converged still lacks is carried over."""
    carried = thrice(share * (1.0 - F.reduce[b, LEFT]))
    P = (nu + 2) * (nv + 2)
    k = 0
    while k < P:
        x0 = F.node3[b, F.x0 + k]
        v0 = F.node3[b, F.v0 + k]
        a0 = F.node3[b, F.a0 + k]
        free = thrice(F.node[b, F.free + k])
        d = ry * (F.node3[b, F.q + k] - x0) * free
        a1 = (ia * (d - h * v0) - ba * a0) * free
        F.node3[b, F.x0 + k] = x0 + d
        F.node3[b, F.v0 + k] = v0 + h * ((1 - ga) * a0 + ga * a1)
        F.node3[b, F.a0 + k] = a1
        F.node3[b, F.carry + k] = carried * F.node3[b, F.r + k]
        k = F.after[k]


@ti.kernel
def _prepare_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, ca: ti.f32, cv: ti.f32):
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            factor(task // SPREAD, nu, nv, ca, cv)
            green(task // SPREAD, nu, nv, npt)


_prepare, _march = Timed(_prepare_kernel), Timed(_march_kernel)

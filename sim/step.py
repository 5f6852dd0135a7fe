"""One time step of a batch, in solver order: predict, then repeat (forces, step length, frames, global solve), finish.

Time: generalised-alpha (Chung and Hulbert 1993, their equations 8-13) with spectral radius rho at infinity. The unknown
is the position q at the evaluation time; velocity and acceleration there are linear in it, v = cv q + hv and
a = ca q + ha. The residual r(q) = f(q, v) - M a is the XPBD system of all constraints at once.
Space: a constraint C of compliance alpha gives f = -grad C^T C / alpha (sim/forces/cloth.py, sim/forces/muscles.py).
Solve: sim/solver/conjugate_gradients.py, preconditioned by the linear problem of the flat cloth
(sim/solver/flat_cloth.py) and its muscles (sim/solver/muscles.py) in frames that follow the shape
(sim/solver/frames.py), and by what a bent sheet's softest modes are (sim/solver/coarse_space.py). A lane whose update
is below the tolerance no longer moves, so that a design's result does not depend on its neighbours. What its residual
then is, a force, acts in the next step: errors of the solve cancel instead of adding up to a drift.
"""

import functools
from dataclasses import dataclass

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim.forces.added import AddedForce, age_stress, relaxes, remember
from sim.forces.cloth import fabric_force, velocities
from sim.forces.contact import contact
from sim.forces.lead import Places, lead_to, pull_ahead
from sim.forces.muscles import points_pos, points_rate, pull, sample, spread, tension
from sim.grid import EDGES
from sim.kernels.fields import LANES, SPREAD, WIDE, F, Timed, X, floats, indices, ints
from sim.kernels.transfer import halt, record
from sim.kernels.vectors import thrice
from sim.schedule import FACTORISED, IDLE, Batch, Schedule
from sim.solver.coarse_space import assemble
from sim.solver.conjugate_gradients import UNCONVERGED, direction, first_residual, step_length
from sim.solver.flat_cloth import factorise
from sim.solver.frames import frames
from sim.solver.muscle_modes import green
from sim.solver.muscles import woodbury
from sim.time_steps import AF, AM, BA, CARRIED, GAMMA, IA, KNOWN, RY, H

AT_ONCE = 64  # steps in one call of the kernel: an interrupt waits for its end
AT_ONCE_LED = 16  # whose places are in memory together
NOWHERE = np.zeros((1, 1, 1, WIDE), np.float32)


@dataclass(frozen=True)
class Solve:
    """How a step is solved."""

    iterations: int  # at most
    tolerance: float  # m; a lane has converged when the RMS over nodes of its preconditioned residual falls below it
    added: tuple[AddedForce, ...] = ()  # forces of effects


def advance(
    batch: Batch, schedule: Schedule, solve: Solve, *, frames: int = 0, lead: Places | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Advance all lanes by the steps of `schedule`. Returns its `frames` frames: (frames, nu nv, 3) m, mid-surface, and
    (frames, points, 2), contraction and tension [N] of every interval. lead: gives where springs lead in steps begin to
    end (sim/forces/lead.py)."""
    shapes = np.full((max(frames, 1), batch.nu * batch.nv, 3), np.nan, np.float32)
    states = np.zeros((max(frames, 1), max(batch.points, 1), 2), np.float32)
    kernel = _advance(solve.added)
    steps = len(schedule.work)
    at_once = 1 if batch.touching else AT_ONCE_LED if lead else AT_ONCE
    for begin in range(0, steps, at_once):
        end = min(begin + at_once, steps)
        part, places = schedule.part(begin, end), lead(begin, end) if lead else NOWHERE
        if batch.touching:
            batch.touching.refresh(batch.blocks, part.scheme[0, :, H].ravel())
        kernel(
            *batch.grid, batch.points, batch.support, batch.smoothing, solve.iterations, part.frame_updates,
            solve.tolerance, part.scheme, part.work, part.pressure, part.first, part.theta, places, shapes, states,
        )  # fmt: skip
    if schedule.halts:
        halt(*batch.grid)
    return shapes[:frames], states[:frames, : batch.points]


@functools.cache
def _advance(added: tuple[AddedForce, ...]) -> Timed:
    """Return the kernel with these added forces; the one without does not pay for them."""

    @ti.kernel
    def advance_kernel(
        nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, support: ti.i32, smoothing: ti.i32,
        iterations: ti.i32, frame_updates: ti.i32, tolerance: ti.f32, scheme: floats(4), work: ints(2),
        pressure: floats(4), first: ints(3), theta: floats(1), places: floats(4), shapes: floats(3), states: floats(3),
    ):  # fmt: skip
        for task in range(nb * SPREAD):
            if task % SPREAD == 0:
                b = task // SPREAD
                for m in range(work.shape[0]):
                    if work[m, b] != IDLE:
                        kept = 0
                        for lane in range(LANES):
                            kept = ti.max(kept, ti.min(1, first[m + 1, b, lane] - first[m, b, lane]))
                        step(
                            b, m, nu, nv, npt, support, smoothing, iterations, frame_updates, tolerance, kept, added,
                            work, scheme, pressure, places,
                        )  # fmt: skip
                        for lane in range(LANES):
                            frame = first[m, b, lane]
                            while frame < first[m + 1, b, lane]:
                                record(b, nu, nv, npt, lane, theta[frame], frame, shapes, states)
                                frame += 1

    return Timed(advance_kernel, "motions with effects" if added else "motions")


def _stressed(added: tuple[AddedForce, ...]) -> bool:  # taichi knows no generators
    return any(force.stressed for force in added)


def _cloth_remembers(added: tuple[AddedForce, ...]) -> bool:
    return any(force.has_cloth_memory for force in added)


@ti.func
def step(
    b, m, nu, nv, npt, support, smoothing, iterations, frame_updates, tolerance, kept, added: ti.template(),
    work: ti.template(), scheme: ti.template(), pressure: ti.template(), places: ti.template(),
):  # fmt: skip
    """Step m of one block. kept: 1 where frames are kept of it, for which muscles are evaluated once more: a lane that
    has converged has moved since. So is memory, and nothing that has none. added: forces of effects."""
    begin(b, m, npt, added, scheme, pressure)
    if work[m, b] == FACTORISED:
        factorise(b, nu, nv)
        green(b, nu, nv, npt)
    predict(b, nu, nv)
    if ti.static(len(added) > 0):
        lead_to(b, m, (nu + 2) * (nv + 2), places)
        kept = 1
    i = 0
    last = iterations
    while i <= last + kept:
        if i <= last or ti.static(_cloth_remembers(added)) or (ti.static(_stressed(added)) and relaxes(b)):
            fabric_force(b, nu, nv, support, ti.static(_stressed(added)))
        else:
            velocities(b, nu, nv)
        if npt > 0:
            muscles(b, nu, npt, added)
        if i <= last:
            if npt > 0:
                muscles_pull(b, nu, npt)
            contact(b, nu)
        for force in ti.static(added):
            if ti.static(callable(force.cloth)):  # noqa: SIM102 decided when the kernel is compiled
                if i <= last or ti.static(force.has_cloth_memory):
                    force.cloth(b, nu, nv, npt)
        if ti.static(len(added) > 0):  # noqa: SIM102 decided when the kernel is compiled
            if i <= last:
                pull_ahead(b, nu, nv)
        if i == 0:
            first_residual(b, nu, nv)
        elif i <= last:
            step_length(b, nu, nv, support < EDGES)
        if i < last:
            if i < frame_updates:
                frames(b, nu, nv, smoothing)
                if npt > 0:
                    woodbury(b, nu, npt)
            if support < EDGES and i == 0:
                assemble(b, nu, nv, npt)
            if direction(b, nu, nv, npt, support < EDGES, i > 1, tolerance) == 0:
                last = i + 1
        i += 1
    finish(b, nu, nv)
    if ti.static(len(added) > 0):
        remember(b)


@ti.func
def begin(b, m, npt, added: ti.template(), scheme: ti.template(), pressure: ti.template()):
    """The lanes' schemes and their muscles' pressures in step m."""
    for lane in indices(LANES):
        for k in indices(scheme.shape[2]):
            F.scheme[b, k][lane] = scheme[m, b, k, lane]
        for k in indices(npt):
            acting = pressure[m, b, F.channel[b, k][lane], lane]
            F.point[b, X.pressure + k][lane] = F.point[b, X.pressure_share + k][lane] * acting
    for force in ti.static(added):
        if ti.static(force.stressed):
            age_stress(b)
        if ti.static(callable(force.pressure)):  # taichi knows no None
            for k in indices(npt):
                F.point[b, X.pressure + k] = force.pressure(b, k)


@ti.func
def coefficients(b):
    """Return the coefficients of the lanes' schemes, for all three components."""
    return (
        thrice(F.scheme[b, H]), thrice(F.scheme[b, AM]), thrice(F.scheme[b, AF]), thrice(F.scheme[b, GAMMA]),
        thrice(F.scheme[b, IA]), thrice(F.scheme[b, RY]), thrice(F.scheme[b, BA]),
    )  # fmt: skip


@ti.func
def predict(b, nu, nv):
    """Histories: v = cv (q - x0) + hv and a = ca (q - x0) + ha, and the first guess. Of q - x0, not of q: rounded
    coefficients of far larger terms would push the cloth. Where a lane did not converge, no acceleration is known."""
    h, am, af, ga, ia, ry, ba = coefficients(b)
    known = thrice(F.scheme[b, KNOWN] * (1.0 - F.reduce[b, UNCONVERGED])) * 0.5 * h * h
    P = (nu + 2) * (nv + 2)
    for k in indices(P):
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


@ti.func
def muscles(b, nu, npt, added: ti.template()):
    """Contraction and tension of the muscles at q, with what effects add to them."""
    sample(b, nu, npt, F.q, F.v, 2, X.pos)
    points_pos(b, npt)
    points_rate(b, npt)
    tension(b, npt, added)


@ti.func
def muscles_pull(b, nu, npt):
    """f += forces of the muscles as they are."""
    pull(b, npt, X.tension)
    spread(b, nu, npt, F.f)


@ti.func
def finish(b, nu, nv):
    """Go from the evaluation point to the end of the step; what a lane that has converged still lacks is carried
    over."""
    h, _, _, ga, ia, ry, ba = coefficients(b)
    carried = thrice(F.scheme[b, CARRIED] * (1.0 - F.reduce[b, UNCONVERGED]))
    P = (nu + 2) * (nv + 2)
    for k in indices(P):
        x0 = F.node3[b, F.x0 + k]
        v0 = F.node3[b, F.v0 + k]
        a0 = F.node3[b, F.a0 + k]
        free = thrice(F.node[b, F.free + k])
        d = ry * (F.node3[b, F.q + k] - x0) * free
        a1 = (ia * (d - h * v0) - ba * a0) * free
        F.node3[b, F.x0 + k] = x0 + d
        F.node3[b, F.v0 + k] = v0 + h * ((1 - ga) * a0 + ga * a1)
        F.node3[b, F.a0 + k] = a1
        F.node3[b, F.carried + k] = carried * F.node3[b, F.r + k]

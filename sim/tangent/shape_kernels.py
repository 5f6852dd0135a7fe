"""Kernels of the derivatives of a shape in balance: forces there, their explicit changes, the linear solves."""

import taichi as ti

from sim.forces.cloth import fabric_force
from sim.grid import EDGES
from sim.kernels.fields import LANES, SPREAD, WIDE, F, T, Timed, X, floats, indices
from sim.kernels.vectors import Lanes, Wide, thrice
from sim.solver.coarse_space import assemble
from sim.solver.flat_cloth import factorise
from sim.solver.frames import frames
from sim.solver.muscle_modes import green
from sim.solver.muscles import woodbury
from sim.step import muscles, muscles_pull
from sim.tangent.conjugate_gradients import conjugate_gradients
from sim.tangent.memory import REMEMBERED
from sim.time_steps import CA

ADDED = (REMEMBERED,)  # as it is held; shapes with other forces of effects take differences


@ti.func
def forces_held(b, nu, nv, npt, support, pressure: ti.template()):
    """F.f <- forces at F.q less inertia, at the velocity and acceleration held, under the channels' pressures."""
    for lane in indices(LANES):
        for k in indices(npt):
            acting = pressure[b, F.channel[b, k][lane], lane]
            F.point[b, X.pressure + k][lane] = F.point[b, X.pressure_share + k][lane] * acting
    fabric_force(b, nu, nv, support, False)
    if npt > 0:
        muscles(b, nu, npt, ADDED)
        muscles_pull(b, nu, npt)


@Timed
@ti.kernel
def begin(nb: ti.i32, nu: ti.i32, nv: ti.i32, stiffness: ti.f32):
    """The shape at x0 becomes the state, with the velocity v0 and the acceleration a0, without a residual of before.
    Springs of `stiffness` 1/s^2 times the mass hold it there. T is zeroed."""
    ti.loop_config(serialize=True)
    for b in range(nb):
        for k in indices(F.scheme.shape[1]):
            F.scheme[b, k] = Lanes(0.0)
        F.scheme[b, CA] = Lanes(stiffness)
        for k in indices((nu + 2) * (nv + 2)):
            F.node3[b, F.q + k] = F.node3[b, F.x0 + k]
            F.node3[b, F.hv + k] = F.node3[b, F.v0 + k]
            F.node3[b, F.ha + k] = F.node3[b, F.a0 + k]
            F.node3[b, F.vp + k] = -F.node3[b, F.v0 + k]  # what damping changes: all of the velocity
            F.node3[b, F.carried + k] = Wide(0.0)
        for k in indices(T.node.shape[1]):
            T.node[b, k] = Lanes(0.0)
        for k in indices(T.node3.shape[1]):
            T.node3[b, k] = Wide(0.0)


@Timed
@ti.kernel
def write_column(slot: ti.i32, forces: floats(3)):
    """T.columns at `slot` = forces (nb, nodes, WIDE)."""
    ti.loop_config(serialize=True)
    for b in range(forces.shape[0]):
        for k in indices(forces.shape[1]):
            for lane in indices(WIDE):
                T.columns[b, slot * F.nodes + k][lane] = forces[b, k, lane]


@Timed
@ti.kernel
def explicit(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, support: ti.i32, slot: ti.i32, weight: floats(2),
):  # fmt: skip
    """T.columns at `slot` += weight of the lane times the forces of the cloth: what moved constants change."""
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            b = task // SPREAD
            fabric_force(b, nu, nv, support, False)
            share = Lanes(0.0)
            for lane in range(LANES):
                share[lane] = weight[b, lane]
            o = slot * F.nodes
            for k in indices((nu + 2) * (nv + 2)):
                T.columns[b, o + k] = T.columns[b, o + k] + thrice(share) * F.node3[b, F.f + k]


@ti.kernel
def _viscous_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, support: ti.i32, slot: ti.i32, weight: floats(2),
    pressure: floats(3),
):  # fmt: skip
    """T.columns at `slot` += weight of the lane times what the velocity vp more changes in the forces."""
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            b = task // SPREAD
            share = Lanes(0.0)
            for lane in range(LANES):
                share[lane] = weight[b, lane]
            o = slot * F.nodes
            for turn in indices(2):
                add_velocity(b, nu, nv, 1.0 - 2.0 * turn)
                forces_held(b, nu, nv, npt, support, pressure)
                for k in indices((nu + 2) * (nv + 2)):
                    force = (1.0 - 2.0 * turn) * thrice(share) * F.node3[b, F.f + k]
                    T.columns[b, o + k] = T.columns[b, o + k] + force


@ti.func
def add_velocity(b, nu, nv, share):
    """The velocity that is held grows by a share of vp."""
    for k in indices((nu + 2) * (nv + 2)):
        F.node3[b, F.hv + k] = F.node3[b, F.hv + k] + share * F.node3[b, F.vp + k]


@ti.kernel
def _solve_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, support: ti.i32, smoothing: ti.i32,
    settles: ti.i32, turns: ti.i32, iterations: ti.i32, tolerance: ti.f32, stiffened: ti.f32,
    pressure: floats(3),
):  # fmt: skip
    """Linear solves with the tangent at F.q, `turns` one after another; what came of them to T.outcome.

    settles = 1: Newton steps of F.q to where the forces balance, before which the preconditioner is built, with
    `stiffened` 1/s^2 times the mass in it. settles = 0: T.columns, the right sides, become solutions.
    """
    for task in range(nb * SPREAD):
        if task % SPREAD == 0:
            b = task // SPREAD
            for turn in indices(turns):
                if settles == 1 or turn == 0:
                    forces_held(b, nu, nv, npt, support, pressure)
                if settles == 1 and turn == 0:
                    precondition(b, nu, nv, npt, support, smoothing, stiffened)
                o = turn * F.nodes
                for k in indices((nu + 2) * (nv + 2)):
                    right = F.node3[b, F.f + k]
                    if settles == 0:
                        right = T.columns[b, o + k]
                    F.node3[b, F.r + k] = right * thrice(F.node[b, F.free + k])
                    T.node3[b, T.x + k] = Wide(0.0)
                conjugate_gradients(b, nu, nv, npt, support, turn, iterations, tolerance)
                for k in indices((nu + 2) * (nv + 2)):
                    if settles == 1:
                        F.node3[b, F.q + k] = F.node3[b, F.q + k] + T.node3[b, T.x + k]
                    else:
                        T.columns[b, o + k] = T.node3[b, T.x + k]


@ti.func
def precondition(b, nu, nv, npt, support, smoothing, stiffened):
    """The preconditioner of the shape at hand."""
    springs = F.scheme[b, CA]
    F.scheme[b, CA] = springs + stiffened
    factorise(b, nu, nv)
    green(b, nu, nv, npt)
    frames(b, nu, nv, smoothing)
    if npt > 0:
        woodbury(b, nu, npt)
    if support < EDGES:
        assemble(b, nu, nv, npt)
    F.scheme[b, CA] = springs


solve_columns = Timed(_solve_kernel, "derivatives")
viscous = Timed(_viscous_kernel, "balance")

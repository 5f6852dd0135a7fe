"""Kernels of the derivatives of a shape at rest: forces there, their explicit changes, the linear solves."""

import functools

import taichi as ti

from sim.design.support import EDGES
from sim.forces.added import AddedForce
from sim.forces.cloth import fabric_force
from sim.kernels.fields import LANES, SPREAD, F, Timed, X
from sim.kernels.vectors import Lanes, Wide, thrice
from sim.solver.coarse_space import assemble
from sim.solver.flat_cloth import factorise
from sim.solver.frames import frames
from sim.solver.muscle_modes import green
from sim.solver.muscles import woodbury
from sim.step import muscles
from sim.tangent.fields import T
from sim.tangent.linear import conjugate_gradients
from sim.time.scheme import CA


@ti.func
def forces_at_rest(b, nu, nv, npt, support, pressure: ti.template(), added: ti.template()):
    """F.f <- forces at F.q without motion, under the channels' pressures."""
    lane = 0
    while lane < LANES:
        k = 0
        while k < npt:
            acting = pressure[b, F.channel[b, k][lane], lane]
            F.point[b, X.pressure + k][lane] = F.point[b, X.pressure_share + k][lane] * acting
            k = F.after[k]
        lane = F.after[lane]
    fabric_force(b, nu, nv, support)
    if npt > 0:
        muscles(b, nu, npt, added)


@ti.kernel
def _still_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32):
    """The shape that was found becomes the state, without motion or a residual of before; T is zeroed."""
    ti.loop_config(serialize=True)
    for b in range(nb):
        k = 0
        while k < F.scheme.shape[1]:
            F.scheme[b, k] = Lanes(0.0)
            k = F.after[k]
        k = 0
        while k < (nu + 2) * (nv + 2):
            F.node3[b, F.q + k] = F.node3[b, F.x0 + k]
            F.node3[b, F.hv + k] = Wide(0.0)
            F.node3[b, F.ha + k] = Wide(0.0)
            F.node3[b, F.carried + k] = Wide(0.0)
            k = F.after[k]
        k = 0
        while k < T.node.shape[1]:
            T.node[b, k] = Lanes(0.0)
            k = F.after[k]
        k = 0
        while k < T.node3.shape[1]:
            T.node3[b, k] = Wide(0.0)
            k = F.after[k]
        k = 0
        while k < T.columns.shape[1]:
            T.columns[b, k] = Wide(0.0)
            k = F.after[k]


@functools.cache
def settle_kernel(added: tuple[AddedForce, ...]) -> Timed:
    """Newton steps to where the forces balance, from a shape that moves no more; the preconditioner is built before
    them. T.found says what came of them, of the last one in the first slot."""

    @ti.kernel
    def kernel(
        nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, support: ti.i32, smoothing: ti.i32, steps: ti.i32,
        iterations: ti.i32, tolerance: ti.f32, stiffened: ti.f32,
        pressure: ti.types.ndarray(dtype=ti.f32, ndim=3),
    ):  # fmt: skip
        for task in range(nb * SPREAD):
            if task % SPREAD == 0:
                b = task // SPREAD
                forces_at_rest(b, nu, nv, npt, support, pressure, added)
                F.scheme[b, CA] = Lanes(stiffened)
                factorise(b, nu, nv)
                green(b, nu, nv, npt)
                frames(b, nu, nv, smoothing)
                if npt > 0:
                    woodbury(b, nu, npt)
                if support < EDGES:
                    assemble(b, nu, nv, npt)
                F.scheme[b, CA] = Lanes(0.0)
                for _ in range(steps):
                    k = 0
                    while k < (nu + 2) * (nv + 2):
                        F.node3[b, F.r + k] = F.node3[b, F.f + k] * thrice(F.node[b, F.free + k])
                        T.node3[b, T.x + k] = Wide(0.0)
                        k = F.after[k]
                    conjugate_gradients(b, nu, nv, npt, support, support < EDGES, 0, iterations, tolerance, False)
                    k = 0
                    while k < (nu + 2) * (nv + 2):
                        F.node3[b, F.q + k] = F.node3[b, F.q + k] + T.node3[b, T.x + k]
                        k = F.after[k]
                    forces_at_rest(b, nu, nv, npt, support, pressure, added)

    return Timed(kernel)


@functools.cache
def explicit_kernel(added: tuple[AddedForce, ...]) -> Timed:
    """T.columns at `slot` += weight of the lane times the forces there: what moved constants change."""

    @ti.kernel
    def kernel(
        nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, support: ti.i32, slot: ti.i32,
        pressure: ti.types.ndarray(dtype=ti.f32, ndim=3),
        weight: ti.types.ndarray(dtype=ti.f32, ndim=2),
    ):  # fmt: skip
        for task in range(nb * SPREAD):
            if task % SPREAD == 0:
                b = task // SPREAD
                forces_at_rest(b, nu, nv, npt, support, pressure, added)
                share = Lanes(0.0)
                for lane in range(LANES):
                    share[lane] = weight[b, lane]
                o = slot * F.nodes
                k = 0
                while k < (nu + 2) * (nv + 2):
                    T.columns[b, o + k] = T.columns[b, o + k] + thrice(share * F.node[b, F.free + k]) * F.node3[
                        b, F.f + k
                    ]
                    k = F.after[k]

    return Timed(kernel)


@functools.cache
def solve_kernel(added: tuple[AddedForce, ...]) -> Timed:
    """T.columns <- the shape's changes, for right sides that lie there."""

    @ti.kernel
    def kernel(
        nb: ti.i32, nu: ti.i32, nv: ti.i32, npt: ti.i32, support: ti.i32, slots: ti.i32,
        iterations: ti.i32, tolerance: ti.f32,
        pressure: ti.types.ndarray(dtype=ti.f32, ndim=3),
    ):  # fmt: skip
        for task in range(nb * SPREAD):
            if task % SPREAD == 0:
                b = task // SPREAD
                forces_at_rest(b, nu, nv, npt, support, pressure, added)
                slot = 0
                while slot < slots:
                    o = slot * F.nodes
                    k = 0
                    while k < (nu + 2) * (nv + 2):
                        F.node3[b, F.r + k] = T.columns[b, o + k]
                        T.node3[b, T.x + k] = Wide(0.0)
                        k = F.after[k]
                    conjugate_gradients(
                        b, nu, nv, npt, support, support < EDGES, slot, iterations, tolerance, False
                    )
                    k = 0
                    while k < (nu + 2) * (nv + 2):
                        T.columns[b, o + k] = T.node3[b, T.x + k]
                        k = F.after[k]
                    slot = F.after[slot]

    return Timed(kernel)


@ti.kernel
def _read_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, slots: ti.i32, out: ti.types.ndarray(dtype=ti.f32, ndim=5),
                 found: ti.types.ndarray(dtype=ti.i32, ndim=3)):  # fmt: skip
    """out (nb, slots, LANES, nu nv, 3): columns; found (nb, slots, LANES)."""
    for b in range(nb):
        for slot in range(slots):
            for lane in range(LANES):
                found[b, slot, lane] = T.found[b, slot][lane]
                for j in range(nv):
                    i = 0
                    while i < nu:
                        for c in range(3):
                            out[b, slot, lane, j * nu + i, c] = T.columns[
                                b, slot * F.nodes + (j + 1) * (nu + 2) + i + 1
                            ][c * LANES + lane]
                        i = F.after[i]


still, read_columns = Timed(_still_kernel), Timed(_read_kernel)

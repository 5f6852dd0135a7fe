"""The flat cloth and its muscles in the coarse space's modes (sim/solver/coarse_space.py)."""

import taichi as ti

from sim.forces.bending import bending_down
from sim.forces.cloth import inertia
from sim.forces.membrane import membrane
from sim.kernels.fields import C, F, X
from sim.kernels.vectors import Lanes
from sim.materials import M
from sim.solver.coarse_solve import add_rows
from sim.solver.muscle_modes import MEAN, MOMENT, SLOPE, TANGENTIAL, at
from sim.state import COARSE, COARSE_ACROSS, COARSE_DOWN


@ti.func
def flat(b):
    """E_P <- W^T K0 W without its normal stiffness of a bent cloth."""
    i = 0
    while i < COARSE:
        k = i - i % 4  # rows go four at a time: what lies left of their blocks on the diagonal is never read
        while k < COARSE:
            F.coarse[b, C.alone + i * COARSE + k] = Lanes(0.0)
            k = F.after[k]
        i = F.after[i]
    hu = F.lane[b, M.HU]
    hv = F.lane[b, M.HV]
    ihv = F.lane[b, M.IHV]
    mass = inertia(b)
    k1, k2, sh = membrane(b)
    bend, clamp = bending_down(b)
    k = 0
    while k < COARSE_ACROSS:
        eigen = F.eigen[C.place[k]]
        ihu = F.lane[b, M.IHU]
        lam = eigen[0] * ihu
        m = 0
        while m < COARSE_DOWN:
            mu = C.shared[C.stiffness + m]
            i = k * COARSE_DOWN + m
            u = C.alone + i * (COARSE + 1)
            v = u + COARSE_ACROSS * COARSE_DOWN * (COARSE + 1)
            F.coarse[b, u] = mass + hv * k1 * lam + hu * ihv * sh * mu
            F.coarse[b, v] = mass + hv * sh * lam + hu * ihv * k2 * mu
            w = v + COARSE_ACROSS * COARSE_DOWN * (COARSE + 1) - m
            F.coarse[b, w + m] = (
                mass
                + F.lane[b, M.D1] * hv * eigen[1] * ihu * ihu * ihu
                + (hu * F.lane[b, M.WEIGHT_TENSION] + 2.0 * (F.lane[b, M.D12] + F.lane[b, M.T]) * eigen[2] * ihu)
                * ihv
                * mu
            )
            o = m
            while o < COARSE_DOWN:
                pair = m * COARSE_DOWN + o
                F.coarse[b, w + o] = (
                    F.coarse[b, w + o] + bend * C.shared[C.bending + pair] + clamp * C.shared[C.clamp + pair]
                )
                o = F.after[o]
            m = F.after[m]
        k = F.after[k]


@ti.func
def pull(b, npt):
    """E_P += a a^T / compliance of all intervals, with a = W^T J^T; four at a time."""
    s = 0
    while s < npt - 1:
        for r in range(4):
            stretch(b, npt, s + r, C.pull + r * COARSE)
        i = 0
        while i < COARSE:
            k = 0
            while k < 16:
                F.coarse[b, C.ratio + k] = F.coarse[b, C.pull + k % 4 * COARSE + i + k // 4]
                k = F.after[k]
            add_rows(b, C.alone, C.pull, i)
            i += 4
        s += 4


@ti.func
def stretch(b, npt, s, dst):
    """Return how the modes stretch an interval, times the root of its stiffness; nothing behind the last one."""
    k = 0
    while k < COARSE:
        F.coarse[b, dst + k] = Lanes(0.0)
        k = F.after[k]
    if s < npt - 1:
        n = COARSE_ACROSS * COARSE_DOWN
        stiff = ti.sqrt(ti.max(0.0, 1.0 / F.point[b, X.compliance + s]))
        for e in range(2):
            q = X.coef + e * 7 * F.points + s
            k = 0
            while k < COARSE_ACROSS:
                mean = stiff * F.across[b, at(s + e, MEAN) + C.place[k]]
                tangential = stiff * F.across[b, at(s + e, TANGENTIAL) + C.place[k]]
                normal = F.point[b, q + 2 * F.points] * mean + stiff * (
                    F.point[b, q + 3 * F.points] * F.across[b, at(s + e, MOMENT) + C.place[k]]
                    + F.point[b, q + 5 * F.points] * F.across[b, at(s + e, SLOPE) + C.place[k]]
                )
                u = F.point[b, q] * tangential
                v = F.point[b, q + F.points] * tangential
                w_moment = F.point[b, q + 4 * F.points] * mean
                w_slope = F.point[b, q + 6 * F.points] * mean
                m = 0
                while m < COARSE_DOWN:
                    o = dst + k * COARSE_DOWN + m
                    d = (s + e) * 3 * COARSE_DOWN + m
                    along = F.coarse_down[b, d + MEAN * COARSE_DOWN]
                    F.coarse[b, o] = F.coarse[b, o] + u * along
                    F.coarse[b, o + n] = F.coarse[b, o + n] + v * along
                    F.coarse[b, o + 2 * n] = F.coarse[b, o + 2 * n] + (
                        normal * along
                        + w_moment * F.coarse_down[b, d + MOMENT * COARSE_DOWN]
                        + w_slope * F.coarse_down[b, d + SLOPE * COARSE_DOWN]
                    )
                    m = F.after[m]
                k = F.after[k]

"""A coarse space for the preconditioner: the softest modes, in which a bent sheet couples normal and tangential motion.

The flat cloth's own problem (sim/solver/flat_cloth.py) knows curvature only as a constant normal stiffness: modes that
bend without stretching seem up to a thousand times too stiff there. In the span W of COARSE_ACROSS x COARSE_DOWN
products of modes, three components each in the preconditioner's frames, strains u' + kappa w of the shape at hand count
instead: y += W (E^-1 - E_P^-1) W^T r, with E the Galerkin matrix of the coupled problem and E_P = W^T P W (an additive
two-level preconditioner; Nicolaides 1987, SIAM J. Numer. Anal. 24). Both must be of the same shape as P, else P^-1 may
be indefinite. Nodes held one by one, which W does not know, do without. Curvatures are sampled at COARSE_SAMPLES^2
nodes.
"""

import taichi as ti

from sim.forces.bending import bending_down
from sim.forces.cloth import inertia
from sim.forces.membrane import membrane, normal_stiffness
from sim.kernels.fields import C, F, X, indices
from sim.kernels.vectors import Lanes, difference, dot
from sim.materials import M
from sim.solver.coarse_solve import add_rows, factorise
from sim.solver.frames import axes
from sim.solver.muscle_modes import MEAN, MOMENT, SLOPE, TANGENTIAL, at
from sim.state import COARSE, COARSE_ACROSS, COARSE_DOWN, COARSE_SAMPLES


@ti.func
def bent(b, nu, nv):
    """E += what strains u' + kappa w, and shear, have beyond those of the flat cloth's components apart."""
    sample(b, nu, nv)
    for q in indices(8):
        src = C.sample + q * COARSE_SAMPLES * COARSE_SAMPLES
        code = COARSE_ACROSS + COARSE_SAMPLES + 4 * q
        for k in indices(COARSE_ACROSS * COARSE_ACROSS):
            a = C.across + (C.place[code + 2] * COARSE_ACROSS * COARSE_ACROSS + k) * COARSE_SAMPLES
            for t in indices(COARSE_SAMPLES):
                F.coarse[b, C.line + k * COARSE_SAMPLES + t] = weighed(b, a, src + t * COARSE_SAMPLES)
        for k in indices(COARSE_ACROSS * COARSE_ACROSS):
            line = C.line + k * COARSE_SAMPLES
            i0 = (C.place[code] * COARSE_ACROSS + k // COARSE_ACROSS) * COARSE_DOWN
            j0 = (C.place[code + 1] * COARSE_ACROSS + k % COARSE_ACROSS) * COARSE_DOWN
            for m in indices(COARSE_DOWN * COARSE_DOWN):
                i = i0 + m // COARSE_DOWN
                j = j0 + m % COARSE_DOWN
                if i <= j:
                    a = C.down + (C.place[code + 3] * COARSE_DOWN * COARSE_DOWN + m) * COARSE_SAMPLES
                    o = C.coupled + i * COARSE + j
                    F.coarse[b, o] = F.coarse[b, o] + weighed(b, a, line)


@ti.func
def weighed(b, a, x):
    """Sum over samples of C.shared from a on times F.coarse from x on; two by two: a sum waits for the last."""
    first, second = Lanes(0.0), Lanes(0.0)
    for i in ti.static(range(COARSE_SAMPLES // 2)):
        first += C.shared[a + 2 * i] * F.coarse[b, x + 2 * i]
        second += C.shared[a + 2 * i + 1] * F.coarse[b, x + 2 * i + 1]
    return first + second


@ti.func
def sample(b, nu, nv):
    """Curvatures of the frames at the sampled nodes, times stiffness and area."""
    size = COARSE_SAMPLES * COARSE_SAMPLES
    ihu = F.lane[b, M.IHU]
    ihv = F.lane[b, M.IHV]
    area = F.lane[b, M.HU] * F.lane[b, M.HV] * ((nu - 1) * (nv - 1) * 1.0 / size)
    k1, k2, sh = membrane(b)
    k1, k2, sh = area * k1, area * k2, area * sh
    half_width = ti.max(1, (nu - 1) // (2 * COARSE_SAMPLES))
    for t in indices(COARSE_SAMPLES):
        j = C.place[COARSE_ACROSS + t]
        for s in indices(COARSE_SAMPLES):
            i = C.place[COARSE_ACROSS + s]
            k = (j + 1) * (nu + 2) + i + 1
            west = ti.min(half_width, i)
            east = ti.min(half_width, nu - 1 - i)
            north = ti.min(half_width, j)
            south = ti.min(half_width, nv - 1 - j)
            ux, uy, uz, vx, vy, vz, _, _, _ = axes(b, k)
            ax, ay, az = difference(b, F.fn + k - west, F.fn + k + east)
            bx, by, bz = difference(b, F.fn + k - north * (nu + 2), F.fn + k + south * (nu + 2))
            along_u = ihu / (west + east)
            along_v = ihv / (north + south)
            one = along_u * dot(ax, ay, az, ux, uy, uz)
            two = along_v * dot(bx, by, bz, vx, vy, vz)
            both = along_u * dot(ax, ay, az, vx, vy, vz) + along_v * dot(bx, by, bz, ux, uy, uz)
            o = C.sample + t * COARSE_SAMPLES + s
            F.coarse[b, o] = k1 * one * ihu
            F.coarse[b, o + size] = sh * both * ihv
            F.coarse[b, o + 2 * size] = k2 * two * ihv
            F.coarse[b, o + 3 * size] = sh * both * ihu
            F.coarse[b, o + 4 * size] = k1 * one * one
            F.coarse[b, o + 5 * size] = k2 * two * two
            F.coarse[b, o + 6 * size] = sh * both * both
            F.coarse[b, o + 7 * size] = sh * ihu * ihv


@ti.func
def flat(b):
    """E_P <- W^T K0 W without its normal stiffness of a bent cloth."""
    for i in indices(COARSE):
        for k in indices(
            i - i % 4, COARSE
        ):  # rows go four at a time: what lies left of their blocks on the diagonal is never read
            F.coarse[b, C.alone + i * COARSE + k] = Lanes(0.0)
    hu = F.lane[b, M.HU]
    hv = F.lane[b, M.HV]
    ihv = F.lane[b, M.IHV]
    mass = inertia(b)
    k1, k2, sh = membrane(b)
    bend, clamp = bending_down(b)
    for k in indices(COARSE_ACROSS):
        eigen = F.eigen[C.place[k]]
        ihu = F.lane[b, M.IHU]
        lam = eigen[0] * ihu
        for m in indices(COARSE_DOWN):
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
            for o in indices(m, COARSE_DOWN):
                pair = m * COARSE_DOWN + o
                F.coarse[b, w + o] = (
                    F.coarse[b, w + o] + bend * C.shared[C.bending + pair] + clamp * C.shared[C.clamp + pair]
                )


@ti.func
def pull(b, npt):
    """E_P += a a^T / compliance of all intervals, with a = W^T J^T; four at a time."""
    s = 0
    while s < npt - 1:
        for r in range(4):
            stretch(b, npt, s + r, C.pull + r * COARSE)
        i = 0
        while i < COARSE:
            for k in indices(16):
                F.coarse[b, C.ratio + k] = F.coarse[b, C.pull + k % 4 * COARSE + i + k // 4]
            add_rows(b, C.alone, C.pull, i)
            i += 4
        s += 4


@ti.func
def stretch(b, npt, s, dst):
    """Return how the modes stretch an interval, times the root of its stiffness; nothing behind the last one."""
    for k in indices(COARSE):
        F.coarse[b, dst + k] = Lanes(0.0)
    if s < npt - 1:
        n = COARSE_ACROSS * COARSE_DOWN
        stiff = ti.sqrt(ti.max(0.0, 1.0 / F.point[b, X.compliance + s]))
        for e in range(2):
            q = X.coef + e * 7 * F.points + s
            for k in indices(COARSE_ACROSS):
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
                for m in indices(COARSE_DOWN):
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


# of the flat cloth's normal stiffness (CURVATURE) in E: with none, more cloths that snap run away; with much, a flat
# cloth seems at rest when it is not
KEPT = 0.05


@ti.func
def assemble(b, nu, nv, npt):
    """E and E_P of the shape at hand, factored."""
    flat(b)
    if npt > 0:
        pull(b, npt)
    copy(b)
    bent(b, nu, nv)
    for which in range(2):
        factorise(b, C.coupled + which * COARSE * COARSE)


@ti.func
def copy(b):
    """E <- E_P, and E_P gets its normal stiffness."""
    for i in indices(COARSE):
        for k in indices(i * COARSE + i - i % 4, (i + 1) * COARSE):
            F.coarse[b, C.coupled + k] = F.coarse[b, C.alone + k]
    hoop = normal_stiffness(b)
    for k in indices(2 * COARSE_ACROSS * COARSE_DOWN, COARSE):
        o = C.alone + k * (COARSE + 1)
        F.coarse[b, o] = F.coarse[b, o] + hoop
        F.coarse[b, o - C.alone + C.coupled] = F.coarse[b, o - C.alone + C.coupled] + KEPT * hoop

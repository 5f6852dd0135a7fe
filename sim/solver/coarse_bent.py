"""The strains of a bent cloth in the coarse space's modes (sim/solver/coarse_space.py)."""

import taichi as ti

from sim.forces.membrane import membrane
from sim.kernels.fields import C, F
from sim.kernels.vectors import Lanes, difference, dot
from sim.materials import M
from sim.solver.frames import axes
from sim.state import COARSE, COARSE_ACROSS, COARSE_DOWN, COARSE_SAMPLES


@ti.func
def bent(b, nu, nv):
    """E += what strains u' + kappa w, and shear, have beyond those of the flat cloth's components apart."""
    sample(b, nu, nv)
    q = 0
    while q < 8:
        src = C.sample + q * COARSE_SAMPLES * COARSE_SAMPLES
        code = COARSE_ACROSS + COARSE_SAMPLES + 4 * q
        k = 0
        while k < COARSE_ACROSS * COARSE_ACROSS:
            a = C.across + (C.place[code + 2] * COARSE_ACROSS * COARSE_ACROSS + k) * COARSE_SAMPLES
            t = 0
            while t < COARSE_SAMPLES:
                F.coarse[b, C.line + k * COARSE_SAMPLES + t] = weighed(b, a, src + t * COARSE_SAMPLES)
                t = F.after[t]
            k = F.after[k]
        k = 0
        while k < COARSE_ACROSS * COARSE_ACROSS:
            line = C.line + k * COARSE_SAMPLES
            i0 = (C.place[code] * COARSE_ACROSS + k // COARSE_ACROSS) * COARSE_DOWN
            j0 = (C.place[code + 1] * COARSE_ACROSS + k % COARSE_ACROSS) * COARSE_DOWN
            m = 0
            while m < COARSE_DOWN * COARSE_DOWN:
                i = i0 + m // COARSE_DOWN
                j = j0 + m % COARSE_DOWN
                if i <= j:
                    a = C.down + (C.place[code + 3] * COARSE_DOWN * COARSE_DOWN + m) * COARSE_SAMPLES
                    o = C.coupled + i * COARSE + j
                    F.coarse[b, o] = F.coarse[b, o] + weighed(b, a, line)
                m = F.after[m]
            k = F.after[k]
        q = F.after[q]


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
    t = 0
    while t < COARSE_SAMPLES:
        j = C.place[COARSE_ACROSS + t]
        s = 0
        while s < COARSE_SAMPLES:
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
            s = F.after[s]
        t = F.after[t]

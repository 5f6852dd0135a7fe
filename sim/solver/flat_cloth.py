"""The flat cloth's own linear problem, solved exactly: eigenvectors across, banded factors along v."""

import taichi as ti

from sim.forces.bending import bending_down
from sim.forces.cloth import inertia
from sim.forces.membrane import membrane, normal_stiffness
from sim.kernels.fields import F, indices
from sim.kernels.vectors import Lanes, Wide, thrice
from sim.materials import M


@ti.func
def factorise(b, nu, nv):
    """LDL^T in v of every mode across, for the three components (u, v, normal) at once: planes of F.bands3 hold l of
    the row before, l of the one before that (zero but for the normal component), and 1 / d."""
    N = nu * nv
    hu = F.lane[b, M.HU]
    ihu = F.lane[b, M.IHU]
    ihv = F.lane[b, M.IHV]
    k1, k2, sh = membrane(b)
    mass = inertia(b)
    hoop = normal_stiffness(b)
    bend, clamp = bending_down(b)
    free_top = 1.0 - F.lane[b, M.TOP_HELD]
    for j in range(nv):
        wj = ti.f32(1.0)
        kj = ti.f32(2.0)
        bj = ti.f32(6.0)
        b1 = ti.f32(-4.0)
        if j == 0 or j == nv - 1:
            wj = ti.f32(0.5)
            kj = ti.f32(1.0)
            bj = ti.f32(1.0)
        if j == 1 or j == nv - 2:
            bj = ti.f32(5.0)
        if j == 1 or j == nv - 1:
            b1 = ti.f32(-2.0)
        fm = Lanes(1.0)
        fm2 = Lanes(1.0)
        diagonal = Lanes(0.0)
        extra = Lanes(0.0)
        if j == 0:
            diagonal = F.lane[b, M.TOP_HELD]
        if j == nv - 1:
            diagonal = F.lane[b, M.BOTTOM_HELD]
            fm = 1.0 - diagonal
            fm2 = fm
        if j == 1:
            fm = free_top
            extra = clamp
        if j == 2:
            fm2 = free_top
        for k in indices(nu):
            lam = F.eigen[k][0] * ihu
            o = j * nu + k
            twist = hu * F.lane[b, M.WEIGHT_TENSION] + 2.0 * (F.lane[b, M.D12] + F.lane[b, M.T]) * F.eigen[k][2] * ihu
            a = Wide(
                (mass + k1 * F.lane[b, M.HV] * lam) * wj + hu * sh * kj * ihv,
                (mass + sh * F.lane[b, M.HV] * lam) * wj + hu * k2 * kj * ihv,
                (mass + hoop + F.lane[b, M.D1] * F.lane[b, M.HV] * F.eigen[k][1] * ihu * ihu * ihu) * wj
                + twist * kj * ihv
                + bend * bj
                + extra,
            )
            e1 = thrice(fm) * Wide(-hu * sh * ihv, -hu * k2 * ihv, b1 * bend - twist * ihv)
            e2 = Wide(Lanes(0.0), Lanes(0.0), fm2 * bend)
            d = thrice(1.0 - diagonal) * a + thrice(diagonal)
            l1 = Wide(0.0)
            l2 = Wide(0.0)
            if j > 1:
                before = F.bands3[b, 2 * N + o - 2 * nu]
                l2 = e2 * before
                e1 -= l2 * F.bands3[b, o - nu] / before
                d -= l2 * e2
            if j > 0:
                l1 = e1 * F.bands3[b, 2 * N + o - nu]
                d -= l1 * e1
            F.bands3[b, o] = l1
            F.bands3[b, N + o] = l2
            F.bands3[b, 2 * N + o] = 1.0 / d


@ti.func
def butterfly(b, nu, row):
    """Entries i and nu - 1 - i of a row of F.modal3 become their sum and difference if the basis has odd vectors."""
    for w in indices(F.odd[None]):
        x = F.modal3[b, row + w]
        y = F.modal3[b, row + nu - 1 - w]
        F.modal3[b, row + w] = x + y
        F.modal3[b, row + nu - 1 - w] = x - y


@ti.func
def transform(b, nu, nv, src, dst, inverse):
    """Rows of F.modal3 at src times the basis across (its transpose where inverse = 1), to dst; even and odd vectors
    apart. Spends src."""
    for j in range(nv):
        row = src + j * nu
        if inverse == 0:
            butterfly(b, nu, row)
        even = nu - F.odd[None]
        C = inverse * (quads(even) * even + quads(F.odd[None]) * F.odd[None])
        first = 0
        count = even
        for _ in range(2):
            multiply_row(b, row + first, dst + j * nu + first, C, count)
            C += quads(count) * count
            first += count
            count = F.odd[None]
        if inverse == 1:
            butterfly(b, nu, dst + j * nu)


@ti.func
def quads(count):
    return (count + 3) // 4


@ti.func
def entry(tangential, normal):
    return Wide(Lanes(tangential), Lanes(tangential), Lanes(normal))


@ti.func
def multiply_row(b, x, y, C, count):
    """`count` entries of F.modal3 at y = those at x times a count x count matrix, whose rows lie in F.basis at C by
    four for both bases, zeros below; up to three entries behind x are read for them."""
    for k in indices(count):
        F.modal3[b, y + k] = Wide(0.0)
    for quad in range(quads(count)):
        a0 = F.modal3[b, x + 4 * quad]
        a1 = F.modal3[b, x + 4 * quad + 1]
        a2 = F.modal3[b, x + 4 * quad + 2]
        a3 = F.modal3[b, x + 4 * quad + 3]
        for k in indices(count):
            m = F.basis[C + quad * count + k]
            F.modal3[b, y + k] = F.modal3[b, y + k] + (
                (entry(m[0], m[4]) * a0 + entry(m[1], m[5]) * a1) + (entry(m[2], m[6]) * a2 + entry(m[3], m[7]) * a3)
            )


@ti.func
def solve_modes(b, nu, nv):
    """The banded systems along v of all modes across, whose right sides lie in the second plane of F.modal3; nothing
    acts on a held edge."""
    N = nu * nv
    for k in indices(nu):
        F.modal3[b, N + k] = F.modal3[b, N + k] * thrice(1.0 - F.lane[b, M.TOP_HELD])
        F.modal3[b, 2 * N - nu + k] = F.modal3[b, 2 * N - nu + k] * thrice(1.0 - F.lane[b, M.BOTTOM_HELD])
    for j in range(1, nv):
        two = nu if j > 1 else 0  # in the second row the factor of the row before the last is zero
        for o in indices(j * nu, (j + 1) * nu):
            F.modal3[b, N + o] = F.modal3[b, N + o] - (
                F.bands3[b, o] * F.modal3[b, N + o - nu] + F.bands3[b, N + o] * F.modal3[b, N + o - nu - two]
            )
    for back in range(nv):
        j = nv - 1 - back
        one = nu if back > 0 else 0
        two = nu if back > 1 else 0
        for o in indices(j * nu, (j + 1) * nu):
            z = F.modal3[b, N + o] * F.bands3[b, 2 * N + o]
            if back > 0:
                z -= F.bands3[b, o + nu] * F.modal3[b, N + o + one]
            if back > 1:
                z -= F.bands3[b, N + o + 2 * nu] * F.modal3[b, N + o + one + two]
            F.modal3[b, N + o] = z

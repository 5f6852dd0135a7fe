"""The coarse space (sim/solver/coarse_space.py) in the global solve: restriction, two dense solves, prolongation."""

import taichi as ti

from sim.kernels.fields import C, F, indices
from sim.kernels.vectors import Wide, parts
from sim.state import COARSE, COARSE_ACROSS, COARSE_DOWN


@ti.func
def factorise(b, matrix):
    """U^T D^-1 U in place, four rows at a time: a row of the upper triangle keeps U, its diagonal 1 / d."""
    k = 0
    while k < COARSE:
        first = matrix + k * COARSE
        for p in range(4):
            row = first + p * COARSE
            for r in range(p):
                above = first + r * COARSE
                ratio = F.coarse[b, above + k + p] * F.coarse[b, above + k + r]
                for j in indices(k + p, COARSE):
                    F.coarse[b, row + j] = F.coarse[b, row + j] - ratio * F.coarse[b, above + j]
            F.coarse[b, row + k + p] = 1.0 / F.coarse[b, row + k + p]
        i = k + 4
        while i < COARSE:
            for r in indices(16):
                row = first + r % 4 * COARSE
                F.coarse[b, C.ratio + r] = -F.coarse[b, row + i + r // 4] * F.coarse[b, row + k + r % 4]
            add_rows(b, matrix, first, i)
            i += 4
        k += 4


@ti.func
def add_rows(b, matrix, src, i):
    """Four rows of a matrix from row i on, right of its diagonal, += 4 x 4 ratios at C.ratio times the rows at src."""
    for j in indices(i, COARSE):
        x0 = F.coarse[b, src + j]
        x1 = F.coarse[b, src + COARSE + j]
        x2 = F.coarse[b, src + 2 * COARSE + j]
        x3 = F.coarse[b, src + 3 * COARSE + j]
        for r in ti.static(range(4)):
            o = matrix + (i + r) * COARSE + j
            a = C.ratio + 4 * r
            F.coarse[b, o] = F.coarse[b, o] + (
                (F.coarse[b, a] * x0 + F.coarse[b, a + 1] * x1) + (F.coarse[b, a + 2] * x2 + F.coarse[b, a + 3] * x3)
            )


@ti.func
def back_substitute(b, matrix, x):
    """x <- (U^T D^-1 U)^-1 x"""
    k = 0
    while k < COARSE:
        first = matrix + k * COARSE
        for p in range(4):
            for r in range(p):
                above = first + r * COARSE + k
                F.coarse[b, x + k + p] = F.coarse[b, x + k + p] - F.coarse[b, above + p] * (
                    F.coarse[b, above + r] * F.coarse[b, x + k + r]
                )
        t0 = F.coarse[b, first + k] * F.coarse[b, x + k]
        t1 = F.coarse[b, first + COARSE + k + 1] * F.coarse[b, x + k + 1]
        t2 = F.coarse[b, first + 2 * COARSE + k + 2] * F.coarse[b, x + k + 2]
        t3 = F.coarse[b, first + 3 * COARSE + k + 3] * F.coarse[b, x + k + 3]
        for j in indices(k + 4, COARSE):
            a = first + j
            F.coarse[b, x + j] = F.coarse[b, x + j] - (
                (t0 * F.coarse[b, a] + t1 * F.coarse[b, a + COARSE])
                + (t2 * F.coarse[b, a + 2 * COARSE] + t3 * F.coarse[b, a + 3 * COARSE])
            )
        k += 4
    while k > 0:
        k -= 4
        first = matrix + k * COARSE
        for j in indices(k + 4, COARSE):
            a = first + j
            for p in ti.static(range(4)):
                F.coarse[b, x + k + p] = F.coarse[b, x + k + p] - F.coarse[b, a + p * COARSE] * F.coarse[b, x + j]
        for back in range(4):
            p = 3 - back
            row = first + p * COARSE + k
            for r in range(p + 1, 4):
                F.coarse[b, x + k + p] = F.coarse[b, x + k + p] - F.coarse[b, row + r] * F.coarse[b, x + k + r]
            F.coarse[b, x + k + p] = F.coarse[b, x + k + p] * F.coarse[b, row + p]


@ti.func
def restrict(b, nu, nv):
    """C.right <- W^T r, twice, of the second plane of F.modal3; and both solved."""
    for k in indices(COARSE_ACROSS):
        begin = k * COARSE_DOWN
        for m in indices(COARSE_DOWN):
            F.patch3[b, begin + m] = Wide(0.0)
        for quad in range((nv + 3) // 4):
            o = nu * nv + 4 * quad * nu + C.place[k]
            e0 = F.modal3[b, o]
            e1 = F.modal3[b, o + nu]
            e2 = F.modal3[b, o + 2 * nu]
            e3 = F.modal3[b, o + 3 * nu]
            w = C.rows + 4 * quad * COARSE_DOWN
            for m in indices(COARSE_DOWN):
                F.patch3[b, begin + m] = F.patch3[b, begin + m] + (
                    (C.shared[w + m] * e0 + C.shared[w + COARSE_DOWN + m] * e1)
                    + (C.shared[w + 2 * COARSE_DOWN + m] * e2 + C.shared[w + 3 * COARSE_DOWN + m] * e3)
                )
    n = COARSE_ACROSS * COARSE_DOWN
    for k in indices(n):
        e = F.patch3[b, k]
        u, v, w = parts(e)
        right = C.right
        while right < C.right + 2 * COARSE:
            F.coarse[b, right + k] = u
            F.coarse[b, right + n + k] = v
            F.coarse[b, right + 2 * n + k] = w
            right += COARSE
    for side in range(2):
        back_substitute(b, C.coupled + side * COARSE * COARSE, C.right + side * COARSE)


@ti.func
def prolong(b, nu, nv):
    """The second plane of F.modal3 += W (E^-1 - E_P^-1) W^T r."""
    n = COARSE_ACROSS * COARSE_DOWN
    for k in indices(n):
        o = C.right + k
        F.patch3[b, k] = Wide(
            F.coarse[b, o] - F.coarse[b, o + COARSE],
            F.coarse[b, o + n] - F.coarse[b, o + n + COARSE],
            F.coarse[b, o + 2 * n] - F.coarse[b, o + 2 * n + COARSE],
        )
    for k in indices(COARSE_ACROSS):
        for j in indices(nv):
            o = nu * nv + j * nu + C.place[k]
            w = C.rows + j * COARSE_DOWN
            total = F.modal3[b, o]
            for m in ti.static(range(COARSE_DOWN)):
                total += C.shared[w + m] * F.patch3[b, k * COARSE_DOWN + m]
            F.modal3[b, o] = total

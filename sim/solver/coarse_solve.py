"""The coarse space (sim/solver/coarse_space.py) in the global solve: restriction, two dense solves, prolongation."""

import taichi as ti

from sim.kernels.fields import C, F
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
                j = k + p
                while j < COARSE:
                    F.coarse[b, row + j] = F.coarse[b, row + j] - ratio * F.coarse[b, above + j]
                    j = F.after[j]
            F.coarse[b, row + k + p] = 1.0 / F.coarse[b, row + k + p]
        i = k + 4
        while i < COARSE:
            r = 0
            while r < 16:
                row = first + r % 4 * COARSE
                F.coarse[b, C.ratio + r] = -F.coarse[b, row + i + r // 4] * F.coarse[b, row + k + r % 4]
                r = F.after[r]
            add_rows(b, matrix, first, i)
            i += 4
        k += 4


@ti.func
def add_rows(b, matrix, src, i):
    """Four rows of a matrix from row i on, right of its diagonal, += 4 x 4 ratios at C.ratio times the rows at src."""
    j = i
    while j < COARSE:
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
        j = F.after[j]


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
        j = k + 4
        while j < COARSE:
            a = first + j
            F.coarse[b, x + j] = F.coarse[b, x + j] - (
                (t0 * F.coarse[b, a] + t1 * F.coarse[b, a + COARSE])
                + (t2 * F.coarse[b, a + 2 * COARSE] + t3 * F.coarse[b, a + 3 * COARSE])
            )
            j = F.after[j]
        k += 4
    while k > 0:
        k -= 4
        first = matrix + k * COARSE
        j = k + 4
        while j < COARSE:
            a = first + j
            for p in ti.static(range(4)):
                F.coarse[b, x + k + p] = F.coarse[b, x + k + p] - F.coarse[b, a + p * COARSE] * F.coarse[b, x + j]
            j = F.after[j]
        for back in range(4):
            p = 3 - back
            row = first + p * COARSE + k
            for r in range(p + 1, 4):
                F.coarse[b, x + k + p] = F.coarse[b, x + k + p] - F.coarse[b, row + r] * F.coarse[b, x + k + r]
            F.coarse[b, x + k + p] = F.coarse[b, x + k + p] * F.coarse[b, row + p]


@ti.func
def restrict(b, nu, nv):
    """C.right <- W^T r, twice, of the second plane of F.modal3; and both solved."""
    k = 0
    while k < COARSE_ACROSS:
        begin = k * COARSE_DOWN
        m = 0
        while m < COARSE_DOWN:
            F.patch3[b, begin + m] = Wide(0.0)
            m = F.after[m]
        for quad in range((nv + 3) // 4):
            o = nu * nv + 4 * quad * nu + C.place[k]
            e0 = F.modal3[b, o]
            e1 = F.modal3[b, o + nu]
            e2 = F.modal3[b, o + 2 * nu]
            e3 = F.modal3[b, o + 3 * nu]
            w = C.rows + 4 * quad * COARSE_DOWN
            m = 0
            while m < COARSE_DOWN:
                F.patch3[b, begin + m] = F.patch3[b, begin + m] + (
                    (C.shared[w + m] * e0 + C.shared[w + COARSE_DOWN + m] * e1)
                    + (C.shared[w + 2 * COARSE_DOWN + m] * e2 + C.shared[w + 3 * COARSE_DOWN + m] * e3)
                )
                m = F.after[m]
        k = F.after[k]
    n = COARSE_ACROSS * COARSE_DOWN
    k = 0
    while k < n:
        e = F.patch3[b, k]
        u, v, w = parts(e)
        right = C.right
        while right < C.right + 2 * COARSE:
            F.coarse[b, right + k] = u
            F.coarse[b, right + n + k] = v
            F.coarse[b, right + 2 * n + k] = w
            right += COARSE
        k = F.after[k]
    for side in range(2):
        back_substitute(b, C.coupled + side * COARSE * COARSE, C.right + side * COARSE)


@ti.func
def prolong(b, nu, nv):
    """The second plane of F.modal3 += W (E^-1 - E_P^-1) W^T r."""
    n = COARSE_ACROSS * COARSE_DOWN
    k = 0
    while k < n:
        o = C.right + k
        F.patch3[b, k] = Wide(
            F.coarse[b, o] - F.coarse[b, o + COARSE],
            F.coarse[b, o + n] - F.coarse[b, o + n + COARSE],
            F.coarse[b, o + 2 * n] - F.coarse[b, o + 2 * n + COARSE],
        )
        k = F.after[k]
    k = 0
    while k < COARSE_ACROSS:
        j = 0
        while j < nv:
            o = nu * nv + j * nu + C.place[k]
            w = C.rows + j * COARSE_DOWN
            total = F.modal3[b, o]
            for m in ti.static(range(COARSE_DOWN)):
                total += C.shared[w + m] * F.patch3[b, k * COARSE_DOWN + m]
            F.modal3[b, o] = total
            j = F.after[j]
        k = F.after[k]

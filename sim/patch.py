"""The 4 x 4 nodes around a fixed point: vectors from the grid to F.patch3 and back, and their weighted sums."""

import taichi as ti

from sim.fields import LANES, F
from sim.vectors import thrice


@ti.func
def gather(b, field: ti.template(), first: ti.template(), stride, pt, src):
    """F.patch3 = vectors of `field`, a plane that begins at src with rows of `stride`; first: F.base or F.start."""
    r = 0
    while r < 4:
        m = 0
        while m < 4:
            for lane in range(LANES):
                k = src + first[b, pt][lane] + r * stride + m
                for c in ti.static(range(3)):
                    F.patch3[b, r * 4 + m][c * LANES + lane] = field[b, k][c * LANES + lane]
            m = F.after[m]
        r = F.after[r]


@ti.func
def scatter(b, field: ti.template(), first: ti.template(), stride, pt, dst):
    """Adds F.patch3 to where `gather` takes it from."""
    r = 0
    while r < 4:
        m = 0
        while m < 4:
            for lane in range(LANES):
                k = dst + first[b, pt][lane] + r * stride + m
                for c in ti.static(range(3)):
                    e = c * LANES + lane
                    field[b, k][e] = field[b, k][e] + F.patch3[b, r * 4 + m][e]
            m = F.after[m]
        r = F.after[r]


@ti.func
def weigh(b, o, x0, x1, x2, x3):
    """Sum of four by the weights that lie at o of F.point."""
    return (
        thrice(F.point[b, o]) * x0
        + thrice(F.point[b, o + 1]) * x1
        + thrice(F.point[b, o + 2]) * x2
        + thrice(F.point[b, o + 3]) * x3
    )


@ti.func
def weigh_across(b, o, r):
    """Of row r of the patch."""
    return weigh(b, o, F.patch3[b, 4 * r], F.patch3[b, 4 * r + 1], F.patch3[b, 4 * r + 2], F.patch3[b, 4 * r + 3])


@ti.func
def weigh_rows(b, o, first):
    """Of four sums across that lie at `first` of F.row3."""
    return weigh(b, o, F.row3[b, first], F.row3[b, first + 1], F.row3[b, first + 2], F.row3[b, first + 3])

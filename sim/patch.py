"""The F.patch x F.patch nodes around a fixed point: vectors from the grid to F.patch3 and back, weighted sums."""

import taichi as ti

from sim.fields import LANES, F
from sim.vectors import thrice


@ti.func
def gather(b, field: ti.template(), first: ti.template(), stride, pt, src):
    """F.patch3 = vectors of `field`, a plane that begins at src with rows of `stride`; first: F.base or F.start."""
    r = 0
    while r < F.patch:
        m = 0
        while m < F.patch:
            for lane in range(LANES):
                k = src + first[b, pt][lane] + r * stride + m
                for c in ti.static(range(3)):
                    F.patch3[b, r * F.patch + m][c * LANES + lane] = field[b, k][c * LANES + lane]
            m = F.after[m]
        r = F.after[r]


@ti.func
def scatter(b, field: ti.template(), first: ti.template(), stride, pt, dst):
    """Adds F.patch3 to where `gather` takes it from."""
    r = 0
    while r < F.patch:
        m = 0
        while m < F.patch:
            for lane in range(LANES):
                k = dst + first[b, pt][lane] + r * stride + m
                for c in ti.static(range(3)):
                    e = c * LANES + lane
                    field[b, k][e] = field[b, k][e] + F.patch3[b, r * F.patch + m][e]
            m = F.after[m]
        r = F.after[r]


@ti.func
def weigh_across(b, o, r):
    """Sum of row r of the patch by the weights that lie at o of F.point."""
    total = thrice(F.point[b, o]) * F.patch3[b, r * F.patch]
    for m in ti.static(range(1, F.patch)):
        total += thrice(F.point[b, o + m]) * F.patch3[b, r * F.patch + m]
    return total


@ti.func
def weigh_rows(b, o, first):
    """Of sums across that lie at `first` of F.row3."""
    total = thrice(F.point[b, o]) * F.row3[b, first]
    for r in ti.static(range(1, F.patch)):
        total += thrice(F.point[b, o + r]) * F.row3[b, first + r]
    return total

"""Vectors of three components over nodes and fixed points: x of all lanes, then y, then z.

The nodes around a fixed point are F.touched across and down: from the grid to F.patch3 and back, weighted sums.
"""

import taichi as ti

from sim.kernels.fields import LANES, WIDE, F, indices
from sim.state import PATCH

Lanes = ti.types.vector(LANES, ti.f32)
Wide = ti.types.vector(WIDE, ti.f32)
FIRST, SECOND, THIRD = (slice(c * LANES, (c + 1) * LANES) for c in range(3))  # components


@ti.func
def parts(e):
    """Components of a vector; Wide(x, y, z) is the inverse."""
    return e[FIRST], e[SECOND], e[THIRD]


@ti.func
def thrice(a):
    """One number for all three components."""
    return Wide(a, a, a)


@ti.func
def sum3(e):
    """Sum over the components."""
    return e[FIRST] + e[SECOND] + e[THIRD]


@ti.func
def load(b, k):
    e = F.node3[b, k]
    return parts(e)


@ti.func
def difference(b, k, e):
    """Return the vector from entry k to entry e."""
    d = F.node3[b, e] - F.node3[b, k]
    return parts(d)


@ti.func
def store(b, k, x, y, z):
    F.node3[b, k] = Wide(x, y, z)


@ti.func
def load_point(b, k):
    e = F.point3[b, k]
    return parts(e)


@ti.func
def store_point(b, k, x, y, z):
    F.point3[b, k] = Wide(x, y, z)


@ti.func
def cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@ti.func
def dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@ti.func
def crossed(e, g):
    """e x g of vectors in one element each."""
    ax, ay, az = parts(e)
    bx, by, bz = parts(g)
    cx, cy, cz = cross(ax, ay, az, bx, by, bz)
    return Wide(cx, cy, cz)


@ti.func
def dotted(e, g):
    """e . g of these."""
    return sum3(e * g)


@ti.func
def exchange(b, nu, pt, plane, adds: ti.template()):
    """F.patch3 = vectors of the plane of F.node3 that begins at `plane`; if adds, F.patch3 is added to these."""
    for r in indices(F.touched[1]):
        for m in indices(F.touched[0]):
            for lane in range(LANES):
                k = plane + F.base[b, pt][lane] + r * (nu + 2) + m
                for c in ti.static(range(3)):
                    e = c * LANES + lane
                    if ti.static(adds):
                        F.node3[b, k][e] = F.node3[b, k][e] + F.patch3[b, r * PATCH + m][e]
                    else:
                        F.patch3[b, r * PATCH + m][e] = F.node3[b, k][e]


@ti.func
def weigh_across(b, o, r, dst):
    """F.row3 at dst = sum of row r of the patch by the weights that lie at o of F.point."""
    F.row3[b, dst] = thrice(F.point[b, o]) * F.patch3[b, r * PATCH]
    for m in indices(1, F.touched[0]):
        F.row3[b, dst] = F.row3[b, dst] + thrice(F.point[b, o + m]) * F.patch3[b, r * PATCH + m]


@ti.func
def weigh_rows(b, o, first, dst):
    """F.point3 at dst = sum of what lies at `first` of F.row3, a row each, by the weights that lie at o of F.point."""
    F.point3[b, dst] = thrice(F.point[b, o]) * F.row3[b, first]
    for r in indices(1, F.touched[1]):
        F.point3[b, dst] = F.point3[b, dst] + thrice(F.point[b, o + r]) * F.row3[b, first + r]

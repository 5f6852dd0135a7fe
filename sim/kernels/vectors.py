"""Vectors of three components over nodes and fixed points: x of all lanes, then y, then z."""

import taichi as ti

from sim.kernels.fields import LANES, WIDE, F

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

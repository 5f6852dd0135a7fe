"""Vectors of three components in the planes of F.node and F.point, lanes side by side."""

import taichi as ti

from sim.fields import F


@ti.func
def load(b, plane: ti.template(), P, k):
    return F.node[b, plane + k], F.node[b, plane + P + k], F.node[b, plane + 2 * P + k]


@ti.func
def difference(b, plane: ti.template(), P, k, e):
    """From node k to node e."""
    return (
        F.node[b, plane + e] - F.node[b, plane + k],
        F.node[b, plane + P + e] - F.node[b, plane + P + k],
        F.node[b, plane + 2 * P + e] - F.node[b, plane + 2 * P + k],
    )


@ti.func
def store(b, plane: ti.template(), P, k, x, y, z):
    F.node[b, plane + k] = x
    F.node[b, plane + P + k] = y
    F.node[b, plane + 2 * P + k] = z


@ti.func
def load_point(b, plane: ti.template(), k):
    return F.point[b, plane + k], F.point[b, plane + F.points + k], F.point[b, plane + 2 * F.points + k]


@ti.func
def store_point(b, plane: ti.template(), k, x, y, z):
    F.point[b, plane + k] = x
    F.point[b, plane + F.points + k] = y
    F.point[b, plane + 2 * F.points + k] = z


@ti.func
def cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@ti.func
def dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz

"""Smoothed local frames of the preconditioner: world components into theirs and back."""

import taichi as ti

from sim.fields import F
from sim.vectors import cross, difference, dot, load, store


@ti.func
def frames(b, nu, nv, reach):
    s = nu + 2
    P = s * (nv + 2)
    for j in range(nv):
        i = 0
        while i < nu:
            k = (j + 1) * s + i + 1
            w = k - ti.min(reach, i)
            e = k + ti.min(reach, nu - 1 - i)
            n = k - s * ti.min(reach, j)
            d = k + s * ti.min(reach, nv - 1 - j)
            ax, ay, az = difference(b, F.q, P, w, e)
            bx, by, bz = difference(b, F.q, P, n, d)
            cx, cy, cz = cross(bx, by, bz, ax, ay, az)
            il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
            store(b, F.fn, P, k, cx * il, cy * il, cz * il)
            ia = 1.0 / ti.sqrt(ax * ax + ay * ay + az * az)
            store(b, F.fu, P, k, ax * ia, ay * ia, az * ia)
            i = F.after[i]


@ti.func
def axes(b, P, k):
    """The unit vectors along u, along v and normal."""
    ux, uy, uz = load(b, F.fu, P, k)
    nx, ny, nz = load(b, F.fn, P, k)
    vx, vy, vz = cross(ux, uy, uz, nx, ny, nz)
    return ux, uy, uz, vx, vy, vz, nx, ny, nz


@ti.func
def warp(b, nu, nv, src: ti.template()):
    s = nu + 2
    P = s * (nv + 2)
    N = nu * nv
    for j in range(nv):
        i = 0
        while i < nu:
            k = (j + 1) * s + i + 1
            o = j * nu + i
            m = F.node[b, F.free + k]
            x, y, z = load(b, src, P, k)
            x *= m
            y *= m
            z *= m
            ux, uy, uz, vx, vy, vz, nx, ny, nz = axes(b, P, k)
            F.modal[b, o] = dot(ux, uy, uz, x, y, z)
            F.modal[b, N + o] = dot(vx, vy, vz, x, y, z)
            F.modal[b, 2 * N + o] = dot(nx, ny, nz, x, y, z)
            F.modal[b, 6 * N + o] = F.modal[b, o]
            F.modal[b, 7 * N + o] = F.modal[b, N + o]
            F.modal[b, 8 * N + o] = F.modal[b, 2 * N + o]
            i = F.after[i]


@ti.func
def unwarp(b, nu, nv, dst: ti.template()):
    """dst = world components of the warped field in F.modal"""
    s = nu + 2
    P = s * (nv + 2)
    N = nu * nv
    for j in range(nv):
        i = 0
        while i < nu:
            k = (j + 1) * s + i + 1
            o = j * nu + i
            m = F.node[b, F.free + k]
            u = F.modal[b, o] * m
            v = F.modal[b, N + o] * m
            w = F.modal[b, 2 * N + o] * m
            ux, uy, uz, vx, vy, vz, nx, ny, nz = axes(b, P, k)
            store(b, dst, P, k, u * ux + v * vx + w * nx, u * uy + v * vy + w * ny, u * uz + v * vz + w * nz)
            i = F.after[i]

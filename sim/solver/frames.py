"""Smoothed local frames of the preconditioner: world components into theirs and back."""

import taichi as ti

from sim.kernels.fields import F, indices
from sim.kernels.vectors import Wide, cross, difference, dot, load, parts, store, thrice


@ti.func
def frames(b, nu, nv, half_width):
    """Put the frame at every node, from the nodes `half_width` away, or at the border, in four directions."""
    s = nu + 2
    for j in range(nv):
        for i in indices(nu):
            k = (j + 1) * s + i + 1
            w = k - ti.min(half_width, i)
            e = k + ti.min(half_width, nu - 1 - i)
            n = k - s * ti.min(half_width, j)
            d = k + s * ti.min(half_width, nv - 1 - j)
            ax, ay, az = difference(b, F.q + w, F.q + e)
            bx, by, bz = difference(b, F.q + n, F.q + d)
            cx, cy, cz = cross(bx, by, bz, ax, ay, az)
            il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
            store(b, F.fn + k, cx * il, cy * il, cz * il)
            ia = 1.0 / ti.sqrt(ax * ax + ay * ay + az * az)
            store(b, F.fu + k, ax * ia, ay * ia, az * ia)


@ti.func
def axes(b, k):
    """The unit vectors along u, along v and normal."""
    ux, uy, uz = load(b, F.fu + k)
    nx, ny, nz = load(b, F.fn + k)
    vx, vy, vz = cross(ux, uy, uz, nx, ny, nz)
    return ux, uy, uz, vx, vy, vz, nx, ny, nz


@ti.func
def rotate(b, nu, nv, plane, into: ti.template()):
    """into: F.modal3 = components of a plane of F.node3 in the frames; else the plane = world components of F.modal3.
    Zero where nodes are held."""
    for j in range(nv):
        for i in indices(nu):
            k = (j + 1) * (nu + 2) + i + 1
            o = j * nu + i
            if ti.static(into):
                world = F.node3[b, plane + k] * thrice(F.node[b, F.free + k])
                x, y, z = parts(world)
                ux, uy, uz, vx, vy, vz, nx, ny, nz = axes(b, k)
                local = Wide(dot(ux, uy, uz, x, y, z), dot(vx, vy, vz, x, y, z), dot(nx, ny, nz, x, y, z))
                F.modal3[b, o] = local
            else:
                local = F.modal3[b, o] * thrice(F.node[b, F.free + k])
                u, v, w = parts(local)
                ux, uy, uz, vx, vy, vz, nx, ny, nz = axes(b, k)
                store(b, plane + k, u * ux + v * vx + w * nx, u * uy + v * vy + w * ny, u * uz + v * vz + w * nz)

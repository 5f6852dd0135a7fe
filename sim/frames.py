"""Smoothed local frames of the preconditioner: world components into theirs and back."""

import taichi as ti

from sim.fields import F


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
            ax = F.node[b, F.q + e] - F.node[b, F.q + w]
            ay = F.node[b, F.q + P + e] - F.node[b, F.q + P + w]
            az = F.node[b, F.q + 2 * P + e] - F.node[b, F.q + 2 * P + w]
            bx = F.node[b, F.q + d] - F.node[b, F.q + n]
            by = F.node[b, F.q + P + d] - F.node[b, F.q + P + n]
            bz = F.node[b, F.q + 2 * P + d] - F.node[b, F.q + 2 * P + n]
            cx = by * az - bz * ay
            cy = bz * ax - bx * az
            cz = bx * ay - by * ax
            il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
            F.node[b, F.fn + k] = cx * il
            F.node[b, F.fn + P + k] = cy * il
            F.node[b, F.fn + 2 * P + k] = cz * il
            ia = 1.0 / ti.sqrt(ax * ax + ay * ay + az * az)
            F.node[b, F.fu + k] = ax * ia
            F.node[b, F.fu + P + k] = ay * ia
            F.node[b, F.fu + 2 * P + k] = az * ia
            i = F.after[i]


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
            x = F.node[b, src + k] * m
            y = F.node[b, src + P + k] * m
            z = F.node[b, src + 2 * P + k] * m
            ux = F.node[b, F.fu + k]
            uy = F.node[b, F.fu + P + k]
            uz = F.node[b, F.fu + 2 * P + k]
            nx = F.node[b, F.fn + k]
            ny = F.node[b, F.fn + P + k]
            nz = F.node[b, F.fn + 2 * P + k]
            F.modal[b, o] = ux * x + uy * y + uz * z
            F.modal[b, N + o] = (uy * nz - uz * ny) * x + (uz * nx - ux * nz) * y + (ux * ny - uy * nx) * z
            F.modal[b, 2 * N + o] = nx * x + ny * y + nz * z
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
            a = F.modal[b, o] * m
            v = F.modal[b, N + o] * m
            n = F.modal[b, 2 * N + o] * m
            ux = F.node[b, F.fu + k]
            uy = F.node[b, F.fu + P + k]
            uz = F.node[b, F.fu + 2 * P + k]
            nx = F.node[b, F.fn + k]
            ny = F.node[b, F.fn + P + k]
            nz = F.node[b, F.fn + 2 * P + k]
            F.node[b, dst + k] = a * ux + v * (uy * nz - uz * ny) + n * nx
            F.node[b, dst + P + k] = a * uy + v * (uz * nx - ux * nz) + n * ny
            F.node[b, dst + 2 * P + k] = a * uz + v * (ux * ny - uy * nx) + n * nz
            i = F.after[i]

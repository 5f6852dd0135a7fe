"""Muscles: fixed points on the cloth, tension of the intervals between them, its force on the nodes.

Equations 7-10 of docs/model.md.
"""

import taichi as ti

from sim.fields import CONTRACTION_STEP, FIRST_CONTRACTION, LANES, PRESSURE_STEP, TABLE, F, X
from sim.vectors import cross, dot, load_point, store_point

Lanes = ti.types.vector(LANES, ti.f32)


@ti.func
def gather(b, nu, nv, pt, src: ti.template()):
    s = nu + 2
    P = s * (nv + 2)
    r = 0
    while r < 4:
        for m in range(4):
            for c in range(3):
                for lane in range(LANES):
                    F.patch[b, (r * 4 + m) * 3 + c][lane] = F.node[b, src + c * P + F.base[b, pt][lane] + r * s + m][
                        lane
                    ]
        r = F.after[r]


@ti.func
def weigh(b, o, x0, x1, x2, x3):
    """Sum of four by the weights that lie at o of F.point."""
    return F.point[b, o] * x0 + F.point[b, o + 1] * x1 + F.point[b, o + 2] * x2 + F.point[b, o + 3] * x3


@ti.func
def weigh_rows(b, o, first):
    return weigh(b, o, F.row[b, first], F.row[b, first + 1], F.row[b, first + 2], F.row[b, first + 3])


@ti.func
def interp(b, pt, p: ti.template(), pa: ti.template(), pb: ti.template()):
    for c in range(3):
        r = 0
        while r < 4:
            x0 = F.patch[b, r * 12 + c]
            x1 = F.patch[b, r * 12 + 3 + c]
            x2 = F.patch[b, r * 12 + 6 + c]
            x3 = F.patch[b, r * 12 + 9 + c]
            F.row[b, r] = weigh(b, X.wu + 4 * pt, x0, x1, x2, x3)
            F.row[b, 4 + r] = weigh(b, X.du + 4 * pt, x0, x1, x2, x3)
            r = F.after[r]
        F.point[b, p + c * F.points + pt] = weigh_rows(b, X.wv + 4 * pt, 0)
        F.point[b, pa + c * F.points + pt] = weigh_rows(b, X.wv + 4 * pt, 4)
        F.point[b, pb + c * F.points + pt] = weigh_rows(b, X.dv + 4 * pt, 0)


@ti.func
def points_pos(b, nu, nv, npt):
    pt = 0
    while pt < npt:
        gather(b, nu, nv, pt, F.q)
        interp(b, pt, X.pos, X.tan_u, X.tan_v)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        ax, ay, az = load_point(b, X.tan_u, pt)
        bx, by, bz = load_point(b, X.tan_v, pt)
        cx, cy, cz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
        F.point[b, X.inv_area + pt] = il
        store_point(b, X.normal, pt, cx * il, cy * il, cz * il)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        for c in range(3):
            F.point[b, X.pos + c * F.points + pt] = (
                F.point[b, X.pos + c * F.points + pt]
                + F.point[b, X.offset + pt] * F.point[b, X.normal + c * F.points + pt]
            )
        pt = F.after[pt]


@ti.func
def points_rate(b, nu, nv, npt, src: ti.template()):
    """DP = linearised motion of the fixed points under the nodal motion in src; uses X.force, DD as scratch"""
    pt = 0
    while pt < npt:
        gather(b, nu, nv, pt, src)
        interp(b, pt, X.vel, X.force, X.tmp)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        ax, ay, az = load_point(b, X.tan_u, pt)
        bx, by, bz = load_point(b, X.tan_v, pt)
        ex, ey, ez = load_point(b, X.force, pt)
        gx, gy, gz = load_point(b, X.tmp, pt)
        il = F.point[b, X.inv_area + pt]
        cx, cy, cz = cross(gx, gy, gz, ax, ay, az)
        dx, dy, dz = cross(bx, by, bz, ex, ey, ez)
        store_point(b, X.force, pt, (cx + dx) * il, (cy + dy) * il, (cz + dz) * il)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        nx, ny, nz = load_point(b, X.normal, pt)
        x, y, z = load_point(b, X.force, pt)
        nd = dot(nx, ny, nz, x, y, z)
        so = F.point[b, X.offset + pt]
        vx, vy, vz = load_point(b, X.vel, pt)
        store_point(b, X.vel, pt, vx + so * (x - nd * nx), vy + so * (y - nd * ny), vz + so * (z - nd * nz))
        pt = F.after[pt]


@ti.func
def back(b, nu, nv, npt, dst: ti.template()):
    """adds the fixed points' forces FP to the nodes"""
    s = nu + 2
    P = s * (nv + 2)
    pt = 0
    while pt < npt:
        nx, ny, nz = load_point(b, X.normal, pt)
        x, y, z = load_point(b, X.force, pt)
        nd = dot(nx, ny, nz, x, y, z)
        w = F.point[b, X.offset + pt] * F.point[b, X.inv_area + pt]
        store_point(b, X.tmp, pt, w * (x - nd * nx), w * (y - nd * ny), w * (z - nd * nz))
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        tx, ty, tz = load_point(b, X.tmp, pt)
        ax, ay, az = load_point(b, X.tan_u, pt)
        bx, by, bz = load_point(b, X.tan_v, pt)
        cx, cy, cz = cross(tx, ty, tz, bx, by, bz)
        store_point(b, X.grad_u, pt, cx, cy, cz)
        cx, cy, cz = cross(ax, ay, az, tx, ty, tz)
        store_point(b, X.grad_v, pt, cx, cy, cz)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        r = 0
        while r < 4:
            for c in range(3):
                w0 = (
                    F.point[b, X.wv + 4 * pt + r] * F.point[b, X.force + c * F.points + pt]
                    + F.point[b, X.dv + 4 * pt + r] * F.point[b, X.grad_v + c * F.points + pt]
                )
                w1 = F.point[b, X.wv + 4 * pt + r] * F.point[b, X.grad_u + c * F.points + pt]
                for m in range(4):
                    F.patch[b, (r * 4 + m) * 3 + c] = (
                        F.point[b, X.wu + 4 * pt + m] * w0 + F.point[b, X.du + 4 * pt + m] * w1
                    )
            r = F.after[r]
        r = 0
        while r < 4:
            for m in range(4):
                for c in range(3):
                    for lane in range(LANES):
                        k = dst + c * P + F.base[b, pt][lane] + r * s + m
                        F.node[b, k][lane] = F.node[b, k][lane] + F.patch[b, (r * 4 + m) * 3 + c][lane]
            r = F.after[r]
        pt = F.after[pt]


@ti.func
def tension(b, npt, cv):
    """DD, LEN, EPS, TEN and the inverse stiffness KI of every interval; DP must hold the points' velocity"""
    k = 0
    while k < npt - 1:
        ax, ay, az = load_point(b, X.pos, k)
        bx, by, bz = load_point(b, X.pos, k + 1)
        x = bx - ax
        y = by - ay
        z = bz - az
        il = 1.0 / ti.sqrt(x * x + y * y + z * z + 1e-16)
        store_point(b, X.dir, k, x * il, y * il, z * il)
        F.point[b, X.inv_len + k] = il
        k = F.after[k]
    k = 0
    while k < npt - 1:
        F.point[b, X.eps + k] = 1.0 - 1.0 / (F.point[b, X.inv_len + k] * F.point[b, X.rest + k])
        dx, dy, dz = load_point(b, X.dir, k)
        ax, ay, az = load_point(b, X.vel, k)
        bx, by, bz = load_point(b, X.vel, k + 1)
        F.point[b, X.rate + k] = -dot(dx, dy, dz, bx - ax, by - ay, bz - az) / F.point[b, X.rest + k]
        k = F.after[k]
    k = 0
    while k < npt - 1:
        for lane in range(LANES):
            x = (F.point[b, X.eps + k][lane] - FIRST_CONTRACTION) / CONTRACTION_STEP
            i = ti.min(ti.max(int(x), 0), TABLE[1] - 2)
            f = x - i
            pp = F.point[b, X.pressure + k][lane] / PRESSURE_STEP
            j = ti.min(ti.max(int(pp), 0), TABLE[0] - 2)
            g = pp - j
            ty = F.kind[b, k][lane]
            f0 = F.table[ty, 0, i]
            f1 = F.table[ty, 0, i + 1]
            e0 = (1 - g) * F.table[ty, j, i] + g * F.table[ty, j + 1, i]
            e1 = (1 - g) * F.table[ty, j, i + 1] + g * F.table[ty, j + 1, i + 1]
            h0 = f0 + F.point[b, X.gain + k][lane] * (e0 - f0)
            h1 = f1 + F.point[b, X.gain + k][lane] * (e1 - f1)
            F.point[b, X.tension + k][lane] = h0 + f * (h1 - h0)
            F.point[b, X.compliance + k][lane] = (h0 - h1) / CONTRACTION_STEP
        k = F.after[k]
    k = 0
    while k < npt - 1:
        F.point[b, X.tension + k] = F.point[b, X.active + k] * (
            F.point[b, X.tension + k] - F.point[b, X.viscosity + k] * F.point[b, X.rate + k]
        )
        F.point[b, X.compliance + k] = F.point[b, X.rest + k] / (
            F.point[b, X.compliance + k] + F.point[b, X.viscosity + k] * cv
        )
        k = F.after[k]


@ti.func
def seg_to_points(b, npt, src: ti.template()):
    for c in range(3):
        F.point[b, X.force + c * F.points] = F.point[b, src] * F.point[b, X.dir + c * F.points]
        k = 1
        while k < npt - 1:
            F.point[b, X.force + c * F.points + k] = (
                F.point[b, src + k] * F.point[b, X.dir + c * F.points + k]
                - F.point[b, src + k - 1] * F.point[b, X.dir + c * F.points + k - 1]
            )
            k = F.after[k]
        F.point[b, X.force + c * F.points + npt - 1] = (
            -F.point[b, src + npt - 2] * F.point[b, X.dir + c * F.points + npt - 2]
        )

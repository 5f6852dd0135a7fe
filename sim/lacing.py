"""Muscles: fixed points on the cloth, tension of the intervals between them, its force on the nodes.

Equations 7-10 of docs/model.md.
"""

import taichi as ti

from sim.fields import CONTRACTION_STEP, FIRST_CONTRACTION, LANES, PRESSURE_STEP, TABLE, F, X

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
def interp(b, pt, p: ti.template(), pa: ti.template(), pb: ti.template()):
    for c in range(3):
        r = 0
        while r < 4:
            x0 = F.patch[b, r * 12 + c]
            x1 = F.patch[b, r * 12 + 3 + c]
            x2 = F.patch[b, r * 12 + 6 + c]
            x3 = F.patch[b, r * 12 + 9 + c]
            F.row[b, r] = (
                F.point[b, X.wu + 4 * pt] * x0
                + F.point[b, X.wu + 4 * pt + 1] * x1
                + F.point[b, X.wu + 4 * pt + 2] * x2
                + F.point[b, X.wu + 4 * pt + 3] * x3
            )
            F.row[b, 4 + r] = (
                F.point[b, X.du + 4 * pt] * x0
                + F.point[b, X.du + 4 * pt + 1] * x1
                + F.point[b, X.du + 4 * pt + 2] * x2
                + F.point[b, X.du + 4 * pt + 3] * x3
            )
            r = F.after[r]
        F.point[b, p + c * F.points + pt] = (
            F.point[b, X.wv + 4 * pt] * F.row[b, 0]
            + F.point[b, X.wv + 4 * pt + 1] * F.row[b, 1]
            + F.point[b, X.wv + 4 * pt + 2] * F.row[b, 2]
            + F.point[b, X.wv + 4 * pt + 3] * F.row[b, 3]
        )
        F.point[b, pa + c * F.points + pt] = (
            F.point[b, X.wv + 4 * pt] * F.row[b, 4]
            + F.point[b, X.wv + 4 * pt + 1] * F.row[b, 5]
            + F.point[b, X.wv + 4 * pt + 2] * F.row[b, 6]
            + F.point[b, X.wv + 4 * pt + 3] * F.row[b, 7]
        )
        F.point[b, pb + c * F.points + pt] = (
            F.point[b, X.dv + 4 * pt] * F.row[b, 0]
            + F.point[b, X.dv + 4 * pt + 1] * F.row[b, 1]
            + F.point[b, X.dv + 4 * pt + 2] * F.row[b, 2]
            + F.point[b, X.dv + 4 * pt + 3] * F.row[b, 3]
        )


@ti.func
def points_pos(b, nu, nv, npt):
    pt = 0
    while pt < npt:
        gather(b, nu, nv, pt, F.q)
        interp(b, pt, X.pos, X.tan_u, X.tan_v)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        ax = F.point[b, X.tan_u + pt]
        ay = F.point[b, X.tan_u + F.points + pt]
        az = F.point[b, X.tan_u + 2 * F.points + pt]
        bx = F.point[b, X.tan_v + pt]
        by = F.point[b, X.tan_v + F.points + pt]
        bz = F.point[b, X.tan_v + 2 * F.points + pt]
        cx = by * az - bz * ay
        cy = bz * ax - bx * az
        cz = bx * ay - by * ax
        il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
        F.point[b, X.inv_area + pt] = il
        F.point[b, X.normal + pt] = cx * il
        F.point[b, X.normal + F.points + pt] = cy * il
        F.point[b, X.normal + 2 * F.points + pt] = cz * il
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
        ax = F.point[b, X.tan_u + pt]
        ay = F.point[b, X.tan_u + F.points + pt]
        az = F.point[b, X.tan_u + 2 * F.points + pt]
        bx = F.point[b, X.tan_v + pt]
        by = F.point[b, X.tan_v + F.points + pt]
        bz = F.point[b, X.tan_v + 2 * F.points + pt]
        ex = F.point[b, X.force + pt]
        ey = F.point[b, X.force + F.points + pt]
        ez = F.point[b, X.force + 2 * F.points + pt]
        gx = F.point[b, X.tmp + pt]
        gy = F.point[b, X.tmp + F.points + pt]
        gz = F.point[b, X.tmp + 2 * F.points + pt]
        il = F.point[b, X.inv_area + pt]
        F.point[b, X.force + pt] = ((gy * az - gz * ay) + (by * ez - bz * ey)) * il
        F.point[b, X.force + F.points + pt] = ((gz * ax - gx * az) + (bz * ex - bx * ez)) * il
        F.point[b, X.force + 2 * F.points + pt] = ((gx * ay - gy * ax) + (bx * ey - by * ex)) * il
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        nx = F.point[b, X.normal + pt]
        ny = F.point[b, X.normal + F.points + pt]
        nz = F.point[b, X.normal + 2 * F.points + pt]
        x = F.point[b, X.force + pt]
        y = F.point[b, X.force + F.points + pt]
        z = F.point[b, X.force + 2 * F.points + pt]
        nd = nx * x + ny * y + nz * z
        so = F.point[b, X.offset + pt]
        F.point[b, X.vel + pt] = F.point[b, X.vel + pt] + so * (x - nd * nx)
        F.point[b, X.vel + F.points + pt] = F.point[b, X.vel + F.points + pt] + so * (y - nd * ny)
        F.point[b, X.vel + 2 * F.points + pt] = F.point[b, X.vel + 2 * F.points + pt] + so * (z - nd * nz)
        pt = F.after[pt]


@ti.func
def back(b, nu, nv, npt, dst: ti.template()):
    """adds the fixed points' forces FP to the nodes"""
    s = nu + 2
    P = s * (nv + 2)
    pt = 0
    while pt < npt:
        nx = F.point[b, X.normal + pt]
        ny = F.point[b, X.normal + F.points + pt]
        nz = F.point[b, X.normal + 2 * F.points + pt]
        x = F.point[b, X.force + pt]
        y = F.point[b, X.force + F.points + pt]
        z = F.point[b, X.force + 2 * F.points + pt]
        nd = nx * x + ny * y + nz * z
        w = F.point[b, X.offset + pt] * F.point[b, X.inv_area + pt]
        F.point[b, X.tmp + pt] = w * (x - nd * nx)
        F.point[b, X.tmp + F.points + pt] = w * (y - nd * ny)
        F.point[b, X.tmp + 2 * F.points + pt] = w * (z - nd * nz)
        pt = F.after[pt]
    pt = 0
    while pt < npt:
        tx = F.point[b, X.tmp + pt]
        ty = F.point[b, X.tmp + F.points + pt]
        tz = F.point[b, X.tmp + 2 * F.points + pt]
        ax = F.point[b, X.tan_u + pt]
        ay = F.point[b, X.tan_u + F.points + pt]
        az = F.point[b, X.tan_u + 2 * F.points + pt]
        bx = F.point[b, X.tan_v + pt]
        by = F.point[b, X.tan_v + F.points + pt]
        bz = F.point[b, X.tan_v + 2 * F.points + pt]
        F.point[b, X.grad_u + pt] = ty * bz - tz * by
        F.point[b, X.grad_u + F.points + pt] = tz * bx - tx * bz
        F.point[b, X.grad_u + 2 * F.points + pt] = tx * by - ty * bx
        F.point[b, X.grad_v + pt] = ay * tz - az * ty
        F.point[b, X.grad_v + F.points + pt] = az * tx - ax * tz
        F.point[b, X.grad_v + 2 * F.points + pt] = ax * ty - ay * tx
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
        x = F.point[b, X.pos + k + 1] - F.point[b, X.pos + k]
        y = F.point[b, X.pos + F.points + k + 1] - F.point[b, X.pos + F.points + k]
        z = F.point[b, X.pos + 2 * F.points + k + 1] - F.point[b, X.pos + 2 * F.points + k]
        il = 1.0 / ti.sqrt(x * x + y * y + z * z + 1e-16)
        F.point[b, X.dir + k] = x * il
        F.point[b, X.dir + F.points + k] = y * il
        F.point[b, X.dir + 2 * F.points + k] = z * il
        F.point[b, X.inv_len + k] = il
        k = F.after[k]
    k = 0
    while k < npt - 1:
        F.point[b, X.eps + k] = 1.0 - 1.0 / (F.point[b, X.inv_len + k] * F.point[b, X.rest + k])
        F.point[b, X.rate + k] = (
            -(
                F.point[b, X.dir + k] * (F.point[b, X.vel + k + 1] - F.point[b, X.vel + k])
                + F.point[b, X.dir + F.points + k]
                * (F.point[b, X.vel + F.points + k + 1] - F.point[b, X.vel + F.points + k])
                + F.point[b, X.dir + 2 * F.points + k]
                * (F.point[b, X.vel + 2 * F.points + k + 1] - F.point[b, X.vel + 2 * F.points + k])
            )
            / F.point[b, X.rest + k]
        )
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

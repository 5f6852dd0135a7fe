"""Bending of the cloth at its nodes (equations 4 and 5 of docs/model.md) and at a clamp."""

import taichi as ti

from sim.fields import AREA, B1, B2, D1, D2, D12, DCLAMP, HU, HV, IHU, IHV, F


@ti.func
def star_row(b, nu, nv, j, q: ti.template()):
    """node normals, curvatures, bending moments, and what the moments' couple puts on the two tangents"""
    s = nu + 2
    P = s * (nv + 2)
    i = 0
    while i < nu:
        k = (j + 1) * s + i + 1
        w = k - 1
        e = k + 1
        n = k - s
        d = k + s
        if i == 0:
            w = k
        if i == nu - 1:
            e = k
        if j == 0:
            n = k
        if j == nv - 1:
            d = k
        ax = F.node[b, q + e] - F.node[b, q + w]
        ay = F.node[b, q + P + e] - F.node[b, q + P + w]
        az = F.node[b, q + 2 * P + e] - F.node[b, q + 2 * P + w]
        bx = F.node[b, q + d] - F.node[b, q + n]
        by = F.node[b, q + P + d] - F.node[b, q + P + n]
        bz = F.node[b, q + 2 * P + d] - F.node[b, q + 2 * P + n]
        cx = by * az - bz * ay
        cy = bz * ax - bx * az
        cz = bx * ay - by * ax
        il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
        F.node[b, F.n + k] = cx * il
        F.node[b, F.n + P + k] = cy * il
        F.node[b, F.n + 2 * P + k] = cz * il
        F.node[b, F.i1 + k] = il
        F.node[b, F.na + k] = ax
        F.node[b, F.na + P + k] = ay
        F.node[b, F.na + 2 * P + k] = az
        F.node[b, F.nb + k] = bx
        F.node[b, F.nb + P + k] = by
        F.node[b, F.nb + 2 * P + k] = bz
        i = F.after[i]
    i = 0
    while i < nu:
        k = (j + 1) * s + i + 1
        w = k - 1
        n = k - s
        has1 = ti.f32(1.0)
        has2 = ti.f32(1.0)
        wt = ti.f32(1.0)
        if i == 0 or i == nu - 1:
            has1 = ti.f32(0.0)
            wt *= 0.5
        if j == 0 or j == nv - 1:
            has2 = ti.f32(0.0)
            wt *= 0.5
        hh = has1 * has2
        # curvature vectors b = t+ - t-
        ux = F.node[b, F.tu + k] - F.node[b, F.tu + w]
        uy = F.node[b, F.tu + P + k] - F.node[b, F.tu + P + w]
        uz = F.node[b, F.tu + 2 * P + k] - F.node[b, F.tu + 2 * P + w]
        vx = F.node[b, F.tv + k] - F.node[b, F.tv + n]
        vy = F.node[b, F.tv + P + k] - F.node[b, F.tv + P + n]
        vz = F.node[b, F.tv + 2 * P + k] - F.node[b, F.tv + 2 * P + n]
        k1 = F.node[b, F.n + k] * ux + F.node[b, F.n + P + k] * uy + F.node[b, F.n + 2 * P + k] * uz
        k2 = F.node[b, F.n + k] * vx + F.node[b, F.n + P + k] * vy + F.node[b, F.n + 2 * P + k] * vz
        A = F.lane[b, AREA] * wt
        M1 = (
            F.lane[b, IHU] * (has1 * F.lane[b, B1] + hh * (F.lane[b, D1] - F.lane[b, B1])) * k1 * F.lane[b, IHU]
            + hh * F.lane[b, IHU] * F.lane[b, D12] * F.lane[b, IHV] * k2
        ) * A
        M2 = (
            F.lane[b, IHV] * (has2 * F.lane[b, B2] + hh * (F.lane[b, D2] - F.lane[b, B2])) * k2 * F.lane[b, IHV]
            + hh * F.lane[b, IHV] * F.lane[b, D12] * F.lane[b, IHU] * k1
        ) * A
        F.node[b, F.s1 + k] = M1
        F.node[b, F.s2 + k] = M2
        F.node[b, F.pu + k] = (M1 * ux + M2 * vx) * F.node[b, F.i1 + k]
        F.node[b, F.pu + P + k] = (M1 * uy + M2 * vy) * F.node[b, F.i1 + k]
        F.node[b, F.pu + 2 * P + k] = (M1 * uz + M2 * vz) * F.node[b, F.i1 + k]
        i = F.after[i]
    i = 0
    while i < nu:
        k = (j + 1) * s + i + 1
        nx = F.node[b, F.n + k]
        ny = F.node[b, F.n + P + k]
        nz = F.node[b, F.n + 2 * P + k]
        cn = F.node[b, F.pu + k] * nx + F.node[b, F.pu + P + k] * ny + F.node[b, F.pu + 2 * P + k] * nz
        cx = F.node[b, F.pu + k] - cn * nx
        cy = F.node[b, F.pu + P + k] - cn * ny
        cz = F.node[b, F.pu + 2 * P + k] - cn * nz
        ax = F.node[b, F.na + k]
        ay = F.node[b, F.na + P + k]
        az = F.node[b, F.na + 2 * P + k]
        bx = F.node[b, F.nb + k]
        by = F.node[b, F.nb + P + k]
        bz = F.node[b, F.nb + 2 * P + k]
        F.node[b, F.na + k] = by * cz - bz * cy
        F.node[b, F.na + P + k] = bz * cx - bx * cz
        F.node[b, F.na + 2 * P + k] = bx * cy - by * cx
        F.node[b, F.nb + k] = cy * az - cz * ay
        F.node[b, F.nb + P + k] = cz * ax - cx * az
        F.node[b, F.nb + 2 * P + k] = cx * ay - cy * ax
        i = F.after[i]


@ti.func
def clamp_pass(b, nu, nv, hung, q):
    """Half a cell of bending between the held normal (0, 0, 1) of a clamped edge and the first edges of the cloth."""
    s = nu + 2
    P = s * (nv + 2)
    count = nu
    h = F.lane[b, HV]
    width = F.lane[b, HU]
    stiffness = F.lane[b, B2]
    if hung > 1:
        count = nv
        h = F.lane[b, HU]
        width = F.lane[b, HV]
        stiffness = F.lane[b, B1]
    i = 0
    while i < count:
        k = s + i + 1
        e = k + s
        if hung == 1:
            k = nv * s + i + 1
            e = k - s
        if hung == 2:
            k = (i + 1) * s + 1
            e = k + 1
        if hung == 3:
            k = (i + 1) * s + nu
            e = k - 1
        w = ti.f32(1.0)
        if i == 0 or i == count - 1:
            w = 0.5
        dx = F.node[b, q + e] - F.node[b, q + k]
        dy = F.node[b, q + P + e] - F.node[b, q + P + k]
        dz = F.node[b, q + 2 * P + e] - F.node[b, q + 2 * P + k]
        il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
        tz = dz * il
        m = w * F.lane[b, DCLAMP] * stiffness * width * 2.0 / h * tz * il
        F.node[b, F.f + e] = F.node[b, F.f + e] + m * tz * dx * il
        F.node[b, F.f + P + e] = F.node[b, F.f + P + e] + m * tz * dy * il
        F.node[b, F.f + 2 * P + e] = F.node[b, F.f + 2 * P + e] - m * (1.0 - tz * tz)
        i = F.after[i]

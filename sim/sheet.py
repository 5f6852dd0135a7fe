"""Forces of the cloth: membrane, shear, twist and bending constraints on the grid.

Equations 1-6 of docs/model.md.
"""

import taichi as ti

from sim.fields import (
    AIR,
    AREA,
    B1,
    B2,
    D1,
    D2,
    D12,
    DCLAMP,
    GX,
    HU,
    HV,
    IHU,
    IHV,
    K12,
    KH1,
    KH2,
    LANES,
    Q1,
    Q2,
    R1,
    R2,
    SH,
    TW,
    VISC,
    F,
)

Lanes = ti.types.vector(LANES, ti.f32)


@ti.func
def edge_row(
    b,
    nu,
    nv,
    q: ti.template(),
    v: ti.template(),
    t: ti.template(),
    le: ti.template(),
    eps: ti.template(),
    sig: ti.template(),
    st,
    ni,
    j,
    along_u: ti.template(),
):
    s = nu + 2
    P = s * (nv + 2)
    for i in range(ni):
        k = F.index[(j + 1) * s + i + 1]
        e = k + st
        dx = F.node[b, q + e] - F.node[b, q + k]
        dy = F.node[b, q + P + e] - F.node[b, q + P + k]
        dz = F.node[b, q + 2 * P + e] - F.node[b, q + 2 * P + k]
        il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
        F.node[b, t + k] = dx * il
        F.node[b, t + P + k] = dy * il
        F.node[b, t + 2 * P + k] = dz * il
        F.node[b, le + k] = il
    ih = F.lane[b, IHU] if ti.static(along_u) else F.lane[b, IHV]
    kh = F.lane[b, KH1] if ti.static(along_u) else F.lane[b, KH2]
    A = F.lane[b, AREA]
    kA = kh * A
    quadratic = F.lane[b, Q1] if ti.static(along_u) else F.lane[b, Q2]
    cubic = F.lane[b, R1] if ti.static(along_u) else F.lane[b, R2]
    vA = F.lane[b, VISC] * A * ih
    for i in range(ni):
        k = F.index[(j + 1) * s + i + 1]
        e = k + st
        w = ti.f32(1.0)
        if ti.static(along_u):
            if j == 0 or j == nv - 1:
                w = ti.f32(0.5)
        else:
            if i == 0 or i == nu - 1:
                w = ti.f32(0.5)
        ep = ih / F.node[b, le + k] - 1.0
        up = ti.max(ep, 0.0)
        r = (
            (F.node[b, v + e] - F.node[b, v + k]) * F.node[b, t + k]
            + (F.node[b, v + P + e] - F.node[b, v + P + k]) * F.node[b, t + P + k]
            + (F.node[b, v + 2 * P + e] - F.node[b, v + 2 * P + k]) * F.node[b, t + 2 * P + k]
        )
        F.node[b, eps + k] = ep
        F.node[b, sig + k] = w * (kA * ep + A * up * up * (quadratic + cubic * up) + vA * r)


@ti.func
def cell_row(b, nu, nv, j, q: ti.template(), v: ti.template()):
    s = nu + 2
    P = s * (nv + 2)
    SA = F.lane[b, SH] * F.lane[b, AREA]
    VA = 0.5 * F.lane[b, VISC] * F.lane[b, AREA]
    ihh = F.lane[b, IHU] * F.lane[b, IHV]
    TA = 2.0 * F.lane[b, TW] * F.lane[b, AREA] * ihh * ihh
    for i in range(nu - 1):
        k = F.index[(j + 1) * s + i + 1]
        ku = k + 1
        kv = k + s
        kw = kv + 1
        # diagonals: a1=(p+m)/2, a2=(p-m)/2 with p=x11-x00, m=x10-x01
        px = F.node[b, q + kw] - F.node[b, q + k]
        py = F.node[b, q + P + kw] - F.node[b, q + P + k]
        pz = F.node[b, q + 2 * P + kw] - F.node[b, q + 2 * P + k]
        mx = F.node[b, q + ku] - F.node[b, q + kv]
        my = F.node[b, q + P + ku] - F.node[b, q + P + kv]
        mz = F.node[b, q + 2 * P + ku] - F.node[b, q + 2 * P + kv]
        ax = 0.5 * (px + mx)
        ay = 0.5 * (py + my)
        az = 0.5 * (pz + mz)
        bx = 0.5 * (px - mx)
        by = 0.5 * (py - my)
        bz = 0.5 * (pz - mz)
        i1 = 1.0 / ti.sqrt(ax * ax + ay * ay + az * az)
        i2 = 1.0 / ti.sqrt(bx * bx + by * by + bz * bz)
        F.node[b, F.ca + k] = ax * i1
        F.node[b, F.ca + P + k] = ay * i1
        F.node[b, F.ca + 2 * P + k] = az * i1
        F.node[b, F.cb + k] = bx * i2
        F.node[b, F.cb + P + k] = by * i2
        F.node[b, F.cb + 2 * P + k] = bz * i2
        F.node[b, F.i1 + k] = i1
        F.node[b, F.i2 + k] = i2
    for i in range(nu - 1):
        k = F.index[(j + 1) * s + i + 1]
        ku = k + 1
        kv = k + s
        kw = kv + 1
        # shear: gamma = t1.t2, its gradients g1=(t2-gamma t1)/l1, g2
        tx = F.node[b, F.ca + k]
        ty = F.node[b, F.ca + P + k]
        tz = F.node[b, F.ca + 2 * P + k]
        ux = F.node[b, F.cb + k]
        uy = F.node[b, F.cb + P + k]
        uz = F.node[b, F.cb + 2 * P + k]
        g = tx * ux + ty * uy + tz * uz
        F.node[b, F.pu + k] = (ux - g * tx) * F.node[b, F.i1 + k]
        F.node[b, F.pu + P + k] = (uy - g * ty) * F.node[b, F.i1 + k]
        F.node[b, F.pu + 2 * P + k] = (uz - g * tz) * F.node[b, F.i1 + k]
        F.node[b, F.pv + k] = (tx - g * ux) * F.node[b, F.i2 + k]
        F.node[b, F.pv + P + k] = (ty - g * uy) * F.node[b, F.i2 + k]
        F.node[b, F.pv + 2 * P + k] = (tz - g * uz) * F.node[b, F.i2 + k]
        # normal = t2 x t1
        nx = uy * tz - uz * ty
        ny = uz * tx - ux * tz
        nz = ux * ty - uy * tx
        il = 1.0 / ti.sqrt(nx * nx + ny * ny + nz * nz)
        F.node[b, F.na + k] = nx * il
        F.node[b, F.na + P + k] = ny * il
        F.node[b, F.na + 2 * P + k] = nz * il
        F.node[b, F.lu + k] = g
        F.node[b, F.lv + k] = il
    for i in range(nu - 1):
        k = F.index[(j + 1) * s + i + 1]
        ku = k + 1
        kv = k + s
        kw = kv + 1
        px = F.node[b, v + kw] - F.node[b, v + k]
        py = F.node[b, v + P + kw] - F.node[b, v + P + k]
        pz = F.node[b, v + 2 * P + kw] - F.node[b, v + 2 * P + k]
        mx = F.node[b, v + ku] - F.node[b, v + kv]
        my = F.node[b, v + P + ku] - F.node[b, v + P + kv]
        mz = F.node[b, v + 2 * P + ku] - F.node[b, v + 2 * P + kv]
        gp = (
            (F.node[b, F.pu + k] + F.node[b, F.pv + k]) * px
            + (F.node[b, F.pu + P + k] + F.node[b, F.pv + P + k]) * py
            + (F.node[b, F.pu + 2 * P + k] + F.node[b, F.pv + 2 * P + k]) * pz
        )
        gm = (
            (F.node[b, F.pu + k] - F.node[b, F.pv + k]) * mx
            + (F.node[b, F.pu + P + k] - F.node[b, F.pv + P + k]) * my
            + (F.node[b, F.pu + 2 * P + k] - F.node[b, F.pv + 2 * P + k]) * mz
        )
        F.node[b, F.s1 + k] = SA * F.node[b, F.lu + k] + VA * 0.5 * (gp + gm)
        dx = (F.node[b, q + kw] - F.node[b, q + ku]) - (F.node[b, q + kv] - F.node[b, q + k])
        dy = (F.node[b, q + P + kw] - F.node[b, q + P + ku]) - (F.node[b, q + P + kv] - F.node[b, q + P + k])
        dz = (F.node[b, q + 2 * P + kw] - F.node[b, q + 2 * P + ku]) - (
            F.node[b, q + 2 * P + kv] - F.node[b, q + 2 * P + k]
        )
        nd = F.node[b, F.na + k] * dx + F.node[b, F.na + P + k] * dy + F.node[b, F.na + 2 * P + k] * dz
        F.node[b, F.s2 + k] = TA * nd
        # twist couple on the normal, tangential part
        F.node[b, F.nb + k] = TA * nd * (dx - nd * F.node[b, F.na + k])
        F.node[b, F.nb + P + k] = TA * nd * (dy - nd * F.node[b, F.na + P + k])
        F.node[b, F.nb + 2 * P + k] = TA * nd * (dz - nd * F.node[b, F.na + 2 * P + k])
    for i in range(nu - 1):
        k = F.index[(j + 1) * s + i + 1]
        cx = F.node[b, F.nb + k]
        cy = F.node[b, F.nb + P + k]
        cz = F.node[b, F.nb + 2 * P + k]
        w1 = F.node[b, F.lv + k] * F.node[b, F.i1 + k]
        w2 = F.node[b, F.lv + k] * F.node[b, F.i2 + k]
        tau = F.node[b, F.s1 + k]
        m = F.node[b, F.s2 + k]
        tx = F.node[b, F.ca + k]
        ty = F.node[b, F.ca + P + k]
        tz = F.node[b, F.ca + 2 * P + k]
        ux = F.node[b, F.cb + k]
        uy = F.node[b, F.cb + P + k]
        uz = F.node[b, F.cb + 2 * P + k]
        F.node[b, F.ca + k] = 0.5 * ((uy * cz - uz * cy) * w1 - tau * F.node[b, F.pu + k])
        F.node[b, F.ca + P + k] = 0.5 * ((uz * cx - ux * cz) * w1 - tau * F.node[b, F.pu + P + k])
        F.node[b, F.ca + 2 * P + k] = 0.5 * ((ux * cy - uy * cx) * w1 - tau * F.node[b, F.pu + 2 * P + k])
        F.node[b, F.cb + k] = 0.5 * ((cy * tz - cz * ty) * w2 - tau * F.node[b, F.pv + k])
        F.node[b, F.cb + P + k] = 0.5 * ((cz * tx - cx * tz) * w2 - tau * F.node[b, F.pv + P + k])
        F.node[b, F.cb + 2 * P + k] = 0.5 * ((cx * ty - cy * tx) * w2 - tau * F.node[b, F.pv + 2 * P + k])
        F.node[b, F.cd + k] = -m * F.node[b, F.na + k]
        F.node[b, F.cd + P + k] = -m * F.node[b, F.na + P + k]
        F.node[b, F.cd + 2 * P + k] = -m * F.node[b, F.na + 2 * P + k]


@ti.func
def star_row(b, nu, nv, j, q: ti.template()):
    """node normals, curvatures, bending moments, and what the moments' couple puts on the two tangents"""
    s = nu + 2
    P = s * (nv + 2)
    for i in range(nu):
        k = F.index[(j + 1) * s + i + 1]
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
    for i in range(nu):
        k = F.index[(j + 1) * s + i + 1]
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
    for i in range(nu):
        k = F.index[(j + 1) * s + i + 1]
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


@ti.func
def edge_force_row(
    b,
    nu,
    nv,
    t: ti.template(),
    le: ti.template(),
    sig: ti.template(),
    M: ti.template(),
    other: ti.template(),
    out: ti.template(),
    st,
    so,
    ni,
    j,
    along_u: ti.template(),
):
    s = nu + 2
    P = s * (nv + 2)
    ih = F.lane[b, IHU] if ti.static(along_u) else F.lane[b, IHV]
    kc = 0.25 * F.lane[b, K12] * F.lane[b, AREA]
    for i in range(ni):
        k = F.index[(j + 1) * s + i + 1]
        e = k + st
        tx = F.node[b, t + k]
        ty = F.node[b, t + P + k]
        tz = F.node[b, t + 2 * P + k]
        Mk = F.node[b, M + k]
        Me = F.node[b, M + e]
        yx = Mk * F.node[b, F.n + k] - Me * F.node[b, F.n + e]
        yy = Mk * F.node[b, F.n + P + k] - Me * F.node[b, F.n + P + e]
        yz = Mk * F.node[b, F.n + 2 * P + k] - Me * F.node[b, F.n + 2 * P + e]
        ty_ = tx * yx + ty * yy + tz * yz
        T = (
            F.node[b, sig + k]
            + kc * (F.node[b, other + k] + F.node[b, other + e] + F.node[b, other + k - so] + F.node[b, other + e - so])
        ) * ih
        il = F.node[b, le + k]
        F.node[b, out + k] = (T - ty_ * il) * tx + il * yx
        F.node[b, out + P + k] = (T - ty_ * il) * ty + il * yy
        F.node[b, out + 2 * P + k] = (T - ty_ * il) * tz + il * yz
    if ti.static(along_u):  # the last column carries no edge, and was scratch
        for c in range(3):
            F.node[b, out + c * P + (j + 1) * s + nu] = Lanes(0.0)


@ti.func
def gather_row(b, nu, nv, j, ca):
    """f = internal forces + gravity - air damping - M a"""
    s = nu + 2
    P = s * (nv + 2)
    for c in range(3):
        g = F.lane[b, GX + c]
        aA = F.lane[b, AIR] * F.lane[b, AREA]
        for i in range(nu):
            kk = F.index[(j + 1) * s + i + 1]
            k = c * P + kk
            s1 = ti.f32(0.0)
            s2 = ti.f32(0.0)
            wt = ti.f32(1.0)
            if i == 0:
                s1 = ti.f32(-1.0)
                wt *= 0.5
            if i == nu - 1:
                s1 = ti.f32(1.0)
                wt *= 0.5
            if j == 0:
                s2 = ti.f32(-1.0)
                wt *= 0.5
            if j == nv - 1:
                s2 = ti.f32(1.0)
                wt *= 0.5
            e = F.node[b, F.pu + k] - F.node[b, F.pu + k - 1] + F.node[b, F.pv + k] - F.node[b, F.pv + k - s]
            m = (
                F.node[b, F.na + k - 1]
                - F.node[b, F.na + k + 1]
                + s1 * F.node[b, F.na + k]
                + F.node[b, F.nb + k - s]
                - F.node[b, F.nb + k + s]
                + s2 * F.node[b, F.nb + k]
            )
            ce = (
                (F.node[b, F.cd + k] - F.node[b, F.ca + k] - F.node[b, F.cb + k])
                + (F.node[b, F.ca + k - 1] - F.node[b, F.cb + k - 1] - F.node[b, F.cd + k - 1])
                + (F.node[b, F.cb + k - s] - F.node[b, F.ca + k - s] - F.node[b, F.cd + k - s])
                + (F.node[b, F.ca + k - s - 1] + F.node[b, F.cb + k - s - 1] + F.node[b, F.cd + k - s - 1])
            )
            F.node[b, F.f + k] = (
                e
                + m
                + ce
                + F.node[b, F.mass + kk] * (g - ca * F.node[b, F.q + k] - F.node[b, F.ha + k])
                - wt * aA * F.node[b, F.v + k]
                + F.node[b, F.carry + k]
            )


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
    for i_ in range(count):
        i = F.index[i_]
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


@ti.func
def fabric_force(b, nu, nv, hung, ca, cv):
    """v = cv q + hv, and f = forces of the cloth - M a: row by row, each stage as soon as the rows that it reads are
    there, so that they still lie in the cache."""
    s = nu + 2
    for j in range(-1, nv + 2):
        if j + 1 < nv:
            velocity_row(b, nu, nv, j + 1, cv)
        if 0 <= j < nv - 1:
            cell_row(b, nu, nv, j, F.q, F.v)
            edge_row(b, nu, nv, F.q, F.v, F.tv, F.lv, F.ev, F.sv, s, nu, j, False)
        if 0 <= j < nv:
            edge_row(b, nu, nv, F.q, F.v, F.tu, F.lu, F.eu, F.su, 1, nu - 1, j, True)
        if 1 <= j <= nv:
            star_row(b, nu, nv, j - 1, F.q)
            edge_force_row(b, nu, nv, F.tu, F.lu, F.su, F.s1, F.ev, F.pu, 1, s, nu - 1, j - 1, True)
        if 2 <= j <= nv:
            edge_force_row(b, nu, nv, F.tv, F.lv, F.sv, F.s2, F.eu, F.pv, s, 1, nu, j - 2, False)
        if j >= 2:
            gather_row(b, nu, nv, j - 2, ca)
    if 0 <= hung < 4:
        clamp_pass(b, nu, nv, hung, F.q)


@ti.func
def velocity_row(b, nu, nv, j, cv):
    for c in range(3):
        for i in range(nu):
            k = F.index[(c * (nv + 2) + j + 1) * (nu + 2) + i + 1]
            F.node[b, F.v + k] = cv * F.node[b, F.q + k] + F.node[b, F.hv + k]

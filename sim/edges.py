"""Edges of the grid: strain, tension and viscosity (equations 1 and 2 of docs/model.md), and their forces."""

import taichi as ti

from sim.fields import AREA, IHU, IHV, K12, KH1, KH2, LANES, Q1, Q2, R1, R2, VISC, F

Lanes = ti.types.vector(LANES, ti.f32)


@ti.func
def velocity_row(b, nu, nv, j, cv):
    for c in range(3):
        i = 0
        while i < nu:
            k = (c * (nv + 2) + j + 1) * (nu + 2) + i + 1
            F.node[b, F.v + k] = cv * F.node[b, F.q + k] + F.node[b, F.hv + k]
            i = F.after[i]


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
    i = 0
    while i < ni:
        k = (j + 1) * s + i + 1
        e = k + st
        dx = F.node[b, q + e] - F.node[b, q + k]
        dy = F.node[b, q + P + e] - F.node[b, q + P + k]
        dz = F.node[b, q + 2 * P + e] - F.node[b, q + 2 * P + k]
        il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
        F.node[b, t + k] = dx * il
        F.node[b, t + P + k] = dy * il
        F.node[b, t + 2 * P + k] = dz * il
        F.node[b, le + k] = il
        i = F.after[i]
    ih = F.lane[b, IHU] if ti.static(along_u) else F.lane[b, IHV]
    kh = F.lane[b, KH1] if ti.static(along_u) else F.lane[b, KH2]
    A = F.lane[b, AREA]
    kA = kh * A
    quadratic = F.lane[b, Q1] if ti.static(along_u) else F.lane[b, Q2]
    cubic = F.lane[b, R1] if ti.static(along_u) else F.lane[b, R2]
    vA = F.lane[b, VISC] * A * ih
    i = 0
    while i < ni:
        k = (j + 1) * s + i + 1
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
        i = F.after[i]


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
    i = 0
    while i < ni:
        k = (j + 1) * s + i + 1
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
        i = F.after[i]
    if ti.static(along_u):  # the last column carries no edge, and was scratch
        for c in range(3):
            F.node[b, out + c * P + (j + 1) * s + nu] = Lanes(0.0)

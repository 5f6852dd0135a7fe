"""Edges of the grid: strain, tension and viscosity (equations 1 and 2 of docs/model.md), and their forces."""

import taichi as ti

from sim.fields import AREA, IHU, IHV, K12, KH1, KH2, LANES, Q1, Q2, R1, R2, VISC, F
from sim.vectors import difference, dot, load, store

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
def edge_row(b, nu, nv, j, along_u: ti.template()):
    """Tangents, strains and tensions of the edges along u or v that begin in row j."""
    t = ti.static(F.tu if along_u else F.tv)
    inverse = ti.static(F.lu if along_u else F.lv)
    strain = ti.static(F.eu if along_u else F.ev)
    tension = ti.static(F.su if along_u else F.sv)
    s = nu + 2
    P = s * (nv + 2)
    step = 1 if ti.static(along_u) else s
    count = nu - 1 if ti.static(along_u) else nu
    i = 0
    while i < count:
        k = (j + 1) * s + i + 1
        e = k + step
        dx, dy, dz = difference(b, F.q, P, k, e)
        il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
        store(b, t, P, k, dx * il, dy * il, dz * il)
        F.node[b, inverse + k] = il
        i = F.after[i]
    ih = F.lane[b, IHU] if ti.static(along_u) else F.lane[b, IHV]
    kh = F.lane[b, KH1] if ti.static(along_u) else F.lane[b, KH2]
    A = F.lane[b, AREA]
    kA = kh * A
    quadratic = F.lane[b, Q1] if ti.static(along_u) else F.lane[b, Q2]
    cubic = F.lane[b, R1] if ti.static(along_u) else F.lane[b, R2]
    vA = F.lane[b, VISC] * A * ih
    i = 0
    while i < count:
        k = (j + 1) * s + i + 1
        e = k + step
        w = ti.f32(1.0)
        if ti.static(along_u):
            if j == 0 or j == nv - 1:
                w = ti.f32(0.5)
        else:
            if i == 0 or i == nu - 1:
                w = ti.f32(0.5)
        ep = ih / F.node[b, inverse + k] - 1.0
        up = ti.max(ep, 0.0)
        vx, vy, vz = difference(b, F.v, P, k, e)
        tx, ty, tz = load(b, t, P, k)
        r = dot(vx, vy, vz, tx, ty, tz)
        F.node[b, strain + k] = ep
        F.node[b, tension + k] = w * (kA * ep + A * up * up * (quadratic + cubic * up) + vA * r)
        i = F.after[i]


@ti.func
def edge_force_row(b, nu, nv, j, along_u: ti.template()):
    """What these edges pull their nodes with: tension, and the couple of the bending moments."""
    t = ti.static(F.tu if along_u else F.tv)
    inverse = ti.static(F.lu if along_u else F.lv)
    tension = ti.static(F.su if along_u else F.sv)
    moment = ti.static(F.s1 if along_u else F.s2)
    other = ti.static(F.ev if along_u else F.eu)
    out = ti.static(F.pu if along_u else F.pv)
    s = nu + 2
    P = s * (nv + 2)
    step = 1 if ti.static(along_u) else s
    sideways = s if ti.static(along_u) else 1
    count = nu - 1 if ti.static(along_u) else nu
    ih = F.lane[b, IHU] if ti.static(along_u) else F.lane[b, IHV]
    kc = 0.25 * F.lane[b, K12] * F.lane[b, AREA]
    i = 0
    while i < count:
        k = (j + 1) * s + i + 1
        e = k + step
        tx, ty, tz = load(b, t, P, k)
        Mk = F.node[b, moment + k]
        Me = F.node[b, moment + e]
        ax, ay, az = load(b, F.n, P, k)
        bx, by, bz = load(b, F.n, P, e)
        yx = Mk * ax - Me * bx
        yy = Mk * ay - Me * by
        yz = Mk * az - Me * bz
        T = (
            F.node[b, tension + k]
            + kc
            * (
                F.node[b, other + k]
                + F.node[b, other + e]
                + F.node[b, other + k - sideways]
                + F.node[b, other + e - sideways]
            )
        ) * ih
        il = F.node[b, inverse + k]
        along = T - dot(tx, ty, tz, yx, yy, yz) * il
        store(b, out, P, k, along * tx + il * yx, along * ty + il * yy, along * tz + il * yz)
        i = F.after[i]
    if ti.static(along_u):  # the last column carries no edge, and was scratch
        for c in range(3):
            F.node[b, out + c * P + (j + 1) * s + nu] = Lanes(0.0)

"""Edges of the grid: strain, tension and viscosity (equations 1 and 2 of docs/model.md), and their forces."""

import taichi as ti

from sim.forces.stress import relaxed, relaxed_more, stiffer
from sim.kernels.fields import F
from sim.kernels.vectors import Wide, difference, dot, load, store, thrice
from sim.materials import M
from sim.time.scheme import CV

# 1/m in both directions: a bent cloth resists normal motion by its membrane, which is flat here; with more, soft modes
# seem to have converged when they have not
CURVATURE = 7.0


@ti.func
def velocity_row(b, nu, nv, j):
    cv = thrice(F.scheme[b, CV])
    i = 0
    while i < nu:
        k = (j + 1) * (nu + 2) + i + 1
        F.node3[b, F.v + k] = cv * (F.node3[b, F.q + k] - F.node3[b, F.x0 + k]) + F.node3[b, F.hv + k]
        i = F.after[i]


@ti.func
def edge_row(b, nu, nv, j, along_u: ti.template(), stressed: ti.template()):
    """Tangents, strains and tensions of the edges along u or v that begin in row j."""
    t = ti.static(F.tu if along_u else F.tv)
    strain = ti.static(F.eu if along_u else F.ev)
    tension = ti.static(F.su if along_u else F.sv)
    memory = ti.static(F.relaxed_u if along_u else F.relaxed_v)
    successor = ti.static(F.relaxed_u_next if along_u else F.relaxed_v_next)
    s = nu + 2
    step = 1 if ti.static(along_u) else s
    count = nu - 1 if ti.static(along_u) else nu
    ih = F.lane[b, M.IHU] if ti.static(along_u) else F.lane[b, M.IHV]
    kh = F.lane[b, M.K1] if ti.static(along_u) else F.lane[b, M.K2]
    A = F.lane[b, M.AREA]
    kA = kh * A
    quadratic = F.lane[b, M.Q1] if ti.static(along_u) else F.lane[b, M.Q2]
    cubic = F.lane[b, M.R1] if ti.static(along_u) else F.lane[b, M.R2]
    vA = F.lane[b, M.VISCOSITY] * A * ih
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
        dx, dy, dz = difference(b, F.q + k, F.q + e)
        il = 1.0 / ti.sqrt(dot(dx, dy, dz, dx, dy, dz))
        tx, ty, tz = dx * il, dy * il, dz * il
        ep = ih / il - 1.0
        up = ti.max(ep, 0.0)
        vx, vy, vz = difference(b, F.v + k, F.v + e)
        r = dot(vx, vy, vz, tx, ty, tz)
        store(b, t + k, tx, ty, tz)
        F.node[b, strain + k] = ep
        elastic = w * (kA * ep + A * up * up * (quadratic + cubic * up))
        if ti.static(stressed):
            elastic = relaxed(b, memory + k, successor + k, stiffer(b, k, e) * elastic)
        F.node[b, tension + k] = elastic + w * vA * r
        i = F.after[i]


@ti.func
def edge_force_row(b, nu, nv, j, along_u: ti.template(), stressed: ti.template()):
    """Return the forces of these edges on their nodes: tension, and the bending moments of both ends."""
    t = ti.static(F.tu if along_u else F.tv)
    tension = ti.static(F.su if along_u else F.sv)
    moment = ti.static(F.s1 if along_u else F.s2)
    other = ti.static(F.ev if along_u else F.eu)
    out = ti.static(F.pu if along_u else F.pv)
    successor = ti.static(F.relaxed_u_next if along_u else F.relaxed_v_next)
    s = nu + 2
    step = 1 if ti.static(along_u) else s
    sideways = s if ti.static(along_u) else 1
    count = nu - 1 if ti.static(along_u) else nu
    ih = F.lane[b, M.IHU] if ti.static(along_u) else F.lane[b, M.IHV]
    kc = 0.25 * F.lane[b, M.K12] * F.lane[b, M.AREA]
    i = 0
    while i < count:
        k = (j + 1) * s + i + 1
        e = k + step
        tx, ty, tz = load(b, t + k)
        Mk = F.node[b, moment + k]
        Me = F.node[b, moment + e]
        ax, ay, az = load(b, F.n + k)
        bx, by, bz = load(b, F.n + e)
        yx = Mk * ax - Me * bx
        yy = Mk * ay - Me * by
        yz = Mk * az - Me * bz
        ahead = F.node[b, other + k] + F.node[b, other + e]  # of the cells on both sides
        behind = F.node[b, other + k - sideways] + F.node[b, other + e - sideways]
        coupled = kc * (ahead + behind)
        if ti.static(stressed):
            here = stiffer(b, k, e)
            before, after = stiffer(b, k - sideways, e - sideways), stiffer(b, k + sideways, e + sideways)
            coupled = 0.5 * kc * ((here + after) * ahead + (before + here) * behind)
            coupled = relaxed_more(b, successor + k, coupled)
        T = (F.node[b, tension + k] + coupled) * ih
        store(b, out + k, T * tx + ih * yx, T * ty + ih * yy, T * tz + ih * yz)
        i = F.after[i]
    if ti.static(along_u):  # the last column carries no edge, and was scratch
        F.node3[b, out + (j + 1) * s + nu] = Wide(0.0)


@ti.func
def membrane(b):
    """N/m along u, along v and of shear in a step, viscosity included."""
    vis = F.lane[b, M.VISCOSITY] * F.scheme[b, CV]
    return F.lane[b, M.K1] + vis, F.lane[b, M.K2] + vis, F.lane[b, M.S] + 0.5 * vis


@ti.func
def normal_stiffness(b):
    """N/m of a node: what the membrane of a bent cloth resists normal motion with."""
    k1, k2, _ = membrane(b)
    return F.lane[b, M.HU] * F.lane[b, M.HV] * CURVATURE**2 * (k1 + k2)

"""Edges of the grid: strain, tension and viscosity (equations 1 and 2 of docs/model.md), and their forces; its cells:
shear (equation 3) and twist (equation 6)."""

import taichi as ti

from sim.forces.added import relaxed, relaxed_more, stiffer
from sim.kernels.fields import F, indices
from sim.kernels.vectors import Wide, crossed, dotted, thrice
from sim.materials import M
from sim.time_steps import CV

# 1/m in both directions: a bent cloth resists normal motion by its membrane, which is flat here; with more, soft modes
# seem to have converged when they have not
CURVATURE = 7.0


@ti.func
def velocity_row(b, nu, nv, j):
    cv = thrice(F.scheme[b, CV])
    for i in indices(nu):
        k = (j + 1) * (nu + 2) + i + 1
        F.node3[b, F.v + k] = cv * (F.node3[b, F.q + k] - F.node3[b, F.x0 + k]) + F.node3[b, F.hv + k]


@ti.func
def edge_share(nu, nv, i, j, along_u: ti.template()):
    """Share of a cell that an edge stands for: half of one at the cloth's border."""
    w = ti.f32(1.0)
    if ti.static(along_u):
        if j == 0 or j == nv - 1:
            w = ti.f32(0.5)
    else:
        if i == 0 or i == nu - 1:
            w = ti.f32(0.5)
    return w


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
    for i in indices(count):
        k = (j + 1) * s + i + 1
        e = k + step
        w = edge_share(nu, nv, i, j, along_u)
        apart = F.node3[b, F.q + e] - F.node3[b, F.q + k]
        il = 1.0 / ti.sqrt(dotted(apart, apart))
        tangent = thrice(il) * apart
        ep = ih / il - 1.0
        up = ti.max(ep, 0.0)
        r = dotted(F.node3[b, F.v + e] - F.node3[b, F.v + k], tangent)
        F.node3[b, t + k] = tangent
        F.node[b, strain + k] = ep
        elastic = w * (kA * ep + A * up * up * (quadratic + cubic * up))
        if ti.static(stressed):
            elastic = relaxed(b, memory + k, successor + k, stiffer(b, k, e) * elastic)
        F.node[b, tension + k] = elastic + w * vA * r


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
    for i in indices(count):
        k = (j + 1) * s + i + 1
        e = k + step
        mk, me = thrice(F.node[b, moment + k]), thrice(F.node[b, moment + e])
        bending = mk * F.node3[b, F.n + k] - me * F.node3[b, F.n + e]
        ahead = F.node[b, other + k] + F.node[b, other + e]  # of the cells on both sides
        behind = F.node[b, other + k - sideways] + F.node[b, other + e - sideways]
        coupled = kc * (ahead + behind)
        if ti.static(stressed):
            here = stiffer(b, k, e)
            before, after = stiffer(b, k - sideways, e - sideways), stiffer(b, k + sideways, e + sideways)
            coupled = 0.5 * kc * ((here + after) * ahead + (before + here) * behind)
            coupled = relaxed_more(b, successor + k, coupled)
        T = (F.node[b, tension + k] + coupled) * ih
        F.node3[b, out + k] = thrice(T) * F.node3[b, t + k] + thrice(ih) * bending
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


@ti.func
def edge_means(b, k, s):
    """Means of both edges along u, of both along v, and the mixed difference of the cell that begins at entry k."""
    q0 = F.node3[b, k]
    q1 = F.node3[b, k + 1]
    q2 = F.node3[b, k + s]
    q3 = F.node3[b, k + s + 1]
    p = q3 - q0
    m = q1 - q2
    return 0.5 * (p + m), 0.5 * (p - m), (q3 - q1) - (q2 - q0)


@ti.func
def cell_row(b, nu, nv, j, stressed: ti.template()):
    s = nu + 2
    SA = F.lane[b, M.S] * F.lane[b, M.AREA]
    VA = 0.5 * F.lane[b, M.VISCOSITY] * F.lane[b, M.AREA]
    ihh = F.lane[b, M.IHU] * F.lane[b, M.IHV]
    TA = 2.0 * F.lane[b, M.T] * F.lane[b, M.AREA] * ihh * ihh
    free_twist = F.lane[b, M.CURVED12] * F.lane[b, M.AREA]
    for i in indices(nu - 1):
        k = (j + 1) * s + i + 1
        along_u, along_v, mixed = edge_means(b, F.q + k, s)
        aa = dotted(along_u, along_u)
        bb = dotted(along_v, along_v)
        ir = 1.0 / ti.sqrt(aa * bb)
        # gamma = a . b / (|a| |b|) and its gradients
        g = dotted(along_u, along_v) * ir
        by_u = thrice(ir) * along_v - thrice(g * bb * ir * ir) * along_u
        by_v = thrice(ir) * along_u - thrice(g * aa * ir * ir) * along_v
        normal = crossed(along_v, along_u)
        il = 1.0 / ti.sqrt(dotted(normal, normal))
        normal = thrice(il) * normal
        du, dv, _ = edge_means(b, F.v + k, s)
        nd = dotted(normal, mixed)
        shear, moment = SA * g, TA * (nd - free_twist)
        if ti.static(stressed):
            here = 0.5 * (stiffer(b, k, k + 1) + stiffer(b, k + s, k + s + 1))
            shear = relaxed(b, F.relaxed_shear + k, F.relaxed_shear_next + k, here * shear)
            moment = relaxed(b, F.relaxed_twist + k, F.relaxed_twist_next + k, here * moment)
        tau = thrice(-0.5 * (shear + VA * (dotted(by_u, du) + dotted(by_v, dv))))
        # twist couple on the normal, tangential part
        couple = thrice(0.5 * moment * il) * (mixed - thrice(nd) * normal)
        F.node3[b, F.ca + k] = crossed(along_v, couple) + tau * by_u
        F.node3[b, F.cb + k] = crossed(couple, along_u) + tau * by_v
        F.node3[b, F.cd + k] = -thrice(moment) * normal

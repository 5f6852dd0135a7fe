"""How the forces of the cloth change in a direction: sim/forces/cloth.py, differentiated line by line.

The state is that of the last evaluation, at rest (F.q and the planes that it left); the direction is F.p. F.f becomes
the change of the forces.
"""

import taichi as ti

from sim.forces.bending import clamped_edge, clamped_ends, neighbours
from sim.forces.cloth import border, gathered
from sim.forces.membrane import edge_means, edge_share
from sim.grid import EDGES
from sim.kernels.fields import F, T, indices
from sim.kernels.vectors import Wide, crossed, dotted, parts, thrice
from sim.materials import M


@ti.func
def fabric_tangent(b, nu, nv, support):
    """F.f <- the change of the cloth's forces."""
    for j in range(-1, nv + 2):
        if 0 <= j < nv - 1:
            cell_row(b, nu, j)
            edge_row(b, nu, nv, j, False)
        if 0 <= j < nv:
            edge_row(b, nu, nv, j, True)
        if 1 <= j <= nv:
            star_row(b, nu, nv, j - 1)
            edge_force_row(b, nu, j - 1, True)
        if 2 <= j <= nv:
            edge_force_row(b, nu, j - 2, False)
        if j >= 2:
            gather_row(b, nu, nv, j - 2)
    if 0 <= support < EDGES:
        clamp_pass(b, nu, nv, support)


@ti.func
def edge_row(b, nu, nv, j, along_u: ti.template()):
    """Changes of tangents, strains and tensions of the edges along u or v that begin in row j."""
    t = ti.static(F.tu if along_u else F.tv)
    strain = ti.static(F.eu if along_u else F.ev)
    d_t = ti.static(T.d_tu if along_u else T.d_tv)
    d_strain = ti.static(T.d_eu if along_u else T.d_ev)
    d_tension = ti.static(T.d_su if along_u else T.d_sv)
    s = nu + 2
    step = 1 if ti.static(along_u) else s
    count = nu - 1 if ti.static(along_u) else nu
    ih = F.lane[b, M.IHU] if ti.static(along_u) else F.lane[b, M.IHV]
    kh = F.lane[b, M.K1] if ti.static(along_u) else F.lane[b, M.K2]
    A = F.lane[b, M.AREA]
    quadratic = F.lane[b, M.Q1] if ti.static(along_u) else F.lane[b, M.Q2]
    cubic = F.lane[b, M.R1] if ti.static(along_u) else F.lane[b, M.R2]
    for i in indices(count):
        k = (j + 1) * s + i + 1
        e = k + step
        w = edge_share(nu, nv, i, j, along_u)
        tangent = F.node3[b, t + k]
        ep = F.node[b, strain + k]
        il = ih / (1.0 + ep)
        change = F.node3[b, F.p + e] - F.node3[b, F.p + k]
        longer = dotted(tangent, change)
        up = ti.max(ep, 0.0)
        stretch = ih * longer
        tension = A * (kh + up * (2.0 * quadratic + 3.0 * cubic * up)) * stretch
        T.node3[b, d_t + k] = (change - thrice(longer) * tangent) * thrice(il)
        T.node[b, d_strain + k] = stretch
        T.node[b, d_tension + k] = w * tension


@ti.func
def edge_force_row(b, nu, j, along_u: ti.template()):
    """Changes of what these edges pull their nodes with."""
    t = ti.static(F.tu if along_u else F.tv)
    tension = ti.static(F.su if along_u else F.sv)
    moment = ti.static(F.s1 if along_u else F.s2)
    other = ti.static(F.ev if along_u else F.eu)
    d_t = ti.static(T.d_tu if along_u else T.d_tv)
    d_tension = ti.static(T.d_su if along_u else T.d_sv)
    d_moment = ti.static(T.d_s1 if along_u else T.d_s2)
    d_other = ti.static(T.d_ev if along_u else T.d_eu)
    out = ti.static(F.pu if along_u else F.pv)
    s = nu + 2
    step = 1 if ti.static(along_u) else s
    sideways = s if ti.static(along_u) else 1
    count = nu - 1 if ti.static(along_u) else nu
    ih = F.lane[b, M.IHU] if ti.static(along_u) else F.lane[b, M.IHV]
    kc = 0.25 * F.lane[b, M.K12] * F.lane[b, M.AREA]
    for i in indices(count):
        k = (j + 1) * s + i + 1
        e = k + step
        # values beyond the border are zero: ghosts of F, and of T, which nothing writes
        around = (F.node[b, other + k] + F.node[b, other + e]) + (
            F.node[b, other + k - sideways] + F.node[b, other + e - sideways]
        )
        d_around = (T.node[b, d_other + k] + T.node[b, d_other + e]) + (
            T.node[b, d_other + k - sideways] + T.node[b, d_other + e - sideways]
        )
        pull = thrice((F.node[b, tension + k] + kc * around) * ih)
        d_pull = thrice((T.node[b, d_tension + k] + kc * d_around) * ih)
        mk = thrice(ih * F.node[b, moment + k])
        me = thrice(ih * F.node[b, moment + e])
        d_mk = thrice(ih * T.node[b, d_moment + k])
        d_me = thrice(ih * T.node[b, d_moment + e])
        F.node3[b, out + k] = (d_pull * F.node3[b, t + k] + pull * T.node3[b, d_t + k]) + (
            (d_mk * F.node3[b, F.n + k] + mk * T.node3[b, T.d_n + k])
            - (d_me * F.node3[b, F.n + e] + me * T.node3[b, T.d_n + e])
        )
    if ti.static(along_u):  # the last column carries no edge, and was scratch
        F.node3[b, out + (j + 1) * s + nu] = Wide(0.0)


@ti.func
def star_row(b, nu, nv, j):
    """Changes of node normals, bending moments, and the moments' couples on the normal."""
    s = nu + 2
    for i in indices(nu):
        k = (j + 1) * s + i + 1
        w, e, n, d, has1, has2, wt = neighbours(nu, nv, i, j)
        hh = has1 * has2
        along_u = F.node3[b, F.q + e] - F.node3[b, F.q + w]
        along_v = F.node3[b, F.q + d] - F.node3[b, F.q + n]
        d_u = F.node3[b, F.p + e] - F.node3[b, F.p + w]
        d_v = F.node3[b, F.p + d] - F.node3[b, F.p + n]
        normal = F.node3[b, F.n + k]
        il = 1.0 / dotted(crossed(along_v, along_u), normal)
        d_area = (crossed(d_v, along_u) + crossed(along_v, d_u)) * thrice(il)
        larger = dotted(d_area, normal)  # relative change of the area
        d_normal = d_area - thrice(larger) * normal
        T.node3[b, T.d_n + k] = d_normal
        x = F.node3[b, F.q + k]
        turn_u = thrice(F.lane[b, M.IHU]) * ((F.node3[b, F.q + e] - x) - (x - F.node3[b, F.q + w]))
        turn_v = thrice(F.lane[b, M.IHV]) * ((F.node3[b, F.q + d] - x) - (x - F.node3[b, F.q + n]))
        x = F.node3[b, F.p + k]
        more_u = thrice(F.lane[b, M.IHU]) * ((F.node3[b, F.p + e] - x) - (x - F.node3[b, F.p + w]))
        more_v = thrice(F.lane[b, M.IHV]) * ((F.node3[b, F.p + d] - x) - (x - F.node3[b, F.p + n]))
        k1 = dotted(d_normal, turn_u) + dotted(normal, more_u)
        k2 = dotted(d_normal, turn_v) + dotted(normal, more_v)
        A = F.lane[b, M.AREA] * wt
        ihu = F.lane[b, M.IHU]
        ihv = F.lane[b, M.IHV]
        both = hh * ihu * F.lane[b, M.D12] * ihv
        D1 = (has1 * F.lane[b, M.B1] + hh * (F.lane[b, M.D1] - F.lane[b, M.B1])) * ihu * ihu
        D2 = (has2 * F.lane[b, M.B2] + hh * (F.lane[b, M.D2] - F.lane[b, M.B2])) * ihv * ihv
        G1 = (D1 * k1 + both * k2) * A
        G2 = (D2 * k2 + both * k1) * A
        T.node[b, T.d_s1 + k] = G1
        T.node[b, T.d_s2 + k] = G2
        # couple c = (m - (m . n) n) / |area| and its change
        M1 = thrice(F.node[b, F.s1 + k])
        M2 = thrice(F.node[b, F.s2 + k])
        turning = M1 * turn_u + M2 * turn_v
        d_turning = thrice(G1) * turn_u + M1 * more_u + thrice(G2) * turn_v + M2 * more_v
        along = dotted(turning, normal)
        d_along = dotted(turning, d_normal) + dotted(d_turning, normal)
        couple = (turning - thrice(along) * normal) * thrice(il)
        d_couple = (
            (d_turning - thrice(d_along) * normal - thrice(along) * d_normal) * thrice(il)
            - thrice(larger) * couple
        )  # fmt: skip
        F.node3[b, F.na + k] = crossed(d_v, couple) + crossed(along_v, d_couple)
        F.node3[b, F.nb + k] = crossed(d_couple, along_u) + crossed(couple, d_u)


@ti.func
def cell_row(b, nu, j):
    """Changes of the forces of shear and twist of the cells in row j."""
    s = nu + 2
    SA = F.lane[b, M.S] * F.lane[b, M.AREA]
    ihh = F.lane[b, M.IHU] * F.lane[b, M.IHV]
    TA = 2.0 * F.lane[b, M.T] * F.lane[b, M.AREA] * ihh * ihh
    free_twist = F.lane[b, M.CURVED12] * F.lane[b, M.AREA]
    for i in indices(nu - 1):
        k = (j + 1) * s + i + 1
        along_u, along_v, mixed = edge_means(b, F.q + k, s)
        d_u, d_v, d_mixed = edge_means(b, F.p + k, s)
        iaa = 1.0 / dotted(along_u, along_u)
        ibb = 1.0 / dotted(along_v, along_v)
        ir = ti.sqrt(iaa * ibb)
        longer_u = dotted(along_u, d_u) * iaa  # relative changes of lengths
        longer_v = dotted(along_v, d_v) * ibb
        d_ir = thrice(-ir * (longer_u + longer_v))
        g = dotted(along_u, along_v) * ir
        d_g = (dotted(d_u, along_v) + dotted(along_u, d_v)) * ir - g * (longer_u + longer_v)
        ga = thrice(g * iaa)
        gb = thrice(g * ibb)
        d_ga = thrice((d_g - 2.0 * g * longer_u) * iaa)
        d_gb = thrice((d_g - 2.0 * g * longer_v) * ibb)
        by_u = thrice(ir) * along_v - ga * along_u
        by_v = thrice(ir) * along_u - gb * along_v
        d_by_u = d_ir * along_v + thrice(ir) * d_v - d_ga * along_u - ga * d_u
        d_by_v = d_ir * along_u + thrice(ir) * d_u - d_gb * along_v - gb * d_v
        tau = thrice(-0.5 * SA * g)
        d_tau = thrice(-0.5 * SA * d_g)
        normal = crossed(along_v, along_u)
        il = 1.0 / ti.sqrt(dotted(normal, normal))
        normal = normal * thrice(il)
        d_area = (crossed(d_v, along_u) + crossed(along_v, d_u)) * thrice(il)
        larger = dotted(d_area, normal)
        d_normal = d_area - thrice(larger) * normal
        nd = dotted(normal, mixed)
        d_nd = dotted(d_normal, mixed) + dotted(normal, d_mixed)
        moment = TA * (nd - free_twist)
        d_moment = TA * d_nd
        mc = 0.5 * moment * il
        d_mc = thrice(0.5 * d_moment * il - mc * larger)
        tangential = mixed - thrice(nd) * normal
        d_couple = d_mc * tangential + thrice(mc) * (d_mixed - thrice(d_nd) * normal - thrice(nd) * d_normal)
        couple = thrice(mc) * tangential
        F.node3[b, F.cd + k] = -thrice(d_moment) * normal - thrice(moment) * d_normal
        F.node3[b, F.ca + k] = crossed(d_v, couple) + crossed(along_v, d_couple) + d_tau * by_u + tau * d_by_u
        F.node3[b, F.cb + k] = crossed(d_couple, along_u) + crossed(couple, d_u) + d_tau * by_v + tau * d_by_v


@ti.func
def gather_row(b, nu, nv, j):
    """F.f = change of the internal forces."""
    s = nu + 2
    for i in indices(nu):
        k = (j + 1) * s + i + 1
        s1, _ = border(i, nu)
        s2, _ = border(j, nv)
        F.node3[b, F.f + k] = gathered(b, k, s, s1, s2)


@ti.func
def clamp_pass(b, nu, nv, support):
    """Change of the clamp's forces on the first edges of the cloth; the held nodes do not move."""
    count, h, width, stiffness, curved = clamped_edge(b, nu, nv, support)
    for i in indices(count):
        k, e, w = clamped_ends(nu, nv, support, count, i)
        apart = F.node3[b, F.q + e] - F.node3[b, F.q + k]
        change = F.node3[b, F.p + e] - F.node3[b, F.p + k]
        il = 1.0 / ti.sqrt(dotted(apart, apart))
        tangent = apart * thrice(il)
        longer = dotted(tangent, change) * il
        tx, ty, tz = parts(tangent)
        rx, ry, rz = parts(change * thrice(il) - thrice(longer) * tangent)
        factor = w * F.lane[b, M.CLAMPED] * stiffness * width * 2.0 / h
        m = factor * (tz - 0.5 * h * curved) * il
        d_m = factor * rz * il - m * longer
        F.node3[b, F.f + e] = F.node3[b, F.f + e] + Wide(
            d_m * tz * tx + m * (rz * tx + tz * rx),
            d_m * tz * ty + m * (rz * ty + tz * ry),
            -d_m * (1.0 - tz * tz) + 2.0 * m * tz * rz,
        )

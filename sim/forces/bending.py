"""Bending of the cloth at its nodes (equations 4 and 5 of docs/model.md) and at a clamp."""

import taichi as ti

from sim.forces.added import relaxed, stiffer
from sim.grid import BOTTOM, LEFT, RIGHT
from sim.kernels.fields import F, indices
from sim.kernels.vectors import Wide, crossed, dotted, parts, thrice
from sim.materials import M


@ti.func
def neighbours(nu, nv, i, j):
    """Entries west, east, north and south of node i of row j, its own at a border; 1 where it has both along u, and
    along v; the share of a cell that it stands for."""
    s = nu + 2
    k = (j + 1) * s + i + 1
    w = k - 1
    e = k + 1
    n = k - s
    d = k + s
    has1 = ti.f32(1.0)
    has2 = ti.f32(1.0)
    wt = ti.f32(1.0)
    if i == 0 or i == nu - 1:
        has1 = ti.f32(0.0)
        wt *= 0.5
    if j == 0 or j == nv - 1:
        has2 = ti.f32(0.0)
        wt *= 0.5
    if i == 0:
        w = k
    if i == nu - 1:
        e = k
    if j == 0:
        n = k
    if j == nv - 1:
        d = k
    return w, e, n, d, has1, has2, wt


@ti.func
def star_row(b, nu, nv, j, stressed: ti.template()):
    """node normals, curvatures, bending moments, and the moments' couples on the normal"""
    s = nu + 2
    for i in indices(nu):
        k = (j + 1) * s + i + 1
        w, e, n, d, has1, has2, wt = neighbours(nu, nv, i, j)
        hh = has1 * has2
        along_u = F.node3[b, F.q + e] - F.node3[b, F.q + w]
        along_v = F.node3[b, F.q + d] - F.node3[b, F.q + n]
        normal = crossed(along_v, along_u)
        il = 1.0 / ti.sqrt(dotted(normal, normal))
        normal = thrice(il) * normal
        # second differences over h, edge by edge: neighbours lie close, so that their difference is exact
        x = F.node3[b, F.q + k]
        turn_u = thrice(F.lane[b, M.IHU]) * ((F.node3[b, F.q + e] - x) - (x - F.node3[b, F.q + w]))
        turn_v = thrice(F.lane[b, M.IHV]) * ((F.node3[b, F.q + d] - x) - (x - F.node3[b, F.q + n]))
        # curvatures times h, beyond those of the free cloth
        k1 = dotted(normal, turn_u) - F.lane[b, M.CURVED1] * F.lane[b, M.HU]
        k2 = dotted(normal, turn_v) - F.lane[b, M.CURVED2] * F.lane[b, M.HV]
        A = F.lane[b, M.AREA] * wt
        M1 = (
            F.lane[b, M.IHU]
            * (has1 * F.lane[b, M.B1] + hh * (F.lane[b, M.D1] - F.lane[b, M.B1]))
            * k1
            * F.lane[b, M.IHU]
            + hh * F.lane[b, M.IHU] * F.lane[b, M.D12] * F.lane[b, M.IHV] * k2
        ) * A
        M2 = (
            F.lane[b, M.IHV]
            * (has2 * F.lane[b, M.B2] + hh * (F.lane[b, M.D2] - F.lane[b, M.B2]))
            * k2
            * F.lane[b, M.IHV]
            + hh * F.lane[b, M.IHV] * F.lane[b, M.D12] * F.lane[b, M.IHU] * k1
        ) * A
        if ti.static(stressed):
            here = stiffer(b, k, k)
            M1 = relaxed(b, F.relaxed_1 + k, F.relaxed_1_next + k, here * M1)
            M2 = relaxed(b, F.relaxed_2 + k, F.relaxed_2_next + k, here * M2)
        F.node[b, F.s1 + k] = M1
        F.node[b, F.s2 + k] = M2
        # couple on the normal, tangential part
        turning = thrice(M1) * turn_u + thrice(M2) * turn_v
        couple = (turning - thrice(dotted(turning, normal)) * normal) * thrice(il)
        F.node3[b, F.n + k] = normal
        F.node3[b, F.na + k] = crossed(along_v, couple)
        F.node3[b, F.nb + k] = crossed(couple, along_u)


@ti.func
def clamp_pass(b, nu, nv, support, stressed: ti.template()):
    """Half a cell of bending between the held normal (0, 0, 1) of a clamped edge and the first edges of the cloth."""
    count, h, width, stiffness, curved = clamped_edge(b, nu, nv, support)
    for i in indices(count):
        k, e, w = clamped_ends(nu, nv, support, count, i)
        dx, dy, dz = parts(F.node3[b, F.q + e] - F.node3[b, F.q + k])
        il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
        tz = dz * il
        m = w * F.lane[b, M.CLAMPED] * stiffness * width * 2.0 / h * (tz - 0.5 * h * curved)
        if ti.static(stressed):
            m = relaxed(b, F.relaxed_clamp + k, F.relaxed_clamp_next + k, stiffer(b, k, k) * m)
        m *= il
        F.node3[b, F.f + e] = F.node3[b, F.f + e] + Wide(m * tz * dx * il, m * tz * dy * il, -m * (1.0 - tz * tz))


@ti.func
def clamped_edge(b, nu, nv, support):
    """Nodes of a clamped edge, spacings away from it and along it [m], B [N m], the free cloth's curvature [1/m]."""
    count = nu
    h = F.lane[b, M.HV]
    width = F.lane[b, M.HU]
    stiffness = F.lane[b, M.B2]
    curved = F.lane[b, M.CURVED2]
    if support > BOTTOM:
        count = nv
        h = F.lane[b, M.HU]
        width = F.lane[b, M.HV]
        stiffness = F.lane[b, M.B1]
        curved = F.lane[b, M.CURVED1]
    return count, h, width, stiffness, curved


@ti.func
def clamped_ends(nu, nv, support, count, i):
    """Node i of a clamped edge, its neighbour in the cloth, and its share of a node's width: half at the ends."""
    s = nu + 2
    k = s + i + 1
    e = k + s
    if support == BOTTOM:
        k = nv * s + i + 1
        e = k - s
    if support == LEFT:
        k = (i + 1) * s + 1
        e = k + 1
    if support == RIGHT:
        k = (i + 1) * s + nu
        e = k - 1
    w = ti.f32(1.0)
    if i == 0 or i == count - 1:
        w = 0.5
    return k, e, w


@ti.func
def bending_down(b):
    """N/m of second differences along v, between the edges and, beside it, of a clamped top edge."""
    hu = F.lane[b, M.HU]
    ihv = F.lane[b, M.IHV]
    bend = hu * F.lane[b, M.D2] * ihv * ihv * ihv
    clamp = F.lane[b, M.TOP_HELD] * F.lane[b, M.CLAMPED] * 2.0 * hu * F.lane[b, M.B2] * ihv * ihv * ihv
    return bend, clamp

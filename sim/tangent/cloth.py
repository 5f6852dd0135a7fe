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
from sim.kernels.vectors import Wide, cross, difference, dot, load, parts, store, thrice
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
        tx, ty, tz = load(b, t + k)
        ep = F.node[b, strain + k]
        il = ih / (1.0 + ep)
        px, py, pz = difference(b, F.p + k, F.p + e)
        longer = dot(tx, ty, tz, px, py, pz)
        dx, dy, dz = (px - longer * tx) * il, (py - longer * ty) * il, (pz - longer * tz) * il
        up = ti.max(ep, 0.0)
        stretch = ih * longer
        tension = A * (kh + up * (2.0 * quadratic + 3.0 * cubic * up)) * stretch
        T.node3[b, d_t + k] = Wide(dx, dy, dz)
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
        ax, ay, az = difference(b, F.q + w, F.q + e)
        bx, by, bz = difference(b, F.q + n, F.q + d)
        gx, gy, gz = difference(b, F.p + w, F.p + e)
        hx, hy, hz = difference(b, F.p + n, F.p + d)
        nx, ny, nz = load(b, F.n + k)
        cx, cy, cz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / dot(cx, cy, cz, nx, ny, nz)
        cx, cy, cz = cross(hx, hy, hz, ax, ay, az)
        ex, ey, ez = cross(bx, by, bz, gx, gy, gz)
        cx, cy, cz = (cx + ex) * il, (cy + ey) * il, (cz + ez) * il
        larger = dot(cx, cy, cz, nx, ny, nz)  # relative change of the area
        cx, cy, cz = cx - larger * nx, cy - larger * ny, cz - larger * nz
        T.node3[b, T.d_n + k] = Wide(cx, cy, cz)
        x = F.node3[b, F.q + k]
        turn_u = thrice(F.lane[b, M.IHU]) * ((F.node3[b, F.q + e] - x) - (x - F.node3[b, F.q + w]))
        turn_v = thrice(F.lane[b, M.IHV]) * ((F.node3[b, F.q + d] - x) - (x - F.node3[b, F.q + n]))
        x = F.node3[b, F.p + k]
        more_u = thrice(F.lane[b, M.IHU]) * ((F.node3[b, F.p + e] - x) - (x - F.node3[b, F.p + w]))
        more_v = thrice(F.lane[b, M.IHV]) * ((F.node3[b, F.p + d] - x) - (x - F.node3[b, F.p + n]))
        ux, uy, uz = parts(turn_u)
        vx, vy, vz = parts(turn_v)
        px, py, pz = parts(more_u)
        qx, qy, qz = parts(more_v)
        k1 = dot(cx, cy, cz, ux, uy, uz) + dot(nx, ny, nz, px, py, pz)
        k2 = dot(cx, cy, cz, vx, vy, vz) + dot(nx, ny, nz, qx, qy, qz)
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
        M1 = F.node[b, F.s1 + k]
        M2 = F.node[b, F.s2 + k]
        mx, my, mz = M1 * ux + M2 * vx, M1 * uy + M2 * vy, M1 * uz + M2 * vz
        along = dot(mx, my, mz, nx, ny, nz)
        d_along = dot(mx, my, mz, cx, cy, cz)
        ox, oy, oz = (mx - along * nx) * il, (my - along * ny) * il, (mz - along * nz) * il
        mx, my, mz = (
            G1 * ux + M1 * px + G2 * vx + M2 * qx,
            G1 * uy + M1 * py + G2 * vy + M2 * qy,
            G1 * uz + M1 * pz + G2 * vz + M2 * qz,
        )
        d_along += dot(mx, my, mz, nx, ny, nz)
        rx = (mx - d_along * nx - along * cx) * il - larger * ox
        ry = (my - d_along * ny - along * cy) * il - larger * oy
        rz = (mz - d_along * nz - along * cz) * il - larger * oz
        cx, cy, cz = cross(hx, hy, hz, ox, oy, oz)
        ex, ey, ez = cross(bx, by, bz, rx, ry, rz)
        store(b, F.na + k, cx + ex, cy + ey, cz + ez)
        cx, cy, cz = cross(rx, ry, rz, ax, ay, az)
        ex, ey, ez = cross(ox, oy, oz, gx, gy, gz)
        store(b, F.nb + k, cx + ex, cy + ey, cz + ez)


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
        more_u, more_v, more_mixed = edge_means(b, F.p + k, s)
        ax, ay, az = parts(along_u)
        bx, by, bz = parts(along_v)
        px, py, pz = parts(more_u)
        qx, qy, qz = parts(more_v)
        iaa = 1.0 / dot(ax, ay, az, ax, ay, az)
        ibb = 1.0 / dot(bx, by, bz, bx, by, bz)
        ir = ti.sqrt(iaa * ibb)
        longer_u = dot(ax, ay, az, px, py, pz) * iaa  # relative changes of lengths
        longer_v = dot(bx, by, bz, qx, qy, qz) * ibb
        d_ir = -ir * (longer_u + longer_v)
        g = dot(ax, ay, az, bx, by, bz) * ir
        d_g = (dot(px, py, pz, bx, by, bz) + dot(ax, ay, az, qx, qy, qz)) * ir - g * (longer_u + longer_v)
        ga = g * iaa
        gb = g * ibb
        d_ga = (d_g - 2.0 * g * longer_u) * iaa
        d_gb = (d_g - 2.0 * g * longer_v) * ibb
        gx, gy, gz = ir * bx - ga * ax, ir * by - ga * ay, ir * bz - ga * az
        hx, hy, hz = ir * ax - gb * bx, ir * ay - gb * by, ir * az - gb * bz
        d_gx = d_ir * bx + ir * qx - d_ga * ax - ga * px
        d_gy = d_ir * by + ir * qy - d_ga * ay - ga * py
        d_gz = d_ir * bz + ir * qz - d_ga * az - ga * pz
        d_hx = d_ir * ax + ir * px - d_gb * bx - gb * qx
        d_hy = d_ir * ay + ir * py - d_gb * by - gb * qy
        d_hz = d_ir * az + ir * pz - d_gb * bz - gb * qz
        tau = -0.5 * SA * g
        d_tau = -0.5 * SA * d_g
        nx, ny, nz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / ti.sqrt(dot(nx, ny, nz, nx, ny, nz))
        nx, ny, nz = nx * il, ny * il, nz * il
        cx, cy, cz = cross(qx, qy, qz, ax, ay, az)
        ex, ey, ez = cross(bx, by, bz, px, py, pz)
        cx, cy, cz = (cx + ex) * il, (cy + ey) * il, (cz + ez) * il
        larger = dot(cx, cy, cz, nx, ny, nz)
        cx, cy, cz = cx - larger * nx, cy - larger * ny, cz - larger * nz  # change of the normal
        dx, dy, dz = parts(mixed)
        rx, ry, rz = parts(more_mixed)
        nd = dot(nx, ny, nz, dx, dy, dz)
        d_nd = dot(cx, cy, cz, dx, dy, dz) + dot(nx, ny, nz, rx, ry, rz)
        moment = TA * (nd - free_twist)
        d_moment = TA * d_nd
        mc = 0.5 * moment * il
        d_mc = 0.5 * d_moment * il - mc * larger
        ox, oy, oz = dx - nd * nx, dy - nd * ny, dz - nd * nz
        rx = d_mc * ox + mc * (rx - d_nd * nx - nd * cx)
        ry = d_mc * oy + mc * (ry - d_nd * ny - nd * cy)
        rz = d_mc * oz + mc * (rz - d_nd * nz - nd * cz)
        ox, oy, oz = mc * ox, mc * oy, mc * oz
        store(b, F.cd + k, -d_moment * nx - moment * cx, -d_moment * ny - moment * cy, -d_moment * nz - moment * cz)
        cx, cy, cz = cross(qx, qy, qz, ox, oy, oz)
        ex, ey, ez = cross(bx, by, bz, rx, ry, rz)
        store(
            b, F.ca + k,
            cx + ex + d_tau * gx + tau * d_gx, cy + ey + d_tau * gy + tau * d_gy, cz + ez + d_tau * gz + tau * d_gz,
        )  # fmt: skip
        cx, cy, cz = cross(rx, ry, rz, ax, ay, az)
        ex, ey, ez = cross(ox, oy, oz, px, py, pz)
        store(
            b, F.cb + k,
            cx + ex + d_tau * hx + tau * d_hx, cy + ey + d_tau * hy + tau * d_hy, cz + ez + d_tau * hz + tau * d_hz,
        )  # fmt: skip


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
        dx, dy, dz = difference(b, F.q + k, F.q + e)
        px, py, pz = difference(b, F.p + k, F.p + e)
        il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
        tx, ty, tz = dx * il, dy * il, dz * il
        longer = dot(tx, ty, tz, px, py, pz) * il
        rx, ry, rz = px * il - longer * tx, py * il - longer * ty, pz * il - longer * tz
        factor = w * F.lane[b, M.CLAMPED] * stiffness * width * 2.0 / h
        m = factor * (tz - 0.5 * h * curved) * il
        d_m = factor * rz * il - m * longer
        fx, fy, fz = load(b, F.f + e)
        store(
            b, F.f + e,
            fx + d_m * tz * tx + m * (rz * tx + tz * rx),
            fy + d_m * tz * ty + m * (rz * ty + tz * ry),
            fz - d_m * (1.0 - tz * tz) + 2.0 * m * tz * rz,
        )  # fmt: skip

"""Cells of the grid: shear (equation 3 of docs/model.md) and twist (equation 6)."""

import taichi as ti

from sim.fields import AREA, IHU, IHV, SH, TW, VISC, F
from sim.vectors import cross, difference, dot, load, store


@ti.func
def cell_row(b, nu, nv, j):
    s = nu + 2
    P = s * (nv + 2)
    SA = F.lane[b, SH] * F.lane[b, AREA]
    VA = 0.5 * F.lane[b, VISC] * F.lane[b, AREA]
    ihh = F.lane[b, IHU] * F.lane[b, IHV]
    TA = 2.0 * F.lane[b, TW] * F.lane[b, AREA] * ihh * ihh
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
        ku = k + 1
        kv = k + s
        kw = kv + 1
        # diagonals: a1=(p+m)/2, a2=(p-m)/2 with p=x11-x00, m=x10-x01
        px, py, pz = difference(b, F.q, P, k, kw)
        mx, my, mz = difference(b, F.q, P, kv, ku)
        ax = 0.5 * (px + mx)
        ay = 0.5 * (py + my)
        az = 0.5 * (pz + mz)
        bx = 0.5 * (px - mx)
        by = 0.5 * (py - my)
        bz = 0.5 * (pz - mz)
        i1 = 1.0 / ti.sqrt(ax * ax + ay * ay + az * az)
        i2 = 1.0 / ti.sqrt(bx * bx + by * by + bz * bz)
        store(b, F.ca, P, k, ax * i1, ay * i1, az * i1)
        store(b, F.cb, P, k, bx * i2, by * i2, bz * i2)
        F.node[b, F.i1 + k] = i1
        F.node[b, F.i2 + k] = i2
        i = F.after[i]
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
        # shear: gamma = t1.t2, its gradients g1=(t2-gamma t1)/l1, g2
        tx, ty, tz = load(b, F.ca, P, k)
        ux, uy, uz = load(b, F.cb, P, k)
        i1 = F.node[b, F.i1 + k]
        i2 = F.node[b, F.i2 + k]
        g = dot(tx, ty, tz, ux, uy, uz)
        store(b, F.pu, P, k, (ux - g * tx) * i1, (uy - g * ty) * i1, (uz - g * tz) * i1)
        store(b, F.pv, P, k, (tx - g * ux) * i2, (ty - g * uy) * i2, (tz - g * uz) * i2)
        # normal = t2 x t1
        nx, ny, nz = cross(ux, uy, uz, tx, ty, tz)
        il = 1.0 / ti.sqrt(nx * nx + ny * ny + nz * nz)
        store(b, F.na, P, k, nx * il, ny * il, nz * il)
        F.node[b, F.lu + k] = g
        F.node[b, F.lv + k] = il
        i = F.after[i]
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
        ku = k + 1
        kv = k + s
        kw = kv + 1
        px, py, pz = difference(b, F.v, P, k, kw)
        mx, my, mz = difference(b, F.v, P, kv, ku)
        ax, ay, az = load(b, F.pu, P, k)
        bx, by, bz = load(b, F.pv, P, k)
        gp = dot(ax + bx, ay + by, az + bz, px, py, pz)
        gm = dot(ax - bx, ay - by, az - bz, mx, my, mz)
        F.node[b, F.s1 + k] = SA * F.node[b, F.lu + k] + VA * 0.5 * (gp + gm)
        rx, ry, rz = difference(b, F.q, P, ku, kw)
        lx, ly, lz = difference(b, F.q, P, k, kv)
        dx = rx - lx
        dy = ry - ly
        dz = rz - lz
        nx, ny, nz = load(b, F.na, P, k)
        nd = dot(nx, ny, nz, dx, dy, dz)
        F.node[b, F.s2 + k] = TA * nd
        # twist couple on the normal, tangential part
        store(b, F.nb, P, k, TA * nd * (dx - nd * nx), TA * nd * (dy - nd * ny), TA * nd * (dz - nd * nz))
        i = F.after[i]
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
        cx, cy, cz = load(b, F.nb, P, k)
        w1 = F.node[b, F.lv + k] * F.node[b, F.i1 + k]
        w2 = F.node[b, F.lv + k] * F.node[b, F.i2 + k]
        tau = F.node[b, F.s1 + k]
        m = F.node[b, F.s2 + k]
        tx, ty, tz = load(b, F.ca, P, k)
        ux, uy, uz = load(b, F.cb, P, k)
        ax, ay, az = load(b, F.pu, P, k)
        bx, by, bz = load(b, F.pv, P, k)
        ex, ey, ez = cross(ux, uy, uz, cx, cy, cz)
        store(b, F.ca, P, k, 0.5 * (ex * w1 - tau * ax), 0.5 * (ey * w1 - tau * ay), 0.5 * (ez * w1 - tau * az))
        ex, ey, ez = cross(cx, cy, cz, tx, ty, tz)
        store(b, F.cb, P, k, 0.5 * (ex * w2 - tau * bx), 0.5 * (ey * w2 - tau * by), 0.5 * (ez * w2 - tau * bz))
        nx, ny, nz = load(b, F.na, P, k)
        store(b, F.cd, P, k, -m * nx, -m * ny, -m * nz)
        i = F.after[i]

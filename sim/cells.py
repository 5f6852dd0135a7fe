"""Cells of the grid: shear (equation 3 of docs/model.md) and twist (equation 6)."""

import taichi as ti

from sim.fields import AREA, IHU, IHV, SH, TW, VISC, F


@ti.func
def cell_row(b, nu, nv, j, q: ti.template(), v: ti.template()):
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
        i = F.after[i]
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
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
        i = F.after[i]
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
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
        i = F.after[i]
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
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
        i = F.after[i]

"""Cells of the grid: shear (equation 3 of docs/model.md) and twist (equation 6)."""

import taichi as ti

from sim.fields import AREA, IHU, IHV, SH, TW, VISC, F
from sim.vectors import cross, dot, parts, store


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
def cell_row(b, nu, nv, j):
    s = nu + 2
    SA = F.lane[b, SH] * F.lane[b, AREA]
    VA = 0.5 * F.lane[b, VISC] * F.lane[b, AREA]
    ihh = F.lane[b, IHU] * F.lane[b, IHV]
    TA = 2.0 * F.lane[b, TW] * F.lane[b, AREA] * ihh * ihh
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
        along_u, along_v, mixed = edge_means(b, F.q + k, s)
        ax, ay, az = parts(along_u)
        bx, by, bz = parts(along_v)
        i1 = 1.0 / ti.sqrt(dot(ax, ay, az, ax, ay, az))
        i2 = 1.0 / ti.sqrt(dot(bx, by, bz, bx, by, bz))
        tx, ty, tz = ax * i1, ay * i1, az * i1
        ux, uy, uz = bx * i2, by * i2, bz * i2
        # gamma = t . u and its gradients
        g = dot(tx, ty, tz, ux, uy, uz)
        gx, gy, gz = (ux - g * tx) * i1, (uy - g * ty) * i1, (uz - g * tz) * i1
        hx, hy, hz = (tx - g * ux) * i2, (ty - g * uy) * i2, (tz - g * uz) * i2
        nx, ny, nz = cross(ux, uy, uz, tx, ty, tz)
        il = 1.0 / ti.sqrt(dot(nx, ny, nz, nx, ny, nz))
        nx, ny, nz = nx * il, ny * il, nz * il
        du, dv, _ = edge_means(b, F.v + k, s)
        wx, wy, wz = parts(du)
        yx, yy, yz = parts(dv)
        tau = SA * g + VA * (dot(gx, gy, gz, wx, wy, wz) + dot(hx, hy, hz, yx, yy, yz))
        dx, dy, dz = parts(mixed)
        nd = dot(nx, ny, nz, dx, dy, dz)
        moment = TA * nd
        # twist couple on the normal, tangential part
        cx, cy, cz = moment * (dx - nd * nx), moment * (dy - nd * ny), moment * (dz - nd * nz)
        w1 = il * i1
        w2 = il * i2
        ex, ey, ez = cross(ux, uy, uz, cx, cy, cz)
        store(b, F.ca + k, 0.5 * (ex * w1 - tau * gx), 0.5 * (ey * w1 - tau * gy), 0.5 * (ez * w1 - tau * gz))
        ex, ey, ez = cross(cx, cy, cz, tx, ty, tz)
        store(b, F.cb + k, 0.5 * (ex * w2 - tau * hx), 0.5 * (ey * w2 - tau * hy), 0.5 * (ez * w2 - tau * hz))
        store(b, F.cd + k, -moment * nx, -moment * ny, -moment * nz)
        i = F.after[i]

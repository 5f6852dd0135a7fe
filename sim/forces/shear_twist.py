"""Cells of the grid: shear (equation 3 of docs/model.md) and twist (equation 6)."""

import taichi as ti

from sim.forces.stress import relaxed, stiffer
from sim.kernels.fields import F
from sim.kernels.vectors import cross, dot, parts, store
from sim.materials import M


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
    i = 0
    while i < nu - 1:
        k = (j + 1) * s + i + 1
        along_u, along_v, mixed = edge_means(b, F.q + k, s)
        ax, ay, az = parts(along_u)
        bx, by, bz = parts(along_v)
        aa = dot(ax, ay, az, ax, ay, az)
        bb = dot(bx, by, bz, bx, by, bz)
        ir = 1.0 / ti.sqrt(aa * bb)
        # gamma = a . b / (|a| |b|) and its gradients
        g = dot(ax, ay, az, bx, by, bz) * ir
        ga = g * bb * ir * ir
        gb = g * aa * ir * ir
        gx, gy, gz = ir * bx - ga * ax, ir * by - ga * ay, ir * bz - ga * az
        hx, hy, hz = ir * ax - gb * bx, ir * ay - gb * by, ir * az - gb * bz
        nx, ny, nz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / ti.sqrt(dot(nx, ny, nz, nx, ny, nz))
        nx, ny, nz = nx * il, ny * il, nz * il
        du, dv, _ = edge_means(b, F.v + k, s)
        wx, wy, wz = parts(du)
        yx, yy, yz = parts(dv)
        dx, dy, dz = parts(mixed)
        nd = dot(nx, ny, nz, dx, dy, dz)
        shear, moment = SA * g, TA * (nd - free_twist)
        if ti.static(stressed):
            here = 0.5 * (stiffer(b, k, k + 1) + stiffer(b, k + s, k + s + 1))
            shear = relaxed(b, F.relaxed_shear + k, F.relaxed_shear_next + k, here * shear)
            moment = relaxed(b, F.relaxed_twist + k, F.relaxed_twist_next + k, here * moment)
        tau = -0.5 * (shear + VA * (dot(gx, gy, gz, wx, wy, wz) + dot(hx, hy, hz, yx, yy, yz)))
        # twist couple on the normal, tangential part
        mc = 0.5 * moment * il
        cx, cy, cz = mc * (dx - nd * nx), mc * (dy - nd * ny), mc * (dz - nd * nz)
        ex, ey, ez = cross(bx, by, bz, cx, cy, cz)
        store(b, F.ca + k, ex + tau * gx, ey + tau * gy, ez + tau * gz)
        ex, ey, ez = cross(cx, cy, cz, ax, ay, az)
        store(b, F.cb + k, ex + tau * hx, ey + tau * hy, ez + tau * hz)
        store(b, F.cd + k, -moment * nx, -moment * ny, -moment * nz)
        i = F.after[i]

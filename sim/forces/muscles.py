"""Muscles: fixed points on the cloth, tension of the intervals between them, its force on the nodes.

Equations 7-10 of docs/model.md.
"""

import taichi as ti

from sim.kernels.fields import CONTRACTION_STEP, FIRST_CONTRACTION, LANES, PRESSURE_STEP, TABLE, F, X, indices
from sim.kernels.vectors import (
    Lanes,
    Wide,
    cross,
    dot,
    exchange,
    load_point,
    parts,
    store_point,
    sum3,
    thrice,
    weigh_across,
    weigh_rows,
)
from sim.state import PATCH
from sim.time_steps import CV


@ti.func
def sample(b, nu, npt, first, second, planes, dst):
    """Vectors of the plane `first` of F.node3 at the fixed points, with 2 planes also those of `second`: values and
    derivatives along u and v to three planes of F.point3 each, from dst on. Loops for what is written once: a kernel
    loads the faster."""
    for pt in indices(npt):
        for plane in indices(planes):
            exchange(b, nu, pt, first + plane * (second - first), False)
            for r in indices(F.touched[1]):
                for along_u in indices(2):
                    weigh_across(b, X.wu + along_u * (X.du - X.wu) + PATCH * pt, r, along_u * PATCH + r)
            for derivative in indices(3):  # none, along u, along v
                weights = X.wv + derivative // 2 * (X.dv - X.wv) + PATCH * pt
                weigh_rows(b, weights, derivative % 2 * PATCH, dst + (3 * plane + derivative) * F.points + pt)


@ti.func
def points_pos(b, npt):
    """Positions and normals of the fixed points, from the cloth's below."""
    for pt in indices(npt):
        ax, ay, az = load_point(b, X.tan_u + pt)
        bx, by, bz = load_point(b, X.tan_v + pt)
        cx, cy, cz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / ti.sqrt(dot(cx, cy, cz, cx, cy, cz))
        normal = Wide(cx * il, cy * il, cz * il)
        F.point[b, X.inv_area + pt] = il
        F.point3[b, X.normal + pt] = normal
        F.point3[b, X.pos + pt] = F.point3[b, X.pos + pt] + thrice(F.point[b, X.offset + pt]) * normal


@ti.func
def points_rate(b, npt):
    """Velocities of the fixed points, from the cloth's below."""
    for pt in indices(npt):
        ax, ay, az = load_point(b, X.tan_u + pt)
        bx, by, bz = load_point(b, X.tan_v + pt)
        ex, ey, ez = load_point(b, X.vel_u + pt)
        gx, gy, gz = load_point(b, X.vel_v + pt)
        cx, cy, cz = cross(gx, gy, gz, ax, ay, az)
        dx, dy, dz = cross(bx, by, bz, ex, ey, ez)
        plane = thrice(F.point[b, X.inv_area + pt]) * Wide(cx + dx, cy + dy, cz + dz)
        normal = F.point3[b, X.normal + pt]
        tangential = plane - thrice(sum3(plane * normal)) * normal
        F.point3[b, X.vel + pt] = F.point3[b, X.vel + pt] + thrice(F.point[b, X.offset + pt]) * tangential


@ti.func
def spread(b, nu, npt, dst):
    """adds the fixed points' forces to the nodes"""
    for pt in indices(npt):
        force = F.point3[b, X.force + pt]
        normal = F.point3[b, X.normal + pt]
        lever = thrice(F.point[b, X.offset + pt] * F.point[b, X.inv_area + pt])
        couple = lever * (force - thrice(sum3(force * normal)) * normal)
        tx, ty, tz = parts(couple)
        ax, ay, az = load_point(b, X.tan_u + pt)
        bx, by, bz = load_point(b, X.tan_v + pt)
        cx, cy, cz = cross(tx, ty, tz, bx, by, bz)
        store_point(b, X.grad_u + pt, cx, cy, cz)
        cx, cy, cz = cross(ax, ay, az, tx, ty, tz)
        store_point(b, X.grad_v + pt, cx, cy, cz)
    scatter(b, nu, npt, F.point3, X.force, dst)


@ti.func
def scatter(b, nu, npt, field: ti.template(), plane, dst):
    """Add the fixed points' forces, a plane of the field, and their couples, X.grad_u and X.grad_v, to the nodes' plane
    dst by the weights of their loops."""
    for pt in indices(npt):
        force = field[b, plane + pt]
        along_u = F.point3[b, X.grad_u + pt]
        along_v = F.point3[b, X.grad_v + pt]
        for r in indices(F.touched[1]):
            value = thrice(F.point[b, X.wv + PATCH * pt + r])
            w0 = value * force + thrice(F.point[b, X.dv + PATCH * pt + r]) * along_v
            w1 = value * along_u
            for m in indices(F.touched[0]):
                F.patch3[b, r * PATCH + m] = (
                    thrice(F.point[b, X.wu + PATCH * pt + m]) * w0 + thrice(F.point[b, X.du + PATCH * pt + m]) * w1
                )
        exchange(b, nu, pt, dst, True)


@ti.func
def tension(b, npt, added: ti.template()):
    """Direction, length, contraction, tension and compliance of every interval; X.vel must hold the points' velocity.
    added: forces of effects, by whom the bench law may see less contraction than there is, and by whom more pulls."""
    for k in indices(npt - 1):
        along = F.point3[b, X.pos + k + 1] - F.point3[b, X.pos + k]
        il = 1.0 / ti.sqrt(sum3(along * along) + 1e-16)
        along = along * thrice(il)
        F.point3[b, X.dir + k] = along
        F.point[b, X.eps + k] = 1.0 - 1.0 / (il * F.point[b, X.rest + k])
        stretching = sum3(along * (F.point3[b, X.vel + k + 1] - F.point3[b, X.vel + k]))
        F.point[b, X.rate + k] = -stretching / F.point[b, X.rest + k]
        seen = F.point[b, X.eps + k]
        seen_share = Lanes(1.0)
        for force in ti.static(added):
            if ti.static(callable(force.lent)):
                lent, share = force.lent(b, k)
                seen -= lent
                seen_share -= share
        for lane in indices(LANES):
            x = (seen[lane] - FIRST_CONTRACTION) / CONTRACTION_STEP
            i = ti.min(ti.max(int(x), 0), TABLE[1] - 2)
            f = x - i
            pp = F.point[b, X.pressure + k][lane] / PRESSURE_STEP
            j = ti.min(ti.max(int(pp), 0), TABLE[0] - 2)
            g = pp - j
            ty = F.muscle_type[b, k][lane]
            f0 = F.table[ty, 0, i]
            f1 = F.table[ty, 0, i + 1]
            e0 = (1 - g) * F.table[ty, j, i] + g * F.table[ty, j + 1, i]
            e1 = (1 - g) * F.table[ty, j, i + 1] + g * F.table[ty, j + 1, i + 1]
            h0 = f0 + F.point[b, X.gain + k][lane] * (e0 - f0)
            h1 = f1 + F.point[b, X.gain + k][lane] * (e1 - f1)
            F.point[b, X.tension + k][lane] = h0 + f * (h1 - h0)
            F.point[b, X.compliance + k][lane] = (h0 - h1) / CONTRACTION_STEP
        for force in ti.static(added):
            if ti.static(callable(force.lent)):
                F.point[b, X.compliance + k] = F.point[b, X.compliance + k] * seen_share
            if ti.static(callable(force.tension)):
                more, stiffness = force.tension(b, k)
                F.point[b, X.tension + k] = F.point[b, X.tension + k] + more
                F.point[b, X.compliance + k] = F.point[b, X.compliance + k] + stiffness
        F.point[b, X.tension + k] = F.point[b, X.active + k] * (
            F.point[b, X.tension + k] - F.point[b, X.viscosity + k] * F.point[b, X.rate + k]
        )
        F.point[b, X.compliance + k] = F.point[b, X.rest + k] / (
            F.point[b, X.compliance + k] + F.point[b, X.viscosity + k] * F.scheme[b, CV]
        )


@ti.func
def pull(b, npt, src):
    """Return the forces of tensions on their fixed points."""
    F.point3[b, X.force] = thrice(F.point[b, src]) * F.point3[b, X.dir]
    for k in indices(1, npt):
        F.point3[b, X.force + k] = -thrice(F.point[b, src + k - 1]) * F.point3[b, X.dir + k - 1]
        if k < npt - 1:
            F.point3[b, X.force + k] = F.point3[b, X.force + k] + thrice(F.point[b, src + k]) * F.point3[b, X.dir + k]

"""What two effects change in the cloth's elastic stress: stiffer places, and stress that relaxes.

Each stress s of the cloth (tension of an edge, moments of a node, shear and twist of a cell, equations 2 to 6 of
docs/model.md, without viscosity) becomes (1 + a) s - share q, where dq/dt = ((1 + a) s - q) / time: a is what a place
is stiffer by, share and time are one Prony term's. The pull of the difference, a s - share q, is added to that of s.
A cloth that rests has relaxed.
"""

import taichi as ti

from sim.forces.added import AddedForce
from sim.forces.bending import clamped_edge, clamped_ends
from sim.forces.shear_twist import edge_means
from sim.kernels.fields import LANES, F
from sim.kernels.vectors import Wide, cross, difference, dot, parts, thrice
from sim.materials import Constant, Lane, M
from sim.state import LOADED, REMEMBERED, Plane
from sim.time.scheme import AGES

SHORTEST = 1e-6  # s


@ti.func
def _stressed(b, nu, nv, npt):
    some = 0
    aged = 1.0 - ti.exp(-F.scheme[b, AGES] / ti.max(F.lane[b, M.RELAXED_TIME], SHORTEST))
    lane = 0
    while lane < LANES:
        if F.lane[b, M.STRESSED][lane] != 0.0:
            some = 1
        if F.scheme[b, AGES][lane] == 0.0:  # on the way to where a motion starts
            aged[lane] = 1.0
        lane = F.after[lane]
    if some == 1:  # a block without is not slowed down
        for j in range(nv):
            _edges(b, nu, nv, j, aged, True)
            _nodes(b, nu, nv, j, aged)
            if j < nv - 1:
                _edges(b, nu, nv, j, aged, False)
                _cells(b, nu, j, aged)
        _clamp(b, nu, nv, aged)


@ti.func
def _lost(b, plane, k, stress, aged):
    """What has relaxed of a stress, at the step's end."""
    relaxed = F.node[b, plane + k] + aged * (stress - F.node[b, plane + k])
    return F.lane[b, M.RELAXED_SHARE] * relaxed, relaxed


@ti.func
def _edges(b, nu, nv, j, aged, along_u: ti.template()):
    """Equations 1 and 2, as edge_row and edge_force_row (sim/forces/membrane.py) have them."""
    s = nu + 2
    step = 1 if ti.static(along_u) else s
    sideways = s if ti.static(along_u) else 1
    count = nu - 1 if ti.static(along_u) else nu
    strain = ti.static(F.eu if along_u else F.ev)
    other = ti.static(F.ev if along_u else F.eu)
    tangent = ti.static(F.tu if along_u else F.tv)
    memory = ti.static(F.relaxed_u if along_u else F.relaxed_v)
    successor = ti.static(F.relaxed_u_next if along_u else F.relaxed_v_next)
    ih = F.lane[b, M.IHU] if ti.static(along_u) else F.lane[b, M.IHV]
    A = F.lane[b, M.AREA]
    kA = (F.lane[b, M.K1] if ti.static(along_u) else F.lane[b, M.K2]) * A
    quadratic = F.lane[b, M.Q1] if ti.static(along_u) else F.lane[b, M.Q2]
    cubic = F.lane[b, M.R1] if ti.static(along_u) else F.lane[b, M.R2]
    kc = 0.25 * F.lane[b, M.K12] * A
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
        ep = F.node[b, strain + k]
        up = ti.max(ep, 0.0)
        own = w * (kA * ep + A * up * up * (quadratic + cubic * up))
        ahead = kc * (F.node[b, other + k] + F.node[b, other + e])  # of the cells on both sides
        behind = kc * (F.node[b, other + k - sideways] + F.node[b, other + e - sideways])
        here = 0.5 * (F.node[b, F.stiffer + k] + F.node[b, F.stiffer + e])
        before = 0.5 * (F.node[b, F.stiffer + k - sideways] + F.node[b, F.stiffer + e - sideways])
        after = 0.5 * (F.node[b, F.stiffer + k + sideways] + F.node[b, F.stiffer + e + sideways])
        more = here * own + 0.5 * ((here + after) * ahead + (before + here) * behind)
        lost, relaxed = _lost(b, memory, k, own + ahead + behind + more, aged)
        F.node[b, successor + k] = relaxed
        pull = thrice((more - lost) * ih) * F.node3[b, tangent + k]
        F.node3[b, F.f + k] += pull
        F.node3[b, F.f + e] -= pull
        i = F.after[i]


@ti.func
def _nodes(b, nu, nv, j, aged):
    """Equations 4 and 5: pulls of the moments F.s1 and F.s2, as star_row (sim/forces/bending.py) has them."""
    s = nu + 2
    i = 0
    while i < nu:
        k = (j + 1) * s + i + 1
        w = k - 1 if i > 0 else k
        e = k + 1 if i < nu - 1 else k
        n = k - s if j > 0 else k
        d = k + s if j < nv - 1 else k
        here = F.node[b, F.stiffer + k]
        lost1, relaxed1 = _lost(b, F.relaxed_1, k, (1.0 + here) * F.node[b, F.s1 + k], aged)
        lost2, relaxed2 = _lost(b, F.relaxed_2, k, (1.0 + here) * F.node[b, F.s2 + k], aged)
        F.node[b, F.relaxed_1_next + k] = relaxed1
        F.node[b, F.relaxed_2_next + k] = relaxed2
        m1 = thrice(F.lane[b, M.IHU] * (here * F.node[b, F.s1 + k] - lost1))
        m2 = thrice(F.lane[b, M.IHV] * (here * F.node[b, F.s2 + k] - lost2))
        x = F.node3[b, F.q + k]
        turn = m1 * ((F.node3[b, F.q + e] - x) - (x - F.node3[b, F.q + w]))
        turn += m2 * ((F.node3[b, F.q + d] - x) - (x - F.node3[b, F.q + n]))
        ax, ay, az = difference(b, F.q + w, F.q + e)
        bx, by, bz = difference(b, F.q + n, F.q + d)
        nx, ny, nz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / ti.sqrt(dot(nx, ny, nz, nx, ny, nz))
        normal = Wide(nx * il, ny * il, nz * il)
        nx, ny, nz = parts(normal)
        mx, my, mz = parts(turn)
        along = dot(mx, my, mz, nx, ny, nz)
        cx, cy, cz = (mx - along * nx) * il, (my - along * ny) * il, (mz - along * nz) * il
        px, py, pz = cross(bx, by, bz, cx, cy, cz)
        across = Wide(px, py, pz)
        px, py, pz = cross(cx, cy, cz, ax, ay, az)
        down = Wide(px, py, pz)
        F.node3[b, F.f + k] += 2.0 * (m1 + m2) * normal
        F.node3[b, F.f + w] -= m1 * normal + across
        F.node3[b, F.f + e] -= m1 * normal - across
        F.node3[b, F.f + n] -= m2 * normal + down
        F.node3[b, F.f + d] -= m2 * normal - down
        i = F.after[i]


@ti.func
def _cells(b, nu, j, aged):
    """Equations 3 and 6, as cell_row (sim/forces/shear_twist.py) has them."""
    s = nu + 2
    SA = F.lane[b, M.S] * F.lane[b, M.AREA]
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
        gamma = dot(ax, ay, az, bx, by, bz) * ir
        nx, ny, nz = cross(bx, by, bz, ax, ay, az)
        il = 1.0 / ti.sqrt(dot(nx, ny, nz, nx, ny, nz))
        nx, ny, nz = nx * il, ny * il, nz * il
        dx, dy, dz = parts(mixed)
        nd = dot(nx, ny, nz, dx, dy, dz)
        here = 0.25 * (
            F.node[b, F.stiffer + k]
            + F.node[b, F.stiffer + k + 1]
            + F.node[b, F.stiffer + k + s]
            + F.node[b, F.stiffer + k + s + 1]
        )
        shear, twist = SA * gamma, TA * (nd - free_twist)
        lost_shear, relaxed_shear = _lost(b, F.relaxed_shear, k, (1.0 + here) * shear, aged)
        lost_twist, relaxed_twist = _lost(b, F.relaxed_twist, k, (1.0 + here) * twist, aged)
        F.node[b, F.relaxed_shear_next + k] = relaxed_shear
        F.node[b, F.relaxed_twist_next + k] = relaxed_twist
        tau = -0.5 * (here * shear - lost_shear)
        moment = here * twist - lost_twist
        ga, gb = gamma * bb * ir * ir, gamma * aa * ir * ir
        mc = 0.5 * moment * il
        cx, cy, cz = mc * (dx - nd * nx), mc * (dy - nd * ny), mc * (dz - nd * nz)
        ex, ey, ez = cross(bx, by, bz, cx, cy, cz)
        by_u = Wide(ex + tau * (ir * bx - ga * ax), ey + tau * (ir * by - ga * ay), ez + tau * (ir * bz - ga * az))
        ex, ey, ez = cross(cx, cy, cz, ax, ay, az)
        by_v = Wide(ex + tau * (ir * ax - gb * bx), ey + tau * (ir * ay - gb * by), ez + tau * (ir * az - gb * bz))
        by_mixed = Wide(-moment * nx, -moment * ny, -moment * nz)
        F.node3[b, F.f + k] += by_mixed - by_u - by_v
        F.node3[b, F.f + k + 1] += by_u - by_v - by_mixed
        F.node3[b, F.f + k + s] += by_v - by_u - by_mixed
        F.node3[b, F.f + k + s + 1] += by_u + by_v + by_mixed
        i = F.after[i]


@ti.func
def _clamp(b, nu, nv, aged):
    """Half a cell of bending at a clamped edge, as clamp_pass (sim/forces/bending.py) has it."""
    support = int(F.lane[b, M.CLAMPED_EDGE][0])  # all lanes of a batch are held alike
    if support >= 0:
        count, h, width, stiffness, curved = clamped_edge(b, nu, nv, support)
        i = 0
        while i < count:
            k, e = clamped_ends(nu, nv, support, i)
            w = ti.f32(1.0)
            if i == 0 or i == count - 1:
                w = 0.5
            dx, dy, dz = difference(b, F.q + k, F.q + e)
            il = 1.0 / ti.sqrt(dx * dx + dy * dy + dz * dz)
            tz = dz * il
            moment = w * F.lane[b, M.CLAMPED] * stiffness * width * 2.0 / h * (tz - 0.5 * h * curved)
            here = F.node[b, F.stiffer + k]
            lost, relaxed = _lost(b, F.relaxed_clamp, k, (1.0 + here) * moment, aged)
            F.node[b, F.relaxed_clamp_next + k] = relaxed
            m = (here * moment - lost) * il
            F.node3[b, F.f + e] += Wide(m * tz * dx * il, m * tz * dy * il, -m * (1.0 - tz * tz))
            i = F.after[i]


def _clamped_edge(c: Lane) -> float:
    return float(c.support) if c.fabric.support == "clamped" and c.support.is_edge else -1.0


CLOTH_STRESS = AddedForce(
    cloth=_stressed,
    planes=(
        Plane("stiffer", "node", "1", LOADED, "what its place is stiffer by"),
        Plane("relaxed_u", "edge", "N m", REMEMBERED, "tension along u times area that has relaxed, over the share"),
        Plane("relaxed_v", "edge", "N m", REMEMBERED, "the same along v"),
        Plane("relaxed_1", "node", "N m", REMEMBERED, "of the moment along u times area over spacing"),
        Plane("relaxed_2", "node", "N m", REMEMBERED, "of the moment along v times area over spacing"),
        Plane("relaxed_shear", "cell", "N m", REMEMBERED, "of the shear times area"),
        Plane("relaxed_twist", "cell", "N", REMEMBERED, "of the twist's pull"),
        Plane("relaxed_clamp", "node", "N m", REMEMBERED, "of the moment at a clamped edge times width"),
    ),
    constants={
        "STRESSED": Constant("1", "1 where any of this acts", lambda c: c.constant("stressed")),
        "RELAXED_SHARE": Constant("1", "of the cloth's stress, in the end", lambda c: c.constant("relaxed_share")),
        "RELAXED_TIME": Constant("s", "its time constant", lambda c: c.constant("relaxed_time")),
        "CLAMPED_EDGE": Constant("1", "which edge is clamped (sim/design/support.py), -1: none", _clamped_edge),
    },
)

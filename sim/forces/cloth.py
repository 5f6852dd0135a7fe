"""Forces of the cloth: membrane, shear, twist and bending constraints on the grid.

Equations 1-6 of docs/model.md.
"""

import taichi as ti

from sim.forces.bending import clamp_pass, star_row
from sim.forces.membrane import cell_row, edge_force_row, edge_row, velocity_row
from sim.grid import EDGES
from sim.kernels.fields import F, indices
from sim.kernels.vectors import Wide, thrice
from sim.materials import M
from sim.time_steps import CA, CV


@ti.func
def fabric_force(b, nu, nv, support, stressed: ti.template()):
    """v = cv (q - x0) + hv, and f = forces of the cloth - M a: row by row, each stage as soon as the rows that it
    reads are there, so that they still lie in the cache. stressed: whether effects change its elastic stress."""
    for j in range(-1, nv + 2):
        if j + 1 < nv:
            velocity_row(b, nu, nv, j + 1)
        if 0 <= j < nv - 1:
            cell_row(b, nu, nv, j, stressed)
            edge_row(b, nu, nv, j, False, stressed)
        if 0 <= j < nv:
            edge_row(b, nu, nv, j, True, stressed)
        if 1 <= j <= nv:
            star_row(b, nu, nv, j - 1, stressed)
            edge_force_row(b, nu, nv, j - 1, True, stressed)
        if 2 <= j <= nv:
            edge_force_row(b, nu, nv, j - 2, False, stressed)
        if j >= 2:
            gather_row(b, nu, nv, j - 2)
    if 0 <= support < EDGES:
        clamp_pass(b, nu, nv, support, stressed)


@ti.func
def velocities(b, nu, nv):
    """v = cv (q - x0) + hv"""
    for j in indices(nv):
        velocity_row(b, nu, nv, j)


@ti.func
def border(i, n):
    """-1 at the first of n nodes, 1 at the last, 0 between; and the share of a cell that the node stands for."""
    sign = ti.f32(0.0)
    share = ti.f32(1.0)
    if i == 0:
        sign = ti.f32(-1.0)
        share = ti.f32(0.5)
    if i == n - 1:
        sign = ti.f32(1.0)
        share = ti.f32(0.5)
    return sign, share


@ti.func
def gathered(b, k, s, s1, s2):
    """Sum of the constraints' forces on the node of entry k, in rows of s entries; s1, s2: its signs by `border`."""
    e = F.node3[b, F.pu + k] - F.node3[b, F.pu + k - 1] + F.node3[b, F.pv + k] - F.node3[b, F.pv + k - s]
    m = (
        F.node3[b, F.na + k - 1]
        - F.node3[b, F.na + k + 1]
        + s1 * F.node3[b, F.na + k]
        + F.node3[b, F.nb + k - s]
        - F.node3[b, F.nb + k + s]
        + s2 * F.node3[b, F.nb + k]
    )
    ce = (
        (F.node3[b, F.cd + k] - F.node3[b, F.ca + k] - F.node3[b, F.cb + k])
        + (F.node3[b, F.ca + k - 1] - F.node3[b, F.cb + k - 1] - F.node3[b, F.cd + k - 1])
        + (F.node3[b, F.cb + k - s] - F.node3[b, F.ca + k - s] - F.node3[b, F.cd + k - s])
        + (F.node3[b, F.ca + k - s - 1] + F.node3[b, F.cb + k - s - 1] + F.node3[b, F.cd + k - s - 1])
    )
    return e + m + ce


@ti.func
def gather_row(b, nu, nv, j):
    """f = internal forces + gravity - air damping - M a"""
    s = nu + 2
    g = Wide(F.lane[b, M.GX], F.lane[b, M.GY], F.lane[b, M.GZ])
    ca = thrice(F.scheme[b, CA])
    drag = thrice(F.lane[b, M.AIR] * F.lane[b, M.AREA])
    for i in indices(nu):
        k = (j + 1) * s + i + 1
        s1, w1 = border(i, nu)
        s2, w2 = border(j, nv)
        F.node3[b, F.f + k] = (
            gathered(b, k, s, s1, s2)
            + thrice(F.node[b, F.mass + k])
            * (g - ca * (F.node3[b, F.q + k] - F.node3[b, F.x0 + k]) - F.node3[b, F.ha + k])
            - w1 * w2 * drag * F.node3[b, F.v + k]
            + F.node3[b, F.carried + k]
        )


@ti.func
def inertia(b):
    """N/m of a node: its inertia and the air's drag in a step."""
    mb = F.lane[b, M.MEAN_MASS] * F.scheme[b, CA] + F.lane[b, M.AIR] * F.scheme[b, CV]
    return F.lane[b, M.HU] * F.lane[b, M.HV] * mb

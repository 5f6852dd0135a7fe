"""Friction of the braid: a Maxwell-slip element an interval, a spring that slides at the limit friction(p).

The element's force g resists contraction: g follows limit / slip times the contraction since the step before, clipped
to the limit, which grows with pressure. Iwan 1966, doi:10.1115/1.3625199.
"""

import taichi as ti

from sim.forces.added import AddedForce
from sim.kernels.fields import LANES, F, X
from sim.state import LOADED, REMEMBERED, Plane
from sim.time.scheme import AGES

LEAST_SLIP = 1e-6


@ti.func
def _tension(b, k):
    limit = F.point[b, X.friction_at_zero + k] + F.point[b, X.friction_per_pressure + k] * F.point[b, X.pressure + k]
    stiffness = limit / ti.max(F.point[b, X.friction_slip + k], LEAST_SLIP)
    eps = F.point[b, X.eps + k]
    wanted = F.point[b, X.friction + k] + stiffness * (eps - F.point[b, X.friction_eps + k])
    lane = 0
    while lane < LANES:
        if F.scheme[b, AGES][lane] == 0.0:  # at rest where a motion starts
            wanted[lane] = 0.0
            stiffness[lane] = 0.0
        if ti.abs(wanted[lane]) >= limit[lane]:
            stiffness[lane] = 0.0
        lane = F.after[lane]
    force = ti.min(ti.max(wanted, -limit), limit)
    F.point[b, X.friction_next + k] = force
    F.point[b, X.friction_eps_next + k] = eps
    return -force, stiffness


BRAID_HYSTERESIS = AddedForce(
    tension=_tension,
    planes=(
        Plane("friction_per_pressure", "interval", "N/Pa", LOADED, "Coulomb limit by pressure"),
        Plane("friction_at_zero", "interval", "N", LOADED, "Coulomb limit without pressure"),
        Plane("friction_slip", "interval", "1", LOADED, "contraction until the element slides"),
        Plane("friction", "interval", "N", REMEMBERED, "force of the element, against contraction"),
        Plane("friction_eps", "interval", "1", REMEMBERED, "contraction then"),
    ),
)

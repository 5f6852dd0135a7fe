"""The kernels' parts of effects: added forces (their declarations are in fabdesign/effects)."""

import taichi as ti

from fabdesign.effects.learned import UNIT
from sim.forces.added import AddedForce, aged
from sim.forces.cloth import border
from sim.kernels.fields import LANES, F, X, indices
from sim.kernels.vectors import Lanes, sum3, thrice
from sim.materials import Constant, M
from sim.state import LOADED, REMEMBERED, Plane
from sim.time_steps import AGES, CV

LEAST_SLIP = 1e-6
SOFTEST = 0.9  # of a muscle's own stiffness that may be taken from it
LEAST_WIDTH = 1e-3  # Pa


@ti.func
def _drag(b, nu, nv, npt):
    """Quadratic drag against the normal velocity: -c |v_n| v_n per area, along the normal."""
    area = F.lane[b, M.AIR_DRAG] * F.lane[b, M.AREA]
    for j in range(nv):
        for i in indices(nu):
            k = (j + 1) * (nu + 2) + i + 1
            _, w1 = border(i, nu)
            _, w2 = border(j, nv)
            normal = F.node3[b, F.n + k]
            along = sum3(F.node3[b, F.v + k] * normal)
            F.node3[b, F.f + k] -= thrice(w1 * w2 * area * ti.abs(along) * along) * normal


AIR_DRAG = AddedForce(
    cloth=_drag,
    constants={"AIR_DRAG": Constant("N s^2/m^4", "of quadratic drag", lambda c: c.constant("air_drag"))},
)


@ti.func
def _friction(b, k):
    """Friction of the braid: a Maxwell-slip element an interval, a spring that slides at the limit friction(p).

    The element's force g resists contraction: g follows limit / slip times the contraction since the step before,
    clipped to the limit, which grows with pressure. Iwan 1966, doi:10.1115/1.3625199.
    """
    limit = F.point[b, X.friction_at_zero + k] + F.point[b, X.friction_per_pressure + k] * F.point[b, X.pressure + k]
    stiffness = limit / ti.max(F.point[b, X.friction_slip + k], LEAST_SLIP)
    eps = F.point[b, X.eps + k]
    wanted = F.point[b, X.friction + k] + stiffness * (eps - F.point[b, X.friction_eps + k])
    for lane in indices(LANES):
        if F.scheme[b, AGES][lane] == 0.0:  # at rest where a motion starts
            wanted[lane] = 0.0
            stiffness[lane] = 0.0
        if ti.abs(wanted[lane]) >= limit[lane]:
            stiffness[lane] = 0.0
    force = ti.min(ti.max(wanted, -limit), limit)
    F.point[b, X.friction_next + k] = force
    F.point[b, X.friction_eps_next + k] = eps
    return -force, stiffness


BRAID_HYSTERESIS = AddedForce(
    tension=_friction,
    planes=(
        Plane("friction_per_pressure", "interval", "N/Pa", LOADED, "Coulomb limit by pressure"),
        Plane("friction_at_zero", "interval", "N", LOADED, "Coulomb limit without pressure"),
        Plane("friction_slip", "interval", "1", LOADED, "contraction until the element slides"),
        Plane("friction", "interval", "N", REMEMBERED, "force of the element, against contraction"),
        Plane("friction_eps", "interval", "1", REMEMBERED, "contraction then"),
    ),
)


@ti.func
def _learned(b, k):
    """Tension of muscles that is learned: by contraction, by contraction and pressure, by its rate and pressure."""
    share = F.point[b, X.pressure + k] / UNIT
    along = F.point[b, X.learned_stroke + k] * share + F.point[b, X.learned_spring + k]
    loss = F.point[b, X.learned_rate + k] * share
    slope = F.point[b, X.compliance + k]  # the bench law's slope until all forces have been added
    stiffness = ti.max(loss * F.scheme[b, CV] - along, -SOFTEST * slope)  # the solver divides by both together
    return along * F.point[b, X.eps + k] - loss * F.point[b, X.rate + k], stiffness


LEARNED = AddedForce(
    tension=_learned,
    planes=(
        Plane("learned_stroke", "interval", "N", LOADED, "tension by contraction, at UNIT of pressure"),
        Plane("learned_spring", "interval", "N", LOADED, "tension by contraction"),
        Plane("learned_rate", "interval", "N s", LOADED, "tension lost by the contraction's rate, at UNIT"),
    ),
)


@ti.func
def _lent(b, k):
    """Creep of muscles: a slow contraction z, dz/dt = (share max(eps, 0) - z) / time, that the bench law does not see,
    less the share of it that had crept on the bench already."""
    share = F.point[b, X.creep_share + k]
    follows = aged(b, F.point[b, X.creep_time + k])
    before = F.point[b, X.creep + k]
    limit = share * ti.max(F.point[b, X.eps + k], 0.0)
    crept = before + follows * (limit - before)
    F.point[b, X.creep_next + k] = crept
    on_bench = F.point[b, X.creep_on_bench + k]
    return crept - on_bench * limit, (follows - on_bench) * share


MUSCLE_CREEP = AddedForce(
    lent=_lent,
    planes=(
        Plane("creep_share", "interval", "1", LOADED, "share of the contraction that creeps"),
        Plane("creep_time", "interval", "s", LOADED, "its time constant"),
        Plane("creep_on_bench", "interval", "1", LOADED, "share of it that the bench law has"),
        Plane("creep", "interval", "1", REMEMBERED, "contraction lent by creep"),
    ),
)


@ti.func
def _viscous(b, k):
    """Viscosity of muscles beyond the declared one, with a share of its own for each direction."""
    rate = F.point[b, X.rate + k]
    viscosity = ti.select(rate > 0.0, F.point[b, X.viscosity_contracting + k], F.point[b, X.viscosity_lengthening + k])
    return -viscosity * rate, viscosity * F.scheme[b, CV]


MUSCLE_VISCOSITY = AddedForce(
    tension=_viscous,
    planes=(
        Plane("viscosity_contracting", "interval", "N s", LOADED, "tension lost per contraction rate, contracting"),
        Plane("viscosity_lengthening", "interval", "N s", LOADED, "the same, lengthening"),
    ),
)


@ti.func
def _pressure(b, k):
    """Threshold of a muscle's pressure: p acts as w log(1 + exp((p - threshold) / w))."""
    wanted = F.point[b, X.pressure + k]
    threshold = F.point[b, X.threshold_pressure + k]
    width = ti.max(F.point[b, X.threshold_width + k], LEAST_WIDTH)
    beyond = (wanted - threshold) / width
    # log(1 + exp(x)) = max(x, 0) + log(1 + exp(-|x|))
    acting = width * (ti.max(beyond, 0.0) + ti.log(1.0 + ti.exp(-ti.abs(beyond))))
    return wanted + ti.select(threshold > 0.0, acting - wanted, Lanes(0.0))


THRESHOLD_PRESSURE = AddedForce(
    pressure=_pressure,
    planes=(
        Plane("threshold_pressure", "interval", "Pa", LOADED, "pressure that does nothing"),
        Plane("threshold_width", "interval", "Pa", LOADED, "of the bend there"),
    ),
)

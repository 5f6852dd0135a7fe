"""A muscle slides through its fixed points: length moves from the interval of lower tension to that of higher tension.

At the fixed point between two intervals the excess of the tensions' difference over friction times their mean and grip
moves `mobility` excess L / (DAMPING c) metres a second, c the muscle's viscosity (LEAST_VISCOSITY at least). A step's
slide follows from its tensions and counts from the next step on; in a long step it ends where the excess would.
"""

import taichi as ti

from sim.forces.added import AddedForce
from sim.kernels.fields import F, X
from sim.state import LOADED, REMEMBERED, Plane
from sim.time.scheme import AGES, CV

DAMPING = 6.0
LEAST_VISCOSITY = 2.0  # N s
LEAST_LENGTH = 0.1  # of an interval, that stays in it
SHORT = 1e-3  # of a relaxation: its exponential is of second order


@ti.func
def _lent(b, k):
    """Of length d more, an interval has the contraction 1 - (1 - eps) L / (L + d)."""
    length = F.point[b, X.rest + k]
    more = F.point[b, X.slid + k] - F.point[b, X.slid + ti.min(k + 1, F.points - 1)]
    now = ti.max(length + more, LEAST_LENGTH * length)
    share = 1.0 - length / now
    return -(1.0 - F.point[b, X.eps + k]) * share, share


@ti.func
def _slide(b, nu, nv, npt):
    k = 1
    while k < npt - 1:  # neither the first nor the last fixed point has two intervals
        above, below = F.point[b, X.tension + k - 1], F.point[b, X.tension + k]
        held = 0.5 * F.point[b, X.slip_friction + k] * (ti.abs(above) + ti.abs(below)) + F.point[b, X.slip_grip + k]
        apart = below - above
        excess = ti.max(apart - held, 0.0) + ti.min(apart + held, 0.0)
        length = F.point[b, X.rest + k - 1] + F.point[b, X.slid + k - 1] - F.point[b, X.slid + k]
        damping = DAMPING * ti.max(F.point[b, X.viscosity + k - 1], LEAST_VISCOSITY)
        mobility = F.point[b, X.slip_mobility + k] * length / damping  # m/s per N
        # twice what the excess falls by per metre: neighbours that slide at once do not overshoot
        stiffness = 2.0 * (_stiffness(b, k - 1) + _stiffness(b, k))
        lasting = F.scheme[b, AGES] * mobility * stiffness
        ended = (1.0 - ti.exp(-lasting)) / ti.max(lasting, SHORT)
        moved = F.scheme[b, AGES] * mobility * excess * ti.select(lasting < SHORT, 1.0 - 0.5 * lasting, ended)
        both = F.point[b, X.active + k - 1] * F.point[b, X.active + k]
        F.point[b, X.slid_next + k] = F.point[b, X.slid + k] + both * moved
        k = F.after[k]


@ti.func
def _stiffness(b, k):
    """N/m of an interval's law, from its compliance in the step."""
    viscous = F.point[b, X.viscosity + k] * F.scheme[b, CV] / F.point[b, X.rest + k]
    return ti.max(1.0 / F.point[b, X.compliance + k] - viscous, 0.0)


LOOP_SLIP = AddedForce(
    cloth=_slide,
    lent=_lent,
    planes=(
        Plane("slip_friction", "interval", "1", LOADED, "share of the mean tension that holds at its first point"),
        Plane("slip_grip", "interval", "N", LOADED, "what holds there without tension"),
        Plane("slip_mobility", "interval", "1", LOADED, "of the sliding"),
        Plane("slid", "fixed point", "m", REMEMBERED, "length that went through, from the interval before"),
    ),
)

"""Creep of muscles: a slow contraction z, dz/dt = (share max(eps, 0) - z) / time, that the bench law does not see."""

import taichi as ti

from sim.forces.added import AddedForce
from sim.kernels.fields import F, X
from sim.state import LOADED, REMEMBERED, Plane
from sim.time.scheme import AGES

SHORTEST = 1e-6  # s


@ti.func
def _lent(b, k):
    share = F.point[b, X.creep_share + k]
    aged = 1.0 - ti.exp(-F.scheme[b, AGES] / ti.max(F.point[b, X.creep_time + k], SHORTEST))
    before = F.point[b, X.creep + k]
    lent = before + aged * (share * ti.max(F.point[b, X.eps + k], 0.0) - before)
    F.point[b, X.creep_next + k] = lent
    return lent, aged * share


MUSCLE_CREEP = AddedForce(
    lent=_lent,
    planes=(
        Plane("creep_share", "interval", "1", LOADED, "share of the contraction that creeps"),
        Plane("creep_time", "interval", "s", LOADED, "its time constant"),
        Plane("creep", "interval", "1", REMEMBERED, "contraction lent by creep"),
    ),
)

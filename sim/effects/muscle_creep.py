"""Creep of muscles: a slow contraction z, dz/dt = (share max(eps, 0) - z) / time, that the bench law does not see, less
the share of it that had crept on the bench already."""

import taichi as ti

from sim.forces.added import AddedForce, aged
from sim.kernels.fields import F, X
from sim.state import LOADED, REMEMBERED, Plane


@ti.func
def _lent(b, k):
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

"""Quadratic drag against the normal velocity: -c |v_n| v_n per area, along the normal."""

import taichi as ti

from sim.forces.added import AddedForce
from sim.forces.cloth import border
from sim.kernels.fields import F
from sim.kernels.vectors import sum3, thrice
from sim.materials import Constant, M


@ti.func
def _drag(b, nu, nv, npt):
    area = F.lane[b, M.AIR_DRAG] * F.lane[b, M.AREA]
    for j in range(nv):
        i = 0
        while i < nu:
            k = (j + 1) * (nu + 2) + i + 1
            _, w1 = border(i, nu)
            _, w2 = border(j, nv)
            normal = F.node3[b, F.n + k]
            along = sum3(F.node3[b, F.v + k] * normal)
            F.node3[b, F.f + k] -= thrice(w1 * w2 * area * ti.abs(along) * along) * normal
            i = F.after[i]


AIR_DRAG = AddedForce(
    cloth=_drag,
    constants={"AIR_DRAG": Constant("N s^2/m^4", "of quadratic drag", lambda c: c.constant("air_drag"))},
)

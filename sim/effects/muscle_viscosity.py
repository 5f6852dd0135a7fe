"""Viscosity of muscles beyond the declared one, with a share of its own for each direction."""

import taichi as ti

from sim.forces.added import AddedForce
from sim.kernels.fields import F, X
from sim.state import LOADED, Plane
from sim.time.scheme import CV


@ti.func
def _tension(b, k):
    rate = F.point[b, X.rate + k]
    viscosity = ti.select(rate > 0.0, F.point[b, X.viscosity_contracting + k], F.point[b, X.viscosity_lengthening + k])
    return -viscosity * rate, viscosity * F.scheme[b, CV]


MUSCLE_VISCOSITY = AddedForce(
    tension=_tension,
    planes=(
        Plane("viscosity_contracting", "interval", "N s", LOADED, "tension lost per contraction rate, contracting"),
        Plane("viscosity_lengthening", "interval", "N s", LOADED, "the same, lengthening"),
    ),
)

"""Tension of muscles that is learned: by contraction, by contraction and pressure, by its rate and pressure."""

import taichi as ti

from fabdesign.effects.learned import UNIT
from sim.forces.added import AddedForce
from sim.kernels.fields import F, X
from sim.state import LOADED, Plane
from sim.time.scheme import CV

SOFTEST = 0.9  # of a muscle's own stiffness that may be taken from it


@ti.func
def _tension(b, k):
    share = F.point[b, X.pressure + k] / UNIT
    along = F.point[b, X.learned_stroke + k] * share + F.point[b, X.learned_spring + k]
    loss = F.point[b, X.learned_rate + k] * share
    slope = F.point[b, X.compliance + k]  # the bench law's slope until all forces have been added
    stiffness = ti.max(loss * F.scheme[b, CV] - along, -SOFTEST * slope)  # the solver divides by both together
    return along * F.point[b, X.eps + k] - loss * F.point[b, X.rate + k], stiffness


LEARNED = AddedForce(
    tension=_tension,
    planes=(
        Plane("learned_stroke", "interval", "N", LOADED, "tension by contraction, at UNIT of pressure"),
        Plane("learned_spring", "interval", "N", LOADED, "tension by contraction"),
        Plane("learned_rate", "interval", "N s", LOADED, "tension lost by the contraction's rate, at UNIT"),
    ),
)

"""Threshold of a muscle's pressure: p acts as w log(1 + exp((p - threshold) / w))."""

import taichi as ti

from sim.forces.added import AddedForce
from sim.kernels.fields import F, X
from sim.kernels.vectors import Lanes
from sim.state import LOADED, Plane

LEAST_WIDTH = 1e-3  # Pa


@ti.func
def _pressure(b, k):
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

"""Muscle creep: part of a muscle's contraction comes slowly, and goes slowly."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(muscles, creep_share=values["share"], creep_time=values["time"])


MUSCLE_CREEP = Effect(
    "muscle_creep",
    site="muscle",
    scope="muscle type",
    what="a slow contraction z, dz/dt = (share max(eps, 0) - z) / time, that the bench law does not see: F(p, eps - z)",
    signature="slow extra at hold, slow recovery after; as much for slow and fast ramps once held",
    source="standard linear solid; docs/effects.md",
    parameters={
        "share": EffectParameter("1", "of the contraction, in the end", 0.15, (0.0, 0.8), 0.1, off=0.0),
        "time": EffectParameter("s", "time constant", 0.8, (0.02, 100.0), 0.8, transform="log"),
    },
    specimen=_specimen,
    force="sim.effects.muscle_creep:MUSCLE_CREEP",
    remembers=True,
)

"""Muscle creep: part of a muscle's contraction comes slowly, and goes slowly."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.bench import MuscleRecord
from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(muscles, creep_share=values["share"], creep_time=values["time"])


def _bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["share"] * np.maximum(record.contraction, 0.0)
    aged = -np.expm1(-np.diff(record.time) / values["time"])
    lent: Array = limit.copy()
    for k, share in enumerate(aged, start=1):
        lent[k] = lent[k - 1] + share * (limit[k] - lent[k - 1])
    return replace(record, lent=record.lent + lent)


MUSCLE_CREEP = Effect(
    "muscle_creep",
    site="muscle",
    scope="muscle type",
    what="a slow contraction z, dz/dt = (share max(eps, 0) - z) / time, that the bench law does not see: F(p, eps - z)",
    signature="slow extra at hold, slow recovery after; as much for slow and fast ramps once held",
    looks_like="a slow leak, or a muscle that warms; log the pressure over a long hold and repeat at once",
    source="standard linear solid; docs/effects.md",
    parameters={
        "share": EffectParameter("1", "of the contraction, in the end", 0.15, (0.0, 0.8), 0.1, off=0.0),
        "time": EffectParameter("s", "time constant", 0.8, (0.02, 100.0), 0.8, transform="log"),
    },
    specimen=_specimen,
    force="sim.effects.muscle_creep:MUSCLE_CREEP",
    bench=_bench,
    remembers=True,
)

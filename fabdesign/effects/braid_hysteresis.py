"""Braid hysteresis: Coulomb friction of strand on strand, which grows with pressure."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.bench import MuscleRecord
from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(
        muscles,
        friction_per_pressure=values["friction"] / 1e3,
        friction_at_zero=values["friction_at_zero"],
        friction_slip=values["slip"],
    )


def _bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = (values["friction_at_zero"] + values["friction"] / 1e3 * record.pressure).tolist()
    drawn = np.diff(record.contraction, prepend=record.contraction[0]).tolist()
    force, found = 0.0, []
    for most, more in zip(limit, drawn, strict=True):
        force = min(max(force + most / values["slip"] * more, -most), most)
        found.append(force)
    return replace(record, friction=record.friction + np.array(found))


BRAID_HYSTERESIS = Effect(
    "braid_hysteresis",
    site="muscle",
    scope="muscle type",
    what="friction against contraction and lengthening, up to friction times pressure: one Maxwell-slip element an "
    "interval, which gives way by `slip` of contraction before it slides",
    signature="branches at equal pressure, as wide at any rate; minor loops; still open at hold",
    looks_like="friction of the cloth with itself, or a pressure sensor with a dead band; cycle one muscle on its "
    "bench by pressure measured at the muscle",
    source="Maxwell-slip model (Iwan 1966, doi:10.1115/1.3625199); docs/effects.md",
    parameters={
        "friction": EffectParameter("N/kPa", "limit by pressure", 0.005, (0.0, 0.1), 0.005, off=0.0),
        "friction_at_zero": EffectParameter("N", "limit without pressure", 0.0, (0.0, 10.0), 0.3, off=0.0),
        "slip": EffectParameter("1", "contraction until it slides", 0.005, (0.0005, 0.1), 0.5, transform="log"),
    },
    specimen=_specimen,
    force="sim.effects.braid_hysteresis:BRAID_HYSTERESIS",
    bench=_bench,
    remembers=True,
)

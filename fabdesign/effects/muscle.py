"""Effects of muscles: threshold, friction, creep, viscosity, softening, an odd one."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import MuscleRecord, Specimen, Values
from fabdesign.nouns.lag import first_order
from fabdesign.units import from_kpa


# Threshold pressure: a muscle's bladder must be blown up before pressure contracts the braid.
def threshold_pressure_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    threshold, width = from_kpa(values["threshold"]), from_kpa(values["width"])
    # so a threshold of nothing leaves the pressure as it is; from 2 (4) widths on the width is right to 4 (0.1) %
    narrowed = width * np.tanh(threshold / width)
    return specimen.with_muscles(muscles, threshold_pressure=threshold, threshold_width=narrowed)


# Braid hysteresis: Coulomb friction of strand on strand, which grows with pressure.
def braid_hysteresis_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(
        muscles,
        friction_per_pressure=values["friction"] / from_kpa(1.0),  # N/Pa
        friction_at_zero=values["friction_at_zero"],
        friction_slip=values["slip"],
    )


def braid_hysteresis_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["friction_at_zero"] + values["friction"] / from_kpa(1.0) * record.pressure
    drawn = np.diff(record.contraction, axis=0, prepend=record.contraction[:1])
    force, forces = np.zeros(drawn.shape[1:]), []
    for most, more in zip(limit, drawn, strict=True):
        force = np.clip(force + most / values["slip"] * more, -most, most)
        forces.append(force)
    return replace(record, friction=record.friction + np.array(forces))


# Muscle creep: part of a muscle's contraction comes slowly, and goes slowly.
def muscle_creep_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["share"] * np.maximum(record.contraction, 0.0)
    lent = first_order(limit[1:], np.diff(record.time), values["time"], start=limit[0])
    return replace(record, lent=record.lent + lent - values["on_bench"] * limit)


# Muscle viscosity: tension lost by the rate of contraction, another share while lengthening.
def muscle_viscosity_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    viscosity = np.where(record.rate > 0, values["contracting"], values["lengthening"])
    return replace(record, friction=record.friction + viscosity * record.rate)


# Stroke softening: muscles pull less from trial to trial of a session.
def stroke_softening_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    remaining = 1.0 + values["loss"] * np.expm1(-specimen.order / values["trials"])
    return specimen.with_muscles(muscles, gain=specimen.muscles["gain"] * remaining)


# Odd muscle: the muscles of one channel pull with a gain of their own.
def odd_muscle_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    odd = np.array([muscle.channel == int(values["channel"]) for muscle in specimen.design.muscles], dtype=bool)
    return specimen.with_muscles(odd & muscles, gain=specimen.muscles["gain"] * values["factor"])

"""Threshold pressure: a muscle's bladder must be blown up before pressure contracts the braid."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.bench import MuscleRecord
from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def past_threshold(pressure: Array, threshold: float, width: float) -> Array:
    """Pa that act. The width is `width` tanh(threshold / width): so a threshold of nothing leaves the pressure as it
    is, and one of 2 (4) widths differs by 4 (0.1) % of the width."""
    if threshold <= 0:
        return pressure
    w = width * np.tanh(threshold / width)
    return np.asarray(w * np.logaddexp(0.0, (pressure - threshold) / w))


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    threshold, width = 1e3 * values["threshold"], 1e3 * values["width"]
    return specimen.with_muscles(
        muscles, threshold_pressure=threshold, threshold_width=width * np.tanh(threshold / width)
    )


def _bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    acting = past_threshold(record.pressure, 1e3 * values["threshold"], 1e3 * values["width"])
    return replace(record, pressure=acting)


THRESHOLD_PRESSURE = Effect(
    "threshold_pressure",
    site="muscle",
    scope="muscle type",
    what="p acts as width log(1 + exp((p - threshold) / width)): hardly below the threshold, less by it above; below "
    "two widths of threshold the width narrows with it",
    signature="one curve of the pressure, the same up and down and at any rate; wrong most at low pressures",
    looks_like="a pressure gauge with an offset, or another law of the bench at low pressures; measure the pressure at "
    "the muscle, in steps of 10 kPa",
    source="bladder of a McKibben muscle (Tondu and Lopez 2000, doi:10.1109/37.833638); docs/effects.md",
    parameters={
        "threshold": EffectParameter("kPa", "pressure that does nothing", 40.0, (0.0, 400.0), 20.0, off=0.0),
        "width": EffectParameter("kPa", "of the bend", 10.0, (1.0, 100.0), 0.5, transform="log"),
    },
    specimen=_specimen,
    force="sim.effects.threshold_pressure:THRESHOLD_PRESSURE",
    bench=_bench,
)

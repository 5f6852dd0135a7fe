"""Threshold pressure: a muscle's bladder must be blown up before pressure contracts the braid."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    threshold, width = 1e3 * values["threshold"], 1e3 * values["width"]
    # so a threshold of nothing leaves the pressure as it is; from 2 (4) widths on the width is right to 4 (0.1) %
    narrowed = width * np.tanh(threshold / width)
    return specimen.with_muscles(muscles, threshold_pressure=threshold, threshold_width=narrowed)


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
)

"""Stress relaxation: part of the cloth's stress goes with time at constant strain."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_constants(stressed=1.0, relaxed_share=values["share"], relaxed_time=values["time"])


STRESS_RELAXATION = Effect(
    "stress_relaxation",
    site="fabric",
    scope="fabric",
    what="`share` of the cloth's elastic stress is lost with a time constant, one Prony term; declared values are the "
    "instantaneous ones",
    signature="bends and stretches on at hold, slowly back after; where the cloth is strained, whichever muscle "
    "strains it",
    looks_like="cloth that slides in its clamp, or a set that stays (plasticity); hang a dead weight on the cloth "
    "without muscles, and see whether the shape comes back within a minute",
    source="Prony series with one term (standard linear solid); docs/effects.md",
    parameters={
        "share": EffectParameter("1", "of the stress, in the end", 0.3, (0.0, 0.9), 0.15, off=0.0),
        "time": EffectParameter("s", "time constant", 0.7, (0.02, 100.0), 0.8, transform="log"),
    },
    specimen=_specimen,
    force="sim.effects.cloth_stress:CLOTH_STRESS",
    remembers=True,
)

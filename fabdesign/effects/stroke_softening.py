"""Stroke softening: muscles pull less from trial to trial of a session."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    left = 1.0 + values["loss"] * np.expm1(-specimen.order / values["trials"])
    return specimen.with_muscles(muscles, gain=specimen.muscles["gain"] * left)


STROKE_SOFTENING = Effect(
    "stroke_softening",
    site="muscle",
    scope="rig",
    what="what pressure adds to the tension falls with the trial's place k in the session: by loss (1 - exp(-k / "
    "trials))",
    signature="smaller motions from trial to trial, most between the first ones; back after a rest, not within a trial",
    looks_like="a supply that runs empty, or muscles that warm up; log the pressure, and repeat the first trial after "
    "an hour",
    source="softening of the first strokes (Mullins effect, Ogden and Roxburgh 1999); docs/effects.md",
    parameters={
        "loss": EffectParameter("1", "of the gain, in the end", 0.15, (0.0, 0.9), 0.1, off=0.0),
        "trials": EffectParameter("1", "after which 63 % of it is lost", 3.0, (0.2, 100.0), 0.8, transform="log"),
    },
    specimen=_specimen,
)

"""Odd muscle: the muscles of one channel pull with a gain of their own."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    odd = np.array([muscle.channel == int(values["channel"]) for muscle in specimen.design.muscles], dtype=bool)
    return specimen.with_muscles(odd & muscles, gain=specimen.muscles["gain"] * values["factor"])


ODD_MUSCLE = Effect(
    "odd_muscle",
    site="muscle",
    scope="rig",
    what="what pressure adds to the tension is multiplied in one channel's muscles",
    signature="stripes fixed to one muscle, in step with its pressure, whatever the others do",
    looks_like="a regulator of this channel that is out by a share, or a looser lacing; exchange two channels' hoses",
    source="repeat variation of woven muscles, 2 to 4 %; docs/effects.md",
    parameters={
        "channel": EffectParameter("1", "the odd channel, from 0", 0.0, (0.0, 255.0), 1.0, whole=True),
        "factor": EffectParameter("1", "on its gain", 0.8, (0.05, 5.0), 0.2, off=1.0, transform="log"),
    },
    specimen=_specimen,
)

"""Line loss: pressure falls along a muscle."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(muscles, pressure_loss=values["share"])


LINE_LOSS = Effect(
    "line_loss",
    site="pneumatics",
    scope="rig",
    what="pressure falls linearly along a muscle, from its path's first point to its last",
    signature="the inlet's end acts more, at hold too; exchanged when inlet and outlet are swapped",
    looks_like="a muscle that is stiffer towards one end, or laced more tightly there; swap inlet and outlet",
    source="laminar flow through a leaking line, to first order; docs/effects.md",
    parameters={"share": EffectParameter("1", "lost at the far end", 0.3, (0.0, 1.0), 0.25, off=0.0)},
    specimen=_specimen,
)

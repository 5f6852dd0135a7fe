"""Rest curvature: the free cloth is curled, as off the loom or a roll."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_constants(**{f"rest_curvature_{name}": value for name, value in values.items()})


REST_CURVATURE = Effect(
    "rest_curvature",
    site="fabric",
    scope="fabric",
    what="moments are of the curvatures beyond those of the free cloth; positive ones bend the hem towards the front",
    signature="at zero pressure too, where the cloth is; flips when the cloth is turned over, as a tilt does not",
    looks_like="a set that is left by the trials before, or a crooked clamp; turn the cloth over and measure it at "
    "rest",
    source="plate with an initial curvature (Timoshenko and Woinowsky-Krieger 1959); docs/effects.md",
    parameters={
        "across": EffectParameter("1/m", "along u", 0.0, (-20.0, 20.0), 1.0, off=0.0),
        "down": EffectParameter("1/m", "along v", 1.5, (-20.0, 20.0), 1.0, off=0.0),
        "twist": EffectParameter("1/m", "x,uv . n", 0.0, (-20.0, 20.0), 1.0, off=0.0),
    },
    specimen=_specimen,
)

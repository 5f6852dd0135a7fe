"""Muscle viscosity: tension lost by the rate of contraction, another share while lengthening."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(
        muscles, viscosity_contracting=values["contracting"], viscosity_lengthening=values["lengthening"]
    )


MUSCLE_VISCOSITY = Effect(
    "muscle_viscosity",
    site="muscle",
    scope="muscle type",
    what="tension lost by the contraction's rate, beyond the declared viscosity; another share while lengthening",
    signature="in proportion to the rate, nothing at hold; contracting and lengthening differ, as with the cloth's "
    "damping they do not",
    looks_like="a narrow valve, whose pressure lags behind in proportion to the flow; log the pressure at the muscle",
    source="Kelvin-Voigt element with a share for each direction; docs/effects.md",
    parameters={
        "contracting": EffectParameter("N s", "while contracting", 20.0, (0.0, 500.0), 10.0, off=0.0),
        "lengthening": EffectParameter("N s", "while lengthening", 10.0, (0.0, 500.0), 10.0, off=0.0),
    },
    specimen=_specimen,
    force="sim.effects.muscle_viscosity:MUSCLE_VISCOSITY",
)

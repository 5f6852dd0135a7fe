"""Air drag: quadratic, against the cloth's normal velocity."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_constants(air_drag=values["coefficient"])


AIR_DRAG = Effect(
    "air_drag",
    site="environment",
    scope="rig",
    what="force per area against the normal velocity, coefficient |v_n| v_n",
    signature="after steps, where the cloth is fast and broadside; nothing when driven slowly; fast swings die sooner "
    "than slow ones",
    looks_like="air that moves with the cloth (an added mass that grows with its speed); swing a light rigid plate of "
    "the same size in the same room",
    source="quadratic drag of a plate, 1/2 rho c_d; docs/effects.md",
    parameters={
        "coefficient": EffectParameter("N s^2/m^4", "on |v_n| v_n", 3.0, (0.0, 100.0), 3.0, off=0.0),
    },
    specimen=_specimen,
    force="sim.effects.air_drag:AIR_DRAG",
)

"""Local stiffening: a disc of the cloth is stiffer, as under a seam's end, a patch or glue."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen

EDGE = 0.004  # m, over which the disc fades out


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    before = specimen.places.get("stiffer")

    def stiffer(u: Array, v: Array) -> Array:
        beyond = np.hypot(u - values["u"], v - values["v"]) - values["radius"]
        inside = 0.5 * (1.0 - np.tanh(beyond / (EDGE / 2)))  # 1 / (1 + exp(4 beyond / EDGE))
        factor = 1.0 + (values["factor"] - 1.0) * inside
        return np.asarray(factor * (1.0 if before is None else 1.0 + before(u, v)) - 1.0)

    return specimen.with_constants(stressed=1.0).with_place("stiffer", stiffer)


LOCAL_STIFFENING = Effect(
    "local_stiffening",
    site="fabric",
    scope="fabric",
    what="membrane, shear, bending and twist stiffness times `factor` in a disc about (u, v), faded out over 4 mm",
    signature="at one place of the cloth in every trial, whichever muscle is driven; seen where the cloth bends there",
    looks_like="contact of the cloth with itself or with a hose; look at the cloth, and drape it without muscles over "
    "an edge",
    source="stiffness as a function of place; docs/effects.md",
    parameters={
        "u": EffectParameter("m", "across, of the disc's middle", 0.1, (0.0, 5.0), 0.05, tried=(0.25, 0.75)),
        "v": EffectParameter("m", "down", 0.1, (0.0, 5.0), 0.05, tried=(0.4, 0.85)),
        "radius": EffectParameter("m", "of the disc", 0.03, (0.002, 2.0), 0.5, transform="log"),
        "factor": EffectParameter("1", "on the stiffness", 4.0, (0.05, 20.0), 0.7, off=1.0, transform="log"),
    },
    specimen=_specimen,
    force="sim.effects.cloth_stress:CLOTH_STRESS",
)

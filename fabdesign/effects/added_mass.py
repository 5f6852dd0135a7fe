"""Added mass: something is fixed to one point of the cloth."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    fabric = specimen.design.fabric
    u, v = min(values["u"], fabric.width), min(values["v"], fabric.height)
    return specimen.with_mass(u, v, values["mass"])


ADDED_MASS = Effect(
    "added_mass",
    site="environment",
    scope="rig",
    what="a mass fixed to one point of the cloth, beyond its border to the nearest one",
    signature="sags about one place at zero pressure too, and swings more slowly there; its weight follows gravity "
    "when the frame is tilted",
    looks_like="a hose or cable that pulls at the cloth; take it off, or hang the cloth by another edge: a mass then "
    "pulls down there too",
    source="a point mass; docs/effects.md",
    parameters={
        "u": EffectParameter("m", "across", 0.15, (0.0, 5.0), 0.05, tried=(0.25, 0.75)),
        "v": EffectParameter("m", "down", 0.18, (0.0, 5.0), 0.05, tried=(0.4, 0.85)),
        "mass": EffectParameter("kg", "added", 0.005, (0.0, 1.0), 0.005, off=0.0),
    },
    specimen=_specimen,
)

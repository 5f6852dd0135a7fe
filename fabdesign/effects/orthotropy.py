"""Orthotropy: the cloth is stiffer one way than its data sheet says."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.curve import MembraneCurve
from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    fabric, root = specimen.design.fabric, values["ratio"] ** 0.5
    if values["ratio"] == 1:
        return specimen
    (k1, k2), (b1, b2) = fabric.membrane_stiffness, fabric.bending_stiffness
    # nu_12 / k_1 = nu_21 / k_2: nu_12 nu_21 stays, and so do the plate's coupled and twist stiffness
    changed = replace(
        fabric,
        membrane_stiffness=(k1 * root, k2 / root),
        bending_stiffness=(b1 * root, b2 / root),
        poisson=fabric.poisson * root,
    )
    if fabric.membrane_curve is not None:
        curve = fabric.membrane_curve
        across, down = (
            tuple(factor * t for t in tension) for factor, tension in zip((root, 1 / root), curve.tension, strict=True)
        )
        changed = replace(changed, membrane_curve=MembraneCurve(curve.strain, (across, down)))
    return specimen.with_fabric(changed)


ORTHOTROPY = Effect(
    "orthotropy",
    site="fabric",
    scope="fabric",
    what="k_1 / k_2 and B_1 / B_2 times `ratio`, their products unchanged",
    signature="follows the cloth, not gravity: curls about one direction are too weak, about the other too strong",
    looks_like="muscles that stiffen the cloth along their paths; measure strips of the bare cloth in both directions",
    source="orthotropic plate (Lekhnitskii 1968); docs/effects.md",
    parameters={
        "ratio": EffectParameter("1", "on their ratio", 2.0, (0.05, 20.0), 0.5, off=1.0, transform="log"),
    },
    specimen=_specimen,
)

"""Effects of the fabric: orthotropy, a stiff place, relaxation, a curl of its own."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Specimen, Values
from fabdesign.files.law_tables import MembraneCurve
from fabdesign.nouns.array import Array


# Orthotropy: the cloth is stiffer one way than its data sheet says.
def orthotropy_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
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


# Local stiffening: a disc of the cloth is stiffer, as under a seam's end, a patch or glue.
EDGE = 0.004  # m, over which the disc fades out


def local_stiffening_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    before = specimen.places.get("stiffer")

    def stiffer(u: Array, v: Array) -> Array:
        beyond = np.hypot(u - values["u"], v - values["v"]) - values["radius"]
        inside = 0.5 * (1.0 - np.tanh(beyond / (EDGE / 2)))  # 1 / (1 + exp(4 beyond / EDGE))
        factor = 1.0 + (values["factor"] - 1.0) * inside
        return np.asarray(factor * (1.0 if before is None else 1.0 + before(u, v)) - 1.0)

    return specimen.with_place("stiffer", stiffer)

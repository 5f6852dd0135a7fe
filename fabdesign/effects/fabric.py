"""Effects of the fabric: orthotropy, a stiff place, relaxation, a curl of its own."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Specimen, Values, to_constants
from fabdesign.files.law_tables import MembraneCurve
from fabdesign.nouns.array import Array


# Orthotropy: the cloth is stiffer one way than its data sheet says.
def _orthotropy_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
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
    specimen=_orthotropy_specimen,
)


# Local stiffening: a disc of the cloth is stiffer, as under a seam's end, a patch or glue.
EDGE = 0.004  # m, over which the disc fades out


def _local_stiffening_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    before = specimen.places.get("stiffer")

    def stiffer(u: Array, v: Array) -> Array:
        beyond = np.hypot(u - values["u"], v - values["v"]) - values["radius"]
        inside = 0.5 * (1.0 - np.tanh(beyond / (EDGE / 2)))  # 1 / (1 + exp(4 beyond / EDGE))
        factor = 1.0 + (values["factor"] - 1.0) * inside
        return np.asarray(factor * (1.0 if before is None else 1.0 + before(u, v)) - 1.0)

    return specimen.with_place("stiffer", stiffer)


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
        "u": EffectParameter("m", "across, of the disc's middle", 0.1, (0.0, 5.0), 0.05, tried=(0.25, 0.5, 0.75)),
        "v": EffectParameter("m", "down", 0.1, (0.0, 5.0), 0.05, tried=(0.4, 0.85)),
        "radius": EffectParameter("m", "of the disc", 0.03, (0.002, 2.0), 0.5, transform="log"),
        "factor": EffectParameter("1", "on the stiffness", 4.0, (0.05, 20.0), 0.7, off=1.0, transform="log"),
    },
    specimen=_local_stiffening_specimen,
    force="sim.forces.added:CLOTH_STRESS",
)


# Stress relaxation: part of the cloth's stress goes with time at constant strain.
STRESS_RELAXATION = Effect(
    "stress_relaxation",
    site="fabric",
    scope="fabric",
    what="`share` of the cloth's elastic stress is lost with a time constant, one Prony term; declared values are the "
    "instantaneous ones",
    signature="bends and stretches on at hold, slowly back after; where the cloth is strained, whichever muscle "
    "strains it",
    looks_like="cloth that slides in its clamp, or a set that stays (plasticity); hang a dead weight on the cloth "
    "without muscles, and see whether the shape comes back within a minute",
    source="Prony series with one term (standard linear solid); docs/effects.md",
    parameters={
        "share": EffectParameter("1", "of the stress, in the end", 0.3, (0.0, 0.9), 0.15, off=0.0),
        "time": EffectParameter("s", "time constant", 0.7, (0.02, 100.0), 0.8, transform="log"),
    },
    specimen=to_constants(relaxed_share="share", relaxed_time="time"),
    force="sim.forces.added:CLOTH_STRESS",
    remembers=True,
)


# Rest curvature: the free cloth is curled, as off the loom or a roll.
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
    specimen=to_constants(**{f"rest_curvature_{name}": name for name in ("across", "down", "twist")}),
)

"""Effects of the surroundings: drag, a tilted frame, a mass on the cloth."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


# Air drag: quadratic, against the cloth's normal velocity.
def _air_drag_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
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
    specimen=_air_drag_specimen,
    force="sim.effects.air_drag:AIR_DRAG",
    resists=True,
)


# Frame tilt: the frame leans, so that gravity does not point down the cloth.
def _frame_tilt_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    a, c = np.radians(values["about_x"]), np.radians(values["about_z"])
    turn_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    turn_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    fabric = specimen.design.fabric
    x, y, z = (turn_z @ turn_x @ np.array(fabric.gravity)).tolist()
    return specimen.with_fabric(replace(fabric, gravity=(x, y, z)))


FRAME_TILT = Effect(
    "frame_tilt",
    site="environment",
    scope="rig",
    what="gravity turns about the frame's x axis, then its z axis",
    signature="in the frame of the laboratory, at zero pressure too, more where the cloth gives way more",
    looks_like="a steady draught; level the frame and measure with the door shut",
    source="a frame out of level; docs/effects.md",
    parameters={
        "about_x": EffectParameter("deg", "forwards or backwards", 3.0, (-30.0, 30.0), 2.0, off=0.0),
        "about_z": EffectParameter("deg", "sideways", 0.0, (-30.0, 30.0), 2.0, off=0.0),
    },
    specimen=_frame_tilt_specimen,
)


# Added mass: something is fixed to one point of the cloth.
def _added_mass_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
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
    specimen=_added_mass_specimen,
)

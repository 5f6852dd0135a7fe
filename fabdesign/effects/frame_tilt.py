"""Frame tilt: the frame leans, so that gravity does not point down the cloth."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
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
    specimen=_specimen,
)

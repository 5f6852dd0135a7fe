"""Effects of the surroundings: drag, a tilted frame, a mass on the cloth; and of the sensors: clouds that are shifted,
late or scaled."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Specimen, Values, to_constants
from fabdesign.nouns.array import Array

# Air drag: quadratic, against the cloth's normal velocity.
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
    specimen=to_constants(air_drag="coefficient"),
    force="sim.effects:AIR_DRAG",
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


# Registration bias: the cameras' world is turned and shifted against the frame's, always alike.
def turning(about_x: float, about_y: float, about_z: float) -> Array:
    """Return (3, 3) of turns [rad] about the world's x axis, then its y, then its z axis."""
    turn = np.eye(3)
    for axis, angle in enumerate((about_x, about_y, about_z)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[i, i] = one[j, j] = np.cos(angle)
        one[j, i], one[i, j] = np.sin(angle), -np.sin(angle)
        turn = one @ turn
    return turn


def _registration_bias_observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    turn = turning(*(np.radians(values[f"about_{axis}"]) for axis in "xyz"))
    return np.asarray(points @ turn.T + np.array([values[axis] for axis in "xyz"]))


REGISTRATION_BIAS = Effect(
    "registration_bias",
    site="sensing",
    scope="sensors",
    what="all clouds are turned about the world's x, y and z axes, in this order, and shifted",
    signature="the same at every pressure and instant, a rigid motion; a rigid target shows it too",
    looks_like="a frame that was moved after the cameras' calibration, or a crooked clamp; measure a rigid plate in "
    "the frame",
    source="rigid motion of a registration; docs/effects.md",
    parameters={
        "x": EffectParameter("m", "shift along x", 0.0, (-0.2, 0.2), 0.003, off=0.0),
        "y": EffectParameter("m", "shift along y", 0.0, (-0.2, 0.2), 0.003, off=0.0),
        "z": EffectParameter("m", "shift along z", 0.003, (-0.2, 0.2), 0.003, off=0.0),
        **{
            f"about_{axis}": EffectParameter("deg", f"turn about {axis}", 0.0, (-30.0, 30.0), 1.0, off=0.0)
            for axis in "xyz"
        },
    },
    observed=_registration_bias_observed,
)


# Time offset: a frame shows the cloth as it was before the frame's time.
def _time_offset_clock(times: Array, values: Values) -> Array:
    return np.maximum(times - values["offset"], 0.0)


TIME_OFFSET = Effect(
    "time_offset",
    site="sensing",
    scope="sensors",
    what="a frame of time t shows the cloth at t - offset",
    signature="proportional to the velocity, opposite going up and down; nothing at hold",
    looks_like="cameras that take their pictures one after another; film a falling ball with all of them",
    source="clocks of regulator and camera; docs/effects.md",
    parameters={"offset": EffectParameter("s", "offset", 0.05, (-0.5, 1.0), 0.05, off=0.0)},
    clock=_time_offset_clock,
    same_from_rest="dead_time",
)


# Scale error: all lengths that the cameras give are wrong by one factor.
def _scale_error_observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    return points * (1.0 + values["scale"])


SCALE_ERROR = Effect(
    "scale_error",
    site="sensing",
    scope="sensors",
    what="coordinates are too large by `scale`, from the origin at the middle of the hung edge",
    signature="grows with the distance from the origin, at zero pressure too, in every trial alike",
    looks_like="a cloth cut larger than its data sheet says, or stretched in its frame; measure a gauge of known "
    "length in the same view",
    source="similarity transform of a calibration; docs/effects.md",
    parameters={"scale": EffectParameter("1", "error", 0.02, (-0.5, 0.5), 0.02, off=0.0)},
    observed=_scale_error_observed,
)

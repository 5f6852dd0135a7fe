"""Effects of the surroundings: drag, a tilted frame, a mass on the cloth; and of the sensors: clouds that are shifted,
late or scaled."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Specimen, Values
from fabdesign.nouns.array import Array


# Frame tilt: the frame leans, so that gravity does not point down the cloth.
def frame_tilt_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    a, c = np.radians(values["about_x"]), np.radians(values["about_z"])
    turn_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    turn_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    fabric = specimen.design.fabric
    x, y, z = (turn_z @ turn_x @ np.array(fabric.gravity)).tolist()
    return specimen.with_fabric(replace(fabric, gravity=(x, y, z)))


# Added mass: something is fixed to one point of the cloth.
def added_mass_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    fabric = specimen.design.fabric
    u, v = min(values["u"], fabric.width), min(values["v"], fabric.height)
    return specimen.with_mass(u, v, values["mass"])


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


def registration_bias_observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    turn = turning(*(np.radians(values[f"about_{axis}"]) for axis in "xyz"))
    return np.asarray(points @ turn.T + np.array([values[axis] for axis in "xyz"]))


# Time offset: a frame shows the cloth as it was before the frame's time.
def time_offset_clock(times: Array, values: Values) -> Array:
    return np.maximum(times - values["offset"], 0.0)


# Scale error: all lengths that the cameras give are wrong by one factor.
def scale_error_observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    return points * (1.0 + values["scale"])

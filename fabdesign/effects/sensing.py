"""Effects of the sensors: clouds that are shifted, late or scaled."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values


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

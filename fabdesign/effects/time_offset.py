"""Time offset: a frame shows the cloth as it was before the frame's time."""

import numpy as np

from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values


def _clock(times: Array, values: Values) -> Array:
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
    clock=_clock,
)

"""Supply droop: open channels lower each other's pressure."""

import numpy as np

from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values
from fabdesign.effects.pressures import ActingPressure
from fabdesign.pressure import PressureProgram

OPEN = 5e3  # Pa, above which a channel draws from the supply


def _drooped(pressure: Array, share: float) -> Array:
    is_open = pressure > OPEN
    others = is_open.sum(axis=1, keepdims=True) - is_open
    return np.asarray(pressure * np.maximum(1.0 - share * others, 0.0))


def _pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    told, share = acting.program, values["share"]
    program = PressureProgram(told.time, _drooped(told.pressure, share), told.duration)
    return acting.through(program, None if acting.smooth is None else _drooped(acting.smooth, share))


SUPPLY_DROOP = Effect(
    "supply_droop",
    site="pneumatics",
    scope="rig",
    what="each other channel above 5 kPa takes a share of a channel's pressure: p (1 - share n)",
    signature="grows with the number of open channels, at hold too; one channel alone is right",
    looks_like="valves that leak into each other (crosstalk), or a pull of the supply by something else; log all "
    "channels while one more is opened",
    source="a supply's source impedance, to first order; docs/effects.md",
    parameters={
        "share": EffectParameter("1", "lost by each other open channel", 0.05, (0.0, 0.5), 0.05, off=0.0),
    },
    pressure=_pressure,
)

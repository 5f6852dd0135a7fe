"""Dead time: what a regulator is told acts later."""

from dataclasses import replace

import numpy as np

from fabdesign.effects.bench import MuscleRecord
from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.pressures import ActingPressure
from fabdesign.pressure import PressureProgram


def _pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    delay = values["delay"]
    if delay <= 0:
        return acting
    told = acting.program
    program = PressureProgram(
        np.concatenate([[0.0], told.time + delay]),
        np.concatenate([np.zeros((1, told.pressure.shape[1])), told.pressure]),
        told.duration,
    )
    if acting.smooth is None:
        return acting.through(program, None)
    edges = acting.tick * np.arange(acting.ticks + 1)
    integral = np.concatenate([np.zeros((1, acting.smooth.shape[1])), acting.tick * np.cumsum(acting.smooth, axis=0)])
    late = np.stack([np.interp(edges - delay, edges, column) for column in integral.T], axis=1)
    return acting.through(program, np.diff(late, axis=0) / acting.tick)


def _bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    late = np.interp(record.time - values["delay"], record.time, record.pressure)
    return replace(record, pressure=late)


DEAD_TIME = Effect(
    "dead_time",
    site="pneumatics",
    scope="rig",
    what="pressure acts a while after it is set: p(t - delay)",
    signature="a pure shift of every onset, the same for small and large steps; with all channels from rest it is the "
    "same as time_offset",
    looks_like="a late trigger or time stamp; put a lamp on the valve's signal into the cameras' view",
    source="transport delay; docs/effects.md",
    parameters={"delay": EffectParameter("s", "delay", 0.04, (0.0, 1.0), 0.05, off=0.0)},
    pressure=_pressure,
    bench=_bench,
)

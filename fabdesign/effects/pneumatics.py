"""Effects of the pneumatics: lag, dead time, droop of the supply, loss along a line."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from fabdesign.effects.declaration import ActingPressure, Effect, EffectParameter, MuscleRecord, Values, to_muscles
from fabdesign.nouns.array import Array
from fabdesign.nouns.lag import SHORTEST, after, first_order
from fabdesign.nouns.pressure import PressureProgram

# Filling lag: the pressure in a muscle follows the set point with a time constant, which may differ emptying.
ROUNDED = 3  # decimals of Pa


def lagged(wanted: Array, tick: float, fill: float, empty: float) -> Array:
    """Return (ticks, channels) Pa, means of p over ticks, where dp/dt = (wanted - p) / tau and p = 0 at the begin; tau
    = fill where p rises, empty where it falls [s]. Exact for a wanted pressure that is constant within each tick."""
    wanted = np.round(wanted, ROUNDED)  # what differs by rounding alone would count as a change in every tick
    out = np.empty_like(wanted)
    p = np.zeros(wanted.shape[1])
    changes = np.flatnonzero((np.diff(wanted, axis=0) != 0).any(axis=1)) + 1
    for begin, end in pairwise([0, *changes.tolist(), len(wanted)]):
        goal = wanted[begin]
        tau = np.maximum(np.where(goal > p, fill, empty), SHORTEST)
        remaining = np.exp(-tick * np.arange(end - begin + 1)[:, None] / tau)  # of the gap, at the ticks' edges
        out[begin:end] = goal + (p - goal) * (remaining[:-1] - remaining[1:]) * tau / tick
        p = after(p, goal, tick * (end - begin), tau)
    return out


def _filling_lag_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    fill, empty = values["fill"], values["empty"]
    if max(fill, empty) <= SHORTEST:
        return acting
    return acting.through(acting.program, lagged(acting.means, acting.tick, fill, empty))


def _filling_lag_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    """Return a row's pressure is set until the next row."""
    goals, steps = record.pressure[:-1], np.diff(record.time)
    pressure = first_order(goals, steps, values["fill"], start=record.pressure[0], falling=values["empty"])
    return replace(record, pressure=pressure)


FILLING_LAG = Effect(
    "filling_lag",
    site="pneumatics",
    scope="rig",
    what="pressure follows the set point with a time constant: dp/dt = (set point - p) / tau",
    signature="late after every step, by as much of the step however large; gone at hold; slower ramps shrink it",
    looks_like="a regulator that limits its slope or overshoots; log the pressure at the muscle while one step is set",
    source="first-order filling of a volume through a line; docs/effects.md",
    parameters={
        "fill": EffectParameter("s", "time constant while the pressure rises", 0.08, (0.0, 3.0), 0.1, off=0.0),
        "empty": EffectParameter("s", "while it falls", 0.16, (0.0, 3.0), 0.1, off=0.0),
    },
    pressure=_filling_lag_pressure,
    bench=_filling_lag_bench,
)


# Dead time: what a regulator is told acts later.
def _dead_time_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    delay = values["delay"]
    if delay <= 0:
        return acting
    set_points = acting.program
    program = PressureProgram(
        np.concatenate([[0.0], set_points.time + delay]),
        np.concatenate([np.zeros((1, set_points.pressure.shape[1])), set_points.pressure]),
        set_points.duration,
    )
    if acting.smooth is None:
        return acting.through(program, None)
    edges = acting.tick * np.arange(acting.ticks + 1)
    integral = np.concatenate([np.zeros((1, acting.smooth.shape[1])), acting.tick * np.cumsum(acting.smooth, axis=0)])
    late = np.stack([np.interp(edges - delay, edges, column) for column in integral.T], axis=1)
    return acting.through(program, np.diff(late, axis=0) / acting.tick)


def _dead_time_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
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
    pressure=_dead_time_pressure,
    bench=_dead_time_bench,
    same_from_rest="time_offset",
)


# Supply droop: open channels lower each other's pressure.
OPEN = 5e3  # Pa, above which a channel draws from the supply


def _supply_droop_drooped(pressure: Array, share: float) -> Array:
    is_open = pressure > OPEN
    others = is_open.sum(axis=1, keepdims=True) - is_open
    return np.asarray(pressure * np.maximum(1.0 - share * others, 0.0))


def _supply_droop_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    return acting.at_once(lambda pressure: _supply_droop_drooped(pressure, values["share"]))


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
    pressure=_supply_droop_pressure,
)


# Line loss: pressure falls along a muscle.
LINE_LOSS = Effect(
    "line_loss",
    site="pneumatics",
    scope="rig",
    what="pressure falls linearly along a muscle, from its path's first point to its last",
    signature="the inlet's end acts more, at hold too; exchanged when inlet and outlet are swapped",
    looks_like="a muscle that is stiffer towards one end, or laced more tightly there; swap inlet and outlet",
    source="laminar flow through a leaking line, to first order; docs/effects.md",
    parameters={"share": EffectParameter("1", "lost at the far end", 0.3, (0.0, 1.0), 0.25, off=0.0)},
    specimen=to_muscles(pressure_loss="share"),
)

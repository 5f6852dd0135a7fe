"""Effects of the pneumatics: lag, dead time, droop of the supply, loss along a line."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from fabdesign.effects.declaration import ActingPressure, MuscleRecord, Values
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


def filling_lag_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    fill, empty = values["fill"], values["empty"]
    if max(fill, empty) <= SHORTEST:
        return acting
    return acting.through(acting.program, lagged(acting.means, acting.tick, fill, empty))


def filling_lag_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    """Return a row's pressure is set until the next row."""
    goals, steps = record.pressure[:-1], np.diff(record.time)
    pressure = first_order(goals, steps, values["fill"], start=record.pressure[0], falling=values["empty"])
    return replace(record, pressure=pressure)


# Dead time: what a regulator is told acts later.
def dead_time_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
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


def dead_time_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    late = np.interp(record.time - values["delay"], record.time, record.pressure)
    return replace(record, pressure=late)


# Supply droop: open channels lower each other's pressure.
OPEN = 5e3  # Pa, above which a channel draws from the supply


def supply_droop_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    def drooped(pressure: Array) -> Array:
        is_open = pressure > OPEN
        others = is_open.sum(axis=1, keepdims=True) - is_open
        return np.asarray(pressure * np.maximum(1.0 - values["share"] * others, 0.0))

    return acting.at_once(drooped)

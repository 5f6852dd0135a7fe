"""Filling lag: the pressure in a muscle follows the set point with a time constant, which may differ emptying."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from fabdesign.effects.bench import MuscleRecord
from fabdesign.effects.declaration import Array, Effect, EffectParameter, Values
from fabdesign.effects.pressures import ActingPressure

SHORTEST = 1e-6  # s, under which there is no lag
ROUNDED = 3  # decimals of Pa


def lagged(wanted: Array, tick: float, fill: float, empty: float) -> Array:
    """(ticks, channels) Pa, means of p over ticks, where dp/dt = (wanted - p) / tau and p = 0 at the begin; tau = fill
    where p rises, empty where it falls [s]. Exact for a wanted pressure that is constant within each tick."""
    wanted = np.round(wanted, ROUNDED)  # what differs by rounding alone would count as a change in every tick
    out = np.empty_like(wanted)
    p = np.zeros(wanted.shape[1])
    changes = np.flatnonzero((np.diff(wanted, axis=0) != 0).any(axis=1)) + 1
    for begin, end in pairwise([0, *changes.tolist(), len(wanted)]):
        goal = wanted[begin]
        tau = np.maximum(np.where(goal > p, fill, empty), SHORTEST)
        left = np.exp(-tick * np.arange(end - begin + 1)[:, None] / tau)  # of the gap, at the ticks' edges
        out[begin:end] = goal + (p - goal) * (left[:-1] - left[1:]) * tau / tick
        p = goal + (p - goal) * left[-1]
    return out


def _pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    fill, empty = values["fill"], values["empty"]
    if max(fill, empty) <= SHORTEST:
        return acting
    return acting.through(acting.program, lagged(acting.means, acting.tick, fill, empty))


def _bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    """A row's pressure is set until the next row."""
    told, steps = record.pressure.tolist(), np.diff(record.time).tolist()
    p, found = told[0], [told[0]]
    for goal, step in zip(told, steps, strict=False):
        p = goal + (p - goal) * float(np.exp(-step / max(values["fill" if goal > p else "empty"], SHORTEST)))
        found.append(p)
    return replace(record, pressure=np.array(found))


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
    pressure=_pressure,
    bench=_bench,
)

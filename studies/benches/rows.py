"""Rows of a muscle's bench records, with effects in what the law sees of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects import EFFECTS
from fabdesign.effects.bench import MuscleRecord
from fabdesign.errors import InputError
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.forward import Term
from studies.benches.law import FORCES

Array = NDArray[np.float64]

PRESSURES = ("pressure", "pressure_command")  # columns, in order of preference
_BLOCKS = 10  # a record is cut into, where there are too few records to draw from
_SAME_WAY = 1e-5  # 1/s: slower contraction counts as standing still


@dataclass(frozen=True)
class Rows:
    """(n,) each: force = law(pressure, contraction) - friction - what damps by the rate."""

    pressure: Array  # Pa
    contraction: Array  # that the law sees
    force: Array  # N
    rate: Array  # 1/s, of contraction; 0 where the record has no time
    friction: Array  # N, of effects
    block: NDArray[np.intp]


def rows_of(records: Sequence[BenchRecord], terms: Sequence[Term] = ()) -> Rows:
    """Raises InputError where a record lacks pressure, contraction or force, or time where effects want it."""
    parts: list[Rows] = []
    for i, record in enumerate(records):
        columns = record.columns
        pressure = next((columns[name] for name in PRESSURES if name in columns), None)
        force = next((columns[name] for name in FORCES if name in columns), None)
        if pressure is None or force is None or "contraction" not in columns:
            raise InputError(
                f"{record.name}: columns {', '.join(columns)}; a muscle needs pressure, contraction, force"
            )
        pressure = np.maximum(pressure, 0.0)  # a gauge without pressure reads a little below zero
        contraction, n = columns["contraction"], len(force)
        moving = "time" in columns and n > 2
        if terms and not moving:
            raise InputError(f"{record.name}: no time column; expected one, for effects show in time")
        block = i * _BLOCKS + (np.arange(n) * _BLOCKS // n if len(records) < _BLOCKS else 0)
        seen = MuscleRecord.measured(columns["time"] if moving else np.arange(n, dtype=float), pressure, contraction)
        rate = seen.rate if moving else np.zeros(n)
        for term in terms:
            if (bench := EFFECTS[term.name].bench) is not None:
                seen = bench(seen, EFFECTS[term.name].values(term.values))
        parts.append(
            Rows(
                seen.pressure, contraction - seen.lent, force, rate, seen.friction,
                np.broadcast_to(block, n).astype(np.intp),
            )
        )  # fmt: skip
    names = ("pressure", "contraction", "force", "rate", "friction", "block")
    return Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def taken(rows: Rows, index: NDArray[np.intp]) -> Rows:
    names = ("pressure", "contraction", "force", "rate", "friction", "block")
    return Rows(*(getattr(rows, name)[index] for name in names))


def only_speed(rows: Rows) -> float | None:
    """Return the rate of contraction [1/s] at which all rows move, where there is one: viscosity and constant friction
    look alike there."""
    speeds = np.abs(rows.rate)
    moving = speeds[speeds > _SAME_WAY]
    low, middle, high = np.quantile(moving, (0.1, 0.5, 0.9)) if len(moving) else (0.0, 0.0, 0.0)
    return float(middle) if high < 1.5 * low else None


def motion_columns(rate: Array, *, friction: bool = True) -> Array:
    """(n, 2): what viscosity and hysteresis multiply; without friction the latter is zero."""
    sign = np.where(np.abs(rate) > _SAME_WAY, np.sign(rate), 0.0)
    return np.stack([rate, sign if friction else np.zeros(len(rate))], axis=1)

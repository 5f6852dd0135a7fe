"""The quasi-static law of a bench: what its specimen would do at once, and the same way each time."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fabdesign.nouns.bench import Bench, BenchRecord
from optimize.fit.clouds import Array
from studies.benches.actuator import Hold, StaticCurve, hold_of
from studies.benches.muscle import BenchMuscle
from studies.benches.records import output_of
from studies.benches.strip import StripLaw

_MOVED = 0.05  # of the level held: what counts as moved


def laws_of(
    bench: Bench,
    records: Sequence[BenchRecord],
    added: Sequence[Array] | None = None,
    *,
    told: Callable[[float], None] = lambda share: None,
) -> list[Array]:
    """Return what the law says of each record, fitted to the others. added: what effects add to each, taken off
    before the fit. told: is given the share done."""
    output = output_of(bench)
    if added is not None:
        records = [
            replace(r, columns={**r.columns, output: r.columns[output] - more})
            for r, more in zip(records, added, strict=True)
        ]
    laws = []
    for k, record in enumerate(records):
        told(k / len(records))
        laws.append(law(bench, [*records[:k], *records[k + 1 :]], record))
    return laws


def law(bench: Bench, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
    """(n,) what the quasi-static law, fitted to other records, says at the rows of one: without any memory. An
    actuator's level at the highest pressure is its own: there is no curve beyond it."""
    if bench.specimen == "muscle":
        return replace(BenchMuscle.fit(others, refits=0), viscosity=None, hysteresis=None).predict(record)
    if bench.specimen == "strip":
        return StripLaw.fit(others).predict(record)
    if bench.specimen == "cylinder":
        force = np.concatenate([r.columns["force"] for r in others])
        terms = np.concatenate([_cylinder(r) for r in others])
        return np.asarray(_cylinder(record) @ np.linalg.lstsq(terms, force, rcond=None)[0])
    hold = hold_of(record)
    highest = hold.pressure > max(hold_of(other).pressure for other in others)
    level = float(StaticCurve.fit([*others, record] if highest else others).displacement(hold.pressure))
    onset, release = _instants(record, hold)
    time = record.columns["time"]
    return np.where((time > onset) & (time <= release), level, 0.0)


def _instants(record: BenchRecord, hold: Hold) -> tuple[float, float]:
    """s: when the actuator begins to move and to fall back, so that all that comes later than the pressure shows."""
    time, share = record.columns["time"], record.columns["displacement"] / hold.level
    rest, held = time[(time < hold.onset) & (share < _MOVED)], time[(time <= hold.release) & (share > 1 - _MOVED)]
    onset = float(rest[-1]) if len(rest) else hold.onset
    falls = hold.release < time[-1] and len(held) > 0
    return onset, float(held[-1]) if falls else float(hold.release)


def _cylinder(record: BenchRecord) -> Array:
    """Preload, spring, area times pressure, and its change over the stroke."""
    x, p = record.columns["displacement"] / 0.01, record.columns["pressure"] / 1e5
    return np.stack([np.ones_like(x), x, p, x * p], axis=1)

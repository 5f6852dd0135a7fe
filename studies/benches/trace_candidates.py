"""Columns that a bench's record would show of each effect, in one dimension: columns beside the quasi-static law."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.lag import first_order
from fabdesign.units import in_kpa
from studies.benches.cylinder import friction_state
from studies.benches.law import Law

# what a force goes back and forth over, and its sign
PATHS = {"displacement": 1.0, "contraction": -1.0, "stretch": 1.0}
PRESSURES = "pressure", "pressure_command", "pressure_amplitude"
FAST = 0.02, 0.05, 0.1, 0.2, 0.4  # s
SLOW = 0.7, 2.0, 6.0, 20.0  # s


@dataclass(frozen=True, eq=False)
class Signals:
    """The signals of one record: law (n,) what the quasi-static law says; path (rises as the specimen lengthens),
    pressure [kPa] and time, where it has them; number: its place among the records."""

    law: Array
    path: Array | None
    pressure: Array | None
    time: Array | None
    number: int


@dataclass(frozen=True)
class ShapedEffect:
    """A candidate at one shape. columns(signals): {parameter: (n,)}; each coefficient is that parameter's value."""

    effect: str
    values: Mapping[str, float]  # of what shapes it
    units: Mapping[str, str]  # of all its parameters
    columns: Callable[[Signals], Mapping[str, Array]]


def signals_of(record: BenchRecord, law: Array, number: int) -> Signals:
    path = next((sign * record.columns[name] for name, sign in PATHS.items() if name in record.columns), None)
    pressure = record.first(PRESSURES)
    return Signals(law, path, None if pressure is None else in_kpa(pressure), record.columns.get("time"), number)


def shapes_of(law: type[Law], signals: list[Signals]) -> list[ShapedEffect]:
    """Return those that make sense on a specimen and that its records can show."""
    has = {name: all(getattr(s, name) is not None for s in signals) for name in ("path", "pressure", "time")}
    shapes: list[ShapedEffect] = []
    along, unit = law.slides_over, law.unit
    if along is not None and has["path"] and has["pressure"]:
        reach = float(np.median([np.ptp(s.path) for s in signals if s.path is not None]))
        slips = [share * reach for share in (0.005, 0.02, 0.06)]
        units = {"friction": f"{unit}/kPa", "friction_at_zero": unit, "slip": along}
        shapes += [ShapedEffect("braid_hysteresis", {"slip": s}, units, _friction(s)) for s in slips]
    if has["time"]:
        if law.damped and has["path"]:
            rate = {"contracting": f"{unit} s", "lengthening": f"{unit} s"}
            shapes.append(ShapedEffect("muscle_viscosity", {}, rate, _viscosity))
        if law.late:
            shapes += [ShapedEffect("filling_lag", {"time": t}, {"share": "1", "time": "s"}, _slow(t)) for t in FAST]
            shapes.append(ShapedEffect("dead_time", {}, {"delay": "s"}, lambda s: {"delay": _delay(s)}))
        else:
            shapes.append(ShapedEffect("time_offset", {}, {"offset": "s"}, lambda s: {"offset": _delay(s)}))
        slow, sign = law.slow
        shapes += [ShapedEffect(slow, {"time": t}, {"share": "1", "time": "s"}, _slow(t, sign)) for t in SLOW]
    if len(signals) > 2:
        shapes += [
            ShapedEffect("stroke_softening", {"trials": n}, {"loss": "1", "trials": "1"}, _softening(n))
            for n in (1.0, 3.0)
        ]
    return shapes


def _friction(slip: float) -> Callable[[Signals], Mapping[str, Array]]:
    def columns(s: Signals) -> Mapping[str, Array]:
        assert s.path is not None and s.pressure is not None
        state = friction_state(s.path, slip)
        return {"friction": state * s.pressure, "friction_at_zero": state}

    return columns


def _viscosity(s: Signals) -> Mapping[str, Array]:
    assert s.path is not None and s.time is not None
    rate = np.gradient(s.path, s.time)
    return {"contracting": np.minimum(rate, 0.0), "lengthening": np.maximum(rate, 0.0)}


def _slow(time: float, sign: float = 1.0) -> Callable[[Signals], Mapping[str, Array]]:
    """Return what a share of the law lacks that comes with a time constant; less than nothing: has beyond it, and
    loses."""

    def columns(s: Signals) -> Mapping[str, Array]:
        assert s.time is not None
        late = first_order(s.law[1:], np.diff(s.time), time, start=s.law[0])
        return {"share": sign * (late - s.law)}

    return columns


def _delay(s: Signals) -> Array:
    """Return what the law changes by in a second."""
    assert s.time is not None
    return np.asarray((np.interp(s.time - 0.05, s.time, s.law) - s.law) / 0.05)


def _softening(trials: float) -> Callable[[Signals], Mapping[str, Array]]:
    return lambda s: {"loss": -s.law * (1 - np.exp(-s.number / trials))}

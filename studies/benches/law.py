"""The law of a specimen on a bench: fitted to records, asked for predictions, written to a file; and effects that its
records may show beside it, with what a record would have of each.

A new specimen is a subclass of `Law` in a file of its own, named in `LAWS` of `records.py` and in `nouns/bench.py`.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.files.law_tables import BenchLaw
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.lag import first_order
from fabdesign.nouns.model import Quantity
from fabdesign.units import in_kpa

Predict = Callable[[BenchRecord], tuple[Array, Array]]  # (n,) at rest, in motion; of an actuator (1,), the level held
FORCES = ("force", "load")
ROUNDS = 3  # at most, of what is fitted in turn: a law and what damps, a law and effects, shapes of effects

# what a force goes back and forth over, and its sign
PATHS = {"displacement": 1.0, "contraction": -1.0, "stretch": 1.0}
PRESSURES = "pressure", "pressure_command", "pressure_amplitude"
FAST = 0.02, 0.05, 0.1, 0.2, 0.4  # s
SLOW = 0.7, 2.0, 6.0, 20.0  # s

Signals = Mapping[str, Array]  # (n,) of one record


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def twice(values: Array) -> tuple[Array, Array]:
    """Return a prediction that is the same at rest and in motion."""
    return np.asarray(values), np.asarray(values)


class Law:
    """A specimen's quasi-static law, and what a trace of its records looks for beside it."""

    columns: ClassVar[tuple[tuple[str, ...], ...]]  # that records must have: of each group one
    unit: ClassVar[str] = "N"
    output: ClassVar[str | None] = None  # the column that is compared row by row; None: what the bench says
    slides_over: ClassVar[str | None] = "1"  # unit of what a force with friction goes over; None: it is no force
    damped: ClassVar[bool] = True  # whether a force that grows with the rate is looked for
    late: ClassVar[bool] = False  # whether what moves may be late behind the pressure
    slow: ClassVar[tuple[str, float]] = ("muscle_creep", 1.0)  # what comes with time, and its sign

    @staticmethod
    @abstractmethod
    def fit(records: Sequence[BenchRecord]) -> "Law":
        """Return the law of some records. Raises InputError where they do not suffice."""

    @classmethod
    def still(cls, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
        """Return (n,) what the law, fitted to other records, says at the rows of one: without any memory."""
        return cls.fit(others).predict(record)

    @abstractmethod
    def predict(self, record: BenchRecord) -> Array:
        """Return what the law says of a record, with all that was fitted."""

    @staticmethod
    def measured(record: BenchRecord) -> Array:
        """Return what a record measured of what the law predicts."""
        force = record.first(FORCES)
        assert force is not None  # `require_columns`
        return force

    def constants(self) -> Mapping[str, Quantity]:
        """Return what records say beyond the law."""
        return {}

    def written(self, *, sized: bool) -> Predict:
        """Return what the law's file says. sized: whether a strip's width is known."""
        return self.read(self.file(""))

    def file(self, output: str) -> BenchLaw:
        """Return the law as a file of its own has it. output: the bench's column that is predicted."""
        raise NotImplementedError

    @staticmethod
    def read(law: BenchLaw) -> Predict:
        """Return what such a file says."""
        raise NotImplementedError


def friction_state(displacement: Array, presliding: float) -> Array:
    """Return (n,) s, from 1 (moving out) at the start: exact for steps of even motion."""
    steps = np.diff(displacement)
    return first_order(np.sign(steps), np.abs(steps), presliding, start=1.0)


def signals_of(records: Sequence[BenchRecord], laws: Sequence[Array], output: str, first: int = 0) -> list[Signals]:
    """Return of each record law, what the quasi-static law says; measured, its column `output`; number, its place among
    all, of which the first one has `first`; and as far as it has them time, pressure [kPa], and path, which rises as
    the specimen lengthens."""
    every: list[Signals] = []
    for number, (record, law) in enumerate(zip(records, laws, strict=True), first):
        columns, pressure = record.columns, record.first(PRESSURES)
        path = [sign * columns[name] for name, sign in PATHS.items() if name in columns]
        signals = {"law": law, "measured": columns[output], "number": np.array(number)}
        signals |= {"path": path[0]} if path else {}
        signals |= {} if pressure is None else {"pressure": in_kpa(pressure)}
        every.append(signals | ({"time": columns["time"]} if "time" in columns else {}))
    return every


def misses_of(laws: Sequence[Array], signals: Sequence[Signals]) -> Array:
    """Return (n,) law less measured, of all records one after another."""
    return np.concatenate([law - s["measured"] for law, s in zip(laws, signals, strict=True)])


@dataclass(frozen=True, eq=False)
class ShapedEffect:
    """A candidate at one shape. columns: what a record's signals say of it, (n,) by which a unit of each of its
    strengths changes the law."""

    effect: str
    values: Mapping[str, float]  # of what shapes it
    units: Mapping[str, str]  # of its strengths, and of what shapes it
    columns: Callable[..., Sequence[Array]]

    @property
    def strengths(self) -> list[str]:
        """Return the names of those of its parameters that are fitted."""
        return [name for name in self.units if name not in self.values]

    def lowest(self, name: str) -> float:
        """Return the least of a strength: nothing, unless it may have either sign."""
        declared = EFFECTS[self.effect].parameters.get(name)
        return -np.inf if declared is not None and declared.bounds[0] < 0 else 0.0

    def table(self, signals: Sequence[Signals]) -> Array:
        """Return (strengths, n), the columns of all records one after another."""
        return np.concatenate([np.stack(self.columns(s, **self.values)) for s in signals], axis=1)


def shapes_of(law: type[Law], signals: Sequence[Signals]) -> list[ShapedEffect]:
    """Return those that make sense on a specimen and that its records can show."""
    path, pressure, time = (all(name in s for s in signals) for name in ("path", "pressure", "time"))
    unit, lag, (slow, sign) = law.unit, {"share": "1", "time": "s"}, law.slow
    shapes: list[ShapedEffect] = []
    if law.slides_over is not None and path and pressure:
        reach = float(np.median([np.ptp(s["path"]) for s in signals]))
        units = {"friction": f"{unit}/kPa", "friction_at_zero": unit, "slip": law.slides_over}
        slips = [share * reach for share in (0.005, 0.02, 0.06)]
        shapes += [ShapedEffect("braid_hysteresis", {"slip": slip}, units, _friction) for slip in slips]
    if time and law.damped and path:
        units = {"contracting": f"{unit} s", "lengthening": f"{unit} s"}
        shapes.append(ShapedEffect("muscle_viscosity", {}, units, _viscosity))
    if time and law.late:
        shapes += [ShapedEffect("filling_lag", {"time": t}, lag, partial(_slow, 1.0)) for t in FAST]
    if time:
        effect, strength = ("dead_time", "delay") if law.late else ("time_offset", "offset")
        shapes.append(ShapedEffect(effect, {}, {strength: "s"}, _delay))
        shapes += [ShapedEffect(slow, {"time": t}, lag, partial(_slow, sign)) for t in SLOW]
    if len(signals) > 2:
        units = {"loss": "1", "trials": "1"}
        shapes += [ShapedEffect("stroke_softening", {"trials": n}, units, _softening) for n in (1.0, 3.0)]
    return shapes


def _friction(s: Signals, slip: float) -> Sequence[Array]:
    state = friction_state(s["path"], slip)
    return state * s["pressure"], state


def _viscosity(s: Signals) -> Sequence[Array]:
    rate = np.gradient(s["path"], s["time"])
    return np.minimum(rate, 0.0), np.maximum(rate, 0.0)


def _slow(sign: float, s: Signals, time: float) -> Sequence[Array]:
    """Return what a share of the law lacks that comes with a time constant; less than nothing: has beyond it, and
    loses."""
    return [sign * (first_order(s["law"][1:], np.diff(s["time"]), time, start=s["law"][0]) - s["law"])]


def _delay(s: Signals) -> Sequence[Array]:
    """Return what the law changes by in a second."""
    return [(np.interp(s["time"] - 0.05, s["time"], s["law"]) - s["law"]) / 0.05]


def _softening(s: Signals, trials: float) -> Sequence[Array]:
    return [-s["law"] * (1 - np.exp(-s["number"] / trials))]


def added_by(shapes: Sequence[ShapedEffect], signals: Sequence[Signals], x: Array) -> Array:
    """Return (n,) what effects at these shapes, of strengths x (p,), add to the law, of all records one after
    another."""
    columns = [column for shape in shapes for column in shape.table(signals)]
    none = np.zeros(sum(len(s["law"]) for s in signals))
    return np.asarray(sum((v * column for v, column in zip(x, columns, strict=True)), none))

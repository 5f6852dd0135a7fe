"""The static curve of an actuator: displacement held at a pressure, from steps on and off."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.errors import InputError
from fabdesign.files.law_tables import BenchLaw
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.model import Quantity
from fabdesign.units import from_kpa, in_kpa
from studies.benches.law import Law, Predict, twice

PRESSURES = ("pressure", "pressure_amplitude", "pressure_command")  # columns, in order of preference
_MOVED = 0.05  # of the level held: what counts as moved
_SETTLED = 0.5  # s after the onset: ringing is over, creep goes on
_RELEASE = 0.1  # s before the end of the hold that are left out


@dataclass(frozen=True)
class Hold:
    """The hold that one step of pressure shows. The instants of onset and release are taken from the motion itself."""

    pressure: float  # Pa
    level: float  # m, median over the second half of the hold
    onset: float  # s, where half the largest displacement is passed
    release: float  # s; the record's end where it is still on
    creep: float  # m per decade of time since the onset


@dataclass(frozen=True, eq=False)
class StaticCurve(Law):
    """Displacement [m] over pressure [Pa]: rising, through the levels; linear in its logarithm between them.

    Interpolated by monotone cubics (Fritsch and Carlson 1980) in log(1 + displacement / smallest level), because
    displacement grows manifold over a few steps. Beyond the largest pressure it stays at the last level.
    """

    columns: ClassVar = (("time",), PRESSURES, ("displacement",))
    unit: ClassVar = "m"
    output: ClassVar = "displacement"
    slides_over: ClassVar = None
    damped: ClassVar = False
    late: ClassVar = True

    pressure: Array  # (n,) Pa, rising from 0
    level: Array  # (n,) m
    holds: tuple[Hold, ...]

    @staticmethod
    def fit(records: Sequence[BenchRecord]) -> "StaticCurve":
        """Return the fitted law. Raises InputError for fewer than two pressures and for levels that do not rise with
        pressure."""
        holds = tuple(sorted((hold_of(record) for record in records), key=lambda hold: hold.pressure))
        pressures = np.unique([hold.pressure for hold in holds if hold.pressure > 0])
        if len(pressures) < 2:
            raise InputError(f"actuator: steps to {len(pressures)} pressures; expected at least two")
        level = np.array([np.mean([h.level for h in holds if h.pressure == p]) for p in pressures])
        if level[0] <= 0 or (np.diff(level) <= 0).any():
            raise InputError("actuator: the displacement held does not rise with pressure; no static curve")
        return StaticCurve(np.concatenate([[0.0], pressures]), np.concatenate([[0.0], level]), holds)

    def displacement(self, pressure_pa: ArrayLike) -> Array:
        """Return m at a steady pressure [Pa]."""
        from scipy.interpolate import PchipInterpolator

        scale = self.level[1]
        curve = PchipInterpolator(self.pressure, np.log1p(self.level / scale))
        inside = np.clip(np.asarray(pressure_pa, dtype=float), 0.0, self.pressure[-1])
        return np.asarray(scale * np.expm1(curve(inside)))

    @classmethod
    def still(cls, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
        """Return (n,) m. The level at the highest pressure is the record's own: there is no curve beyond it."""
        hold = hold_of(record)
        highest = hold.pressure > max(hold_of(other).pressure for other in others)
        level = float(cls.fit([*others, record] if highest else others).displacement(hold.pressure))
        # it begins to move and to fall back where all that comes later than the pressure still shows
        time, share = record.columns["time"], record.columns["displacement"] / hold.level
        rest = time[(time < hold.onset) & (share < _MOVED)]
        held = time[(time <= hold.release) & (share > 1 - _MOVED)]
        onset = rest[-1] if len(rest) else hold.onset
        release = held[-1] if hold.release < time[-1] and len(held) else hold.release
        return np.where((time > onset) & (time <= release), level, 0.0)

    def predict(self, record: BenchRecord) -> Array:
        """Return (1,) m, the level held."""
        return np.atleast_1d(self.displacement(hold_of(record).pressure))

    @staticmethod
    def measured(record: BenchRecord) -> Array:
        """Return (1,) m, the level held."""
        return np.array([hold_of(record).level])

    def constants(self) -> Mapping[str, Quantity]:
        """Return how it creeps."""
        return {"creep_per_decade": Quantity(self.creep_per_decade, "1")}

    def file(self, output: str) -> BenchLaw:
        """Return pressures and levels."""
        return BenchLaw("actuator", output, {"pressure_kpa": in_kpa(self.pressure), "displacement_m": self.level})

    @staticmethod
    def read(law: BenchLaw) -> Predict:
        """Return the curve through pressures and levels."""
        curve = StaticCurve(from_kpa(law.columns["pressure_kpa"]), law.columns["displacement_m"], ())
        return lambda record: twice(curve.predict(record))

    @property
    def creep_per_decade(self) -> float:
        """Return the share of the level by which it grows in ten times the time, mean over the holds."""
        return float(np.mean([hold.creep / hold.level for hold in self.holds]))


def hold_of(record: BenchRecord) -> Hold:
    """Return the hold in a record of one step on, and perhaps off. Raises InputError where there is none."""
    pressure = record.first(PRESSURES)
    assert pressure is not None  # `require_columns`
    time, displacement = record.columns["time"], record.columns["displacement"]
    on = np.flatnonzero(displacement > displacement.max() / 2)
    first, last = on[0], on[-1]
    released = last < len(time) - 1
    end = time[last] - (_RELEASE if released else 0.0)
    middle = (time[first] + end) / 2
    settled = (time >= time[first] + _SETTLED) & (time <= end)
    if settled.sum() < 8 or displacement.max() <= 0:
        raise InputError(f"{record.name}: no hold of more than {_SETTLED:g} s; expected a step of pressure")
    slope, _ = np.polyfit(np.log10(time[settled] - time[first]), displacement[settled], 1)
    return Hold(
        pressure=float(np.max(pressure)),
        level=float(np.median(displacement[(time >= middle) & (time <= end)])),
        onset=float(time[first]),
        release=float(time[last]),
        creep=float(slope),
    )

"""A muscle type from bench records, isometric, isotonic or any other, time series or points; and rows of these records,
with effects in what the law sees of them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects import EFFECTS
from fabdesign.effects.declaration import MuscleRecord
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.design import Term
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.nouns.muscle import BenchTable
from fabdesign.nouns.muscle_law import MuscleLaw, law_of
from studies.benches.law import FORCES, ROUNDS, Law, Predict, rms

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
    """Return the rows of records. Raises InputError where one lacks pressure, contraction or force, or time where
    effects want it."""
    parts: list[Rows] = []
    for i, record in enumerate(records):
        columns = record.columns
        pressure, force = record.first(PRESSURES), record.first(FORCES)
        if pressure is None or force is None or "contraction" not in columns:
            raise InputError(
                f"{record.name}: columns {', '.join(columns)}; a muscle needs pressure, contraction, force"
            )
        pressure = np.maximum(pressure, 0.0)  # a gauge without pressure reads a little below zero
        contraction, n = columns["contraction"], len(force)
        moving = "time" in columns and n > 2
        if terms and not moving:
            raise InputError(f"{record.name}: no time column; expected one, for effects show in time")
        block = i * _BLOCKS + (np.arange(n) * _BLOCKS // n if len(records) < _BLOCKS else np.zeros(n, dtype=np.intp))
        seen = MuscleRecord.measured(columns["time"] if moving else np.arange(n, dtype=float), pressure, contraction)
        rate = seen.rate if moving else np.zeros(n)
        for term in terms:
            if (bench := EFFECTS[term.name].bench) is not None:
                seen = bench(seen, EFFECTS[term.name].values(term.values))
        parts.append(Rows(seen.pressure, contraction - seen.lent, force, rate, seen.friction, block))
    return Rows(*(np.concatenate(column) for column in zip(*(vars(part).values() for part in parts), strict=True)))


def only_speed(rows: Rows) -> float | None:
    """Return the rate of contraction [1/s] at which all rows move, where there is one: viscosity and constant friction
    look alike there."""
    speeds = np.abs(rows.rate)
    moving = speeds[speeds > _SAME_WAY]
    low, middle, high = np.quantile(moving, (0.1, 0.5, 0.9)) if len(moving) else (0.0, 0.0, 0.0)
    return float(middle) if high < 1.5 * low else None


def motion_columns(rate: Array, acting: Collection[str] = ()) -> Array:
    """Return (n, 2): what viscosity and hysteresis multiply; zero where an effect of `acting` is that by itself."""
    moves = np.where(np.abs(rate) > _SAME_WAY, np.sign(rate), 0.0)
    columns = np.stack([rate, moves], axis=1)
    return columns * [name not in acting for name in ("muscle_viscosity", "braid_hysteresis")]


_CELLS = (12, 24)  # of pressure and contraction, that a time series is averaged over before the law is fitted
_PRESSURES, _CONTRACTIONS = 9, 16  # of the table in a file


@dataclass(frozen=True, eq=False)
class BenchMuscle(Law):
    """F = law(p, eps) - viscosity deps/dt - hysteresis sign(deps/dt): the law is the mean of both directions. With
    effects, p, eps are what they leave, and braid_hysteresis stands for the last term."""

    columns: ClassVar = (PRESSURES, ("contraction",), FORCES)

    law: MuscleLaw
    viscosity: float | None  # N s, tension lost per contraction rate; None: no motion in the records
    hysteresis: float | None  # N, half the distance of the branches
    misfit: float  # N RMS over the rows fitted
    terms: tuple[Term, ...] = ()  # effects that act

    @staticmethod
    def by_formula(table: BenchTable) -> BenchTable:
        """Return the rows with the forces of the law's formula, fitted to them; this law has none, so they stay."""
        return table

    @classmethod
    def fit(cls, records: Sequence[BenchRecord], *, terms: tuple[Term, ...] = ()) -> "BenchMuscle":
        """Return the law and what damps. terms: effects that are held. Raises InputError where a record lacks pressure,
        contraction or force, or where all have too few rows."""
        from scipy.optimize import nnls

        rows, acting = rows_of(records, terms), {term.name for term in terms}
        motion, force, constants = motion_columns(rows.rate, acting), rows.force + rows.friction, np.zeros(2)
        moves = bool(rows.rate.any())
        for _ in range(ROUNDS if moves else 1):
            law = MuscleLaw.fit(cls.by_formula(_averaged(rows, force + motion @ constants)))
            residual = law.tension(rows.pressure, rows.contraction) - force
            if moves:
                constants, _ = nnls(motion, residual)
        return cls(
            law=law,
            viscosity=float(constants[0]) if moves else None,
            hysteresis=float(constants[1]) if moves and "braid_hysteresis" not in acting else None,
            misfit=rms(residual - motion @ constants),
            terms=terms,
        )

    @classmethod
    def still(cls, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
        """Return (n,) N by the law alone."""
        return replace(cls.fit(others), viscosity=None, hysteresis=None).predict(record)

    def constants(self) -> Mapping[str, Quantity]:
        """Return what damps, as far as records move."""
        values = {"viscosity": (self.viscosity, "N s"), "hysteresis": (self.hysteresis, "N")}
        return {name: Quantity(value, unit) for name, (value, unit) in values.items() if value is not None}

    def written(self, *, sized: bool) -> Predict:
        """Return what its file says: its table, without constant hysteresis and what belongs to the bench's rig."""
        return of_type(law_of(self.table()), self.viscosity, [term for term in self.terms if travels(term)])

    def predict(self, record: BenchRecord) -> Array:
        """Return N at every row of a record, from its pressure, contraction and time."""
        rows = rows_of([record], self.terms)
        force = self.law.tension(rows.pressure, rows.contraction) - rows.friction
        if self.viscosity is None:
            return force
        damping = np.array([self.viscosity, self.hysteresis or 0.0])
        return force - motion_columns(rows.rate) @ damping

    def table(self) -> BenchTable:
        """Return the law at even pressures and contractions, rest length among them, for a design."""
        p = np.linspace(*self.law.pressure_limits, _PRESSURES)
        eps = np.linspace(*self.law.contraction_limits, _CONTRACTIONS)
        if eps[0] < 0 < eps[-1]:
            eps = np.unique(np.append(eps[np.abs(eps) > 0.2 * (eps[1] - eps[0])], 0.0))
        p, eps = (x.ravel() for x in np.meshgrid(p, eps, indexing="ij"))
        return BenchTable(tuple(p.tolist()), tuple(eps.tolist()), tuple(self.law.tension(p, eps).tolist()))


def of_type(law: MuscleLaw, viscosity: float | None, terms: Sequence[Term]) -> Predict:
    still = BenchMuscle(law, None, None, 0.0)
    moving = replace(still, viscosity=viscosity or None, terms=tuple(terms))
    return lambda record: (still.predict(record), moving.predict(record))


def travels(effect: EffectTerm | Term) -> bool:
    """Return whether an effect belongs to the muscle; a bench's regulator stays where it is."""
    return EFFECTS[effect.name].scope == "muscle type"


def _averaged(rows: Rows, force: Array) -> BenchTable:
    """Return means over cells of pressure and contraction, stretch and contraction apart; few rows stay as they are."""
    columns = [rows.pressure, rows.contraction, force]
    if len(force) > _CELLS[0] * _CELLS[1]:
        places = [
            np.floor((x - x.min()) / (np.ptp(x) or 1.0) * (n - 1e-9)) for x, n in zip(columns[:2], _CELLS, strict=True)
        ]
        keys = np.stack([*places, rows.contraction < 0], axis=1)
        _, cell = np.unique(keys, axis=0, return_inverse=True)
        columns = [np.bincount(cell, x) / np.bincount(cell) for x in columns]
    pressure, contraction, mean = (tuple(x.tolist()) for x in columns)
    return BenchTable(pressure, contraction, mean)

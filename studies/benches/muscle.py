"""A muscle type from bench records: isometric, isotonic or any other, time series or points."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.bench import BenchRecord
from fabdesign.errors import InputError
from fabdesign.muscle import BenchTable
from fabdesign.muscle_law import MuscleLaw

Array = NDArray[np.float64]

PRESSURES = ("pressure", "pressure_command")  # columns, in order of preference
FORCES = ("force", "load")
_REFITS = 20  # of the block bootstrap
_BLOCKS = 10  # a record is cut into, where there are too few records to draw from
_SAME_WAY = 1e-5  # 1/s: slower contraction counts as standing still
_ROUNDS = 3  # law and rates in turn
_CELLS = (12, 24)  # of pressure and contraction, that a time series is averaged over before the law is fitted
_RATE_WINDOW = 3  # rows on either side of the one whose rate is taken
_PRESSURES, _CONTRACTIONS = 9, 16  # of the table in a file


@dataclass(frozen=True)
class _Rows:
    """(n,) each."""

    pressure: Array  # Pa
    contraction: Array
    force: Array  # N
    rate: Array  # 1/s, of contraction; 0 where the record has no time
    block: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class BenchMuscle:
    """F = law(p, eps) - viscosity deps/dt - hysteresis sign(deps/dt): the law is the mean of both directions.

    Intervals are 90 %, by a block bootstrap over records (or tenths of them).
    """

    law: MuscleLaw
    viscosity: float | None  # N s, tension lost per contraction rate; None: no motion in the records
    viscosity90: tuple[float, float] | None
    hysteresis: float | None  # N, half the distance of the branches
    hysteresis90: tuple[float, float] | None
    misfit: float  # N RMS over the rows fitted
    refits: tuple[MuscleLaw, ...]  # of the bootstrap

    @staticmethod
    def fit(records: Sequence[BenchRecord], *, refits: int = _REFITS, seed: int = 0) -> "BenchMuscle":
        """Raises InputError where a record lacks pressure, contraction or force, or where all have too few rows."""
        rows = _rows(records)
        law, constants, misfit = _fitted(rows, np.zeros(2), _ROUNDS)
        rng = np.random.default_rng(seed)
        blocks = np.unique(rows.block)
        again: list[tuple[MuscleLaw, Array | None, float]] = []
        for _ in range(refits):
            drawn = rng.choice(blocks, len(blocks))
            index = np.concatenate([np.flatnonzero(rows.block == block) for block in drawn])
            with suppress(InputError):  # a draw that misses all pressures but one
                again.append(_fitted(_taken(rows, index), np.zeros(2) if constants is None else constants, 2))
        bands = np.quantile([c for _, c, _ in again], (0.05, 0.95), axis=0) if constants is not None and again else None
        return BenchMuscle(
            law=law,
            viscosity=None if constants is None else float(constants[0]),
            viscosity90=None if bands is None else (float(bands[0, 0]), float(bands[1, 0])),
            hysteresis=None if constants is None else float(constants[1]),
            hysteresis90=None if bands is None else (float(bands[0, 1]), float(bands[1, 1])),
            misfit=misfit,
            refits=tuple(refit for refit, _, _ in again),
        )

    def interval90(self, pressure_pa: ArrayLike, contraction: ArrayLike) -> tuple[Array, Array]:
        """N, of the law."""
        forces = [refit.tension(pressure_pa, contraction) for refit in self.refits]
        low, high = np.quantile(forces, (0.05, 0.95), axis=0)
        return low, high

    def predict(self, record: BenchRecord) -> Array:
        """N at every row of a record, from its pressure, contraction and time."""
        rows = _rows([record])
        force = self.law.tension(rows.pressure, rows.contraction)
        if self.viscosity is None or self.hysteresis is None:
            return force
        return force - _motion(rows.rate) @ np.array([self.viscosity, self.hysteresis])

    def table(self) -> BenchTable:
        """The law at even pressures and contractions, rest length among them, for a design."""
        p = np.linspace(*self.law.pressure_limits, _PRESSURES)
        eps = np.linspace(*self.law.contraction_limits, _CONTRACTIONS)
        if eps[0] < 0 < eps[-1]:
            eps = np.unique(np.append(eps[np.abs(eps) > 0.2 * (eps[1] - eps[0])], 0.0))
        p, eps = (x.ravel() for x in np.meshgrid(p, eps, indexing="ij"))
        return BenchTable(tuple(p.tolist()), tuple(eps.tolist()), tuple(self.law.tension(p, eps).tolist()))


def _rows(records: Sequence[BenchRecord]) -> _Rows:
    parts: list[_Rows] = []
    for i, record in enumerate(records):
        columns = record.columns
        pressure = next((columns[name] for name in PRESSURES if name in columns), None)
        force = next((columns[name] for name in FORCES if name in columns), None)
        if pressure is None or force is None or "contraction" not in columns:
            raise InputError(
                f"{record.name}: columns {', '.join(columns)}; a muscle needs pressure, contraction, force"
            )
        contraction, n = columns["contraction"], len(force)
        moving = "time" in columns and n > 2
        rate = _slope(columns["time"], contraction) if moving else np.zeros(n)
        block = i * _BLOCKS + (np.arange(n) * _BLOCKS // n if len(records) < _BLOCKS else 0)
        parts.append(_Rows(pressure, contraction, force, rate, np.broadcast_to(block, n).astype(np.intp)))
    names = ("pressure", "contraction", "force", "rate", "block")
    return _Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _slope(time: Array, values: Array) -> Array:
    """(n,) slope of the line through the rows around each one: noise makes neighbours' differences useless."""
    half = min(_RATE_WINDOW, (len(time) - 1) // 2)
    kernel = np.arange(half, -half - 1, -1.0)
    inner = np.convolve(values, kernel, "valid") / np.convolve(time, kernel, "valid")
    return np.pad(inner, half, mode="edge")


def _taken(rows: _Rows, index: NDArray[np.intp]) -> _Rows:
    return _Rows(rows.pressure[index], rows.contraction[index], rows.force[index], rows.rate[index], rows.block[index])


def _motion(rate: Array) -> Array:
    """(n, 2): what viscosity and hysteresis multiply."""
    return np.stack([rate, np.where(np.abs(rate) > _SAME_WAY, np.sign(rate), 0.0)], axis=1)


def _fitted(rows: _Rows, constants: Array, rounds: int) -> tuple[MuscleLaw, Array | None, float]:
    """The law, (viscosity, hysteresis) not below 0 where there is motion, and the misfit [N]; from given constants."""
    from scipy.optimize import nnls

    motion = _motion(rows.rate)
    moves = bool(motion[:, 1].any())
    for _ in range(rounds if moves else 1):
        law = MuscleLaw.fit(_averaged(rows, rows.force + motion @ constants))
        residual = law.tension(rows.pressure, rows.contraction) - rows.force
        if moves:
            constants, _ = nnls(motion, residual)
    error = residual - motion @ constants
    return law, constants if moves else None, float(np.sqrt(np.mean(error**2)))


def _averaged(rows: _Rows, force: Array) -> BenchTable:
    """Means over cells of pressure and contraction, stretch and contraction apart; few rows stay as they are."""
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

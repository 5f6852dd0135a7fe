"""The law of a specimen on a bench: fitted to records, asked for predictions, written to a file.

A new specimen is a subclass of `Law` in a file of its own, named in `LAWS` of `records.py` and in `nouns/bench.py`.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from fabdesign.files.law_tables import BenchLaw
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.model import Quantity

Predict = Callable[[BenchRecord], tuple[Array, Array]]  # (n,) at rest, in motion; of an actuator (1,), the level held
FORCES = ("force", "load")
ROUNDS = 3  # at most, of what is fitted in turn: a law and what damps, a law and effects, shapes of effects


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

    @abstractmethod
    def written(self, *, sized: bool) -> Predict:
        """Return what the law's file says. sized: whether a strip's width is known."""

    def file(self, bench: Bench) -> BenchLaw:
        """Return the law as a file of its own has it."""
        raise NotImplementedError

    @staticmethod
    def read(law: BenchLaw) -> Predict:
        """Return what such a file says."""
        raise NotImplementedError

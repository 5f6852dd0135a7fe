"""The force law of a pneumatic cylinder: area times pressure, and friction that grows with pressure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, TypeVar

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.law_tables import BenchLaw
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.lag import first_order
from fabdesign.nouns.model import Quantity
from studies.benches.law import Law, Predict, rms

T = TypeVar("T")

# Terms of the law, N. p: pressure over 100 kPa, x: displacement over 10 mm, s: state of friction in [-1, 1].
FORMS: dict[str, tuple[str, ...]] = {
    "area": ("p",),
    "friction": ("p", "s", "s p"),
    "stroke": ("p", "x p", "s", "s p"),
    "curved stroke": ("p", "x p", "x x p", "s", "s p"),
    "preload": ("1", "x", "p", "x p", "s", "s p"),
    "saturating friction": ("1", "x", "p", "x p", "s", "s p", "s p p"),
}
PRESLIDINGS = (0.0001, 0.0002, 0.0003, 0.0005, 0.001, 0.002)  # m
_PRESSURE, _STROKE = 1e5, 0.01  # Pa, m, one unit of p and x


@dataclass(frozen=True, eq=False)
class CylinderLaw(Law):
    """Force [N] over pressure and displacement, with a branch for each direction of motion.

    The state of friction follows the motion over the presliding distance l as Dahl's: ds = (sign(dx) - s) |dx| / l
    (Dahl 1968, Aerospace Corp. TOR-0158). It depends on the path, not on the rate.
    """

    columns: ClassVar = (("pressure",), ("displacement",), ("force",))
    slides_over: ClassVar = "m"

    form: str
    terms: tuple[str, ...]
    coefficients: Array  # N, one a term
    interval90: Array  # (terms, 2) N, by leaving out one record at a time (jackknife, Student's t)
    presliding: float  # m
    cross_validated: dict[str, float]  # N RMS of each form on records left out of its fit

    @staticmethod
    def fit(records: Sequence[BenchRecord]) -> "CylinderLaw":
        """Fit by least squares in the form and presliding distance that predict left-out records best, among these
        alone.

        Raises InputError for fewer than two records.
        """
        if len(records) < 2:
            raise InputError("cylinder: one record; expected at least two pressures")
        scores: dict[tuple[str, float], float] = {}
        for form, terms in FORMS.items():
            for presliding in PRESLIDINGS if "s" in terms else PRESLIDINGS[:1]:
                tables = [terms_of(record, terms, presliding) for record in records]
                scores[form, presliding] = float(np.mean([_left_out(tables, records, i) for i in range(len(records))]))
        form, presliding = min(scores, key=lambda key: scores[key])
        terms = FORMS[form]
        tables = [terms_of(record, terms, presliding) for record in records]
        best = _solve(tables, records)
        alone = np.array([_solve(_without(tables, i), _without(records, i)) for i in range(len(records))])
        return CylinderLaw(
            form,
            terms,
            best,
            _jackknife90(best, alone),
            presliding,
            {name: min(score for (f, _), score in scores.items() if f == name) for name in FORMS},
        )

    @classmethod
    def still(cls, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
        """Return (n,) N by preload, spring, area times pressure, and its change over the stroke: without friction."""
        tables = [terms_of(one, ("1", "x", "p", "x p"), 1.0) for one in others]
        return terms_of(record, ("1", "x", "p", "x p"), 1.0) @ _solve(tables, others)

    def constants(self) -> Mapping[str, Quantity]:
        """Return over which distance friction comes."""
        return {"presliding": Quantity(self.presliding, "m")}

    def written(self, *, sized: bool) -> Predict:
        """Return what its file says: the terms without friction, and all of them."""
        return _prediction(self.terms, self.coefficients, self.presliding)

    def file(self, bench: Bench) -> BenchLaw:
        """Return coefficients with their bands."""
        low, high = self.interval90.T
        columns = {"coefficient_n": self.coefficients, "low90_n": low, "high90_n": high}
        return BenchLaw("cylinder", bench.output, columns, self.terms, self.form, self.presliding)

    @staticmethod
    def read(law: BenchLaw) -> Predict:
        """Return the sum of its terms."""
        return _prediction(law.terms, law.columns["coefficient_n"], law.presliding or 1.0)

    def predict(self, record: BenchRecord) -> Array:
        """Return N at every row of a record, in its order."""
        return terms_of(record, self.terms, self.presliding) @ self.coefficients


def _prediction(terms: Sequence[str], coefficients: Array, presliding: float) -> Predict:
    still = np.array(["s" not in term for term in terms]) * coefficients

    def cylinder(record: BenchRecord) -> tuple[Array, Array]:
        columns = terms_of(record, terms, presliding)
        return columns @ still, columns @ coefficients

    return cylinder


def friction_state(displacement: Array, presliding: float) -> Array:
    """Return (n,) s, from 1 (moving out) at the start: exact for steps of even motion."""
    steps = np.diff(displacement)
    return first_order(np.sign(steps), np.abs(steps), presliding, start=1.0)


@lru_cache(maxsize=256)
def _state(record: BenchRecord, presliding: float) -> Array:
    return friction_state(record.columns["displacement"], presliding)


def terms_of(record: BenchRecord, terms: Sequence[str], presliding: float) -> Array:
    """Return (rows, terms) that a law's coefficients [N] multiply."""
    x, p = record.columns["displacement"] / _STROKE, record.columns["pressure"] / _PRESSURE
    factors = {"1": np.ones(len(x)), "x": x, "p": p}
    if any("s" in term for term in terms):
        factors["s"] = _state(record, presliding)
    return np.stack([np.prod([factors[name] for name in term.split()], axis=0) for term in terms], axis=1)


def _solve(tables: Sequence[Array], records: Sequence[BenchRecord]) -> Array:
    force = np.concatenate([record.columns["force"] for record in records])
    return np.linalg.lstsq(np.concatenate(tables), force, rcond=None)[0]


def _left_out(tables: Sequence[Array], records: Sequence[BenchRecord], i: int) -> float:
    return rms(tables[i] @ _solve(_without(tables, i), _without(records, i)) - records[i].columns["force"])


def _without(items: Sequence[T], i: int) -> list[T]:
    return [item for j, item in enumerate(items) if j != i]


def _jackknife90(best: Array, alone: Array) -> Array:
    from scipy.stats import t

    n = len(alone)
    error = np.sqrt((n - 1) / n * np.sum((alone - alone.mean(axis=0)) ** 2, axis=0))
    half = t.ppf(0.95, n - 1) * error
    return np.stack([best - half, best + half], axis=1)

"""The force law of a pneumatic cylinder: area times pressure, and friction that grows with pressure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.law_tables import BenchLaw
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.bench import BenchRecord
from fabdesign.nouns.model import Quantity
from studies.benches.law import Law, Predict, friction_state

__all__ = ["CylinderLaw", "friction_state"]

# Terms of the law, N. p: pressure over 100 kPa, x: displacement over 10 mm, s: state of friction in [-1, 1].
FORMS: dict[str, tuple[str, ...]] = {
    "area": ("p",),
    "friction": ("p", "s", "s p"),
    "stroke": ("p", "x p", "s", "s p"),
    "curved stroke": ("p", "x p", "x x p", "s", "s p"),
    "preload": ("1", "x", "p", "x p", "s", "s p"),
    "saturating friction": ("1", "x", "p", "x p", "s", "s p", "s p p"),
}
TERMS = tuple(dict.fromkeys(term for terms in FORMS.values() for term in terms))
STILL = "1", "x", "p", "x p"  # terms without friction
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
        from scipy.stats import t

        if len(records) < 2:
            raise InputError("cylinder: one record; expected at least two pressures")
        force = np.concatenate([one.columns["force"] for one in records])
        record = np.repeat(np.arange(len(records)), [len(one.columns["force"]) for one in records])
        every = {d: np.concatenate([terms_of(one, TERMS, d) for one in records]) for d in PRESLIDINGS}
        scores: dict[tuple[str, float], float] = {}
        for form, terms in FORMS.items():
            for presliding in PRESLIDINGS if "s" in terms else PRESLIDINGS[:1]:
                table = every[presliding][:, [TERMS.index(term) for term in terms]]
                misses = (table * _without_each(table, force, record)[record]).sum(axis=1) - force
                squares = np.bincount(record, np.square(misses)) / np.bincount(record)
                scores[form, presliding] = float(np.sqrt(squares).mean())
        form, presliding = min(scores, key=lambda key: scores[key])
        table = every[presliding][:, [TERMS.index(term) for term in FORMS[form]]]
        best, alone, n = np.linalg.lstsq(table, force)[0], _without_each(table, force, record), len(records)
        half = t.ppf(0.95, n - 1) * np.sqrt((n - 1) / n * np.square(alone - alone.mean(axis=0)).sum(axis=0))
        return CylinderLaw(
            form=form,
            terms=FORMS[form],
            coefficients=best,
            interval90=np.stack([best - half, best + half], axis=1),
            presliding=presliding,
            cross_validated={name: min(score for (f, _), score in scores.items() if f == name) for name in FORMS},
        )

    @classmethod
    def still(cls, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
        """Return (n,) N by preload, spring, area times pressure, and its change over the stroke: without friction."""
        table = np.concatenate([terms_of(one, STILL, 1.0) for one in others])
        force = np.concatenate([one.columns["force"] for one in others])
        return terms_of(record, STILL, 1.0) @ np.linalg.lstsq(table, force)[0]

    def constants(self) -> Mapping[str, Quantity]:
        """Return over which distance friction comes."""
        return {"presliding": Quantity(self.presliding, "m")}

    def file(self, output: str) -> BenchLaw:
        """Return coefficients with their bands."""
        low, high = self.interval90.T
        numbers = {"coefficient_n": self.coefficients, "low90_n": low, "high90_n": high}
        return BenchLaw("cylinder", output, {"term": np.array(self.terms)} | numbers, self.form, self.presliding)

    @staticmethod
    def read(law: BenchLaw) -> Predict:
        """Return the sum of its terms: of those without friction, and of all."""
        coefficients = law.columns["coefficient_n"]
        still = np.where(["s" in term for term in law.terms], 0.0, coefficients)

        def cylinder(record: BenchRecord) -> tuple[Array, Array]:
            columns = terms_of(record, law.terms, law.presliding or 1.0)
            return columns @ still, columns @ coefficients

        return cylinder

    def predict(self, record: BenchRecord) -> Array:
        """Return N at every row of a record, in its order."""
        return terms_of(record, self.terms, self.presliding) @ self.coefficients


def terms_of(record: BenchRecord, terms: Sequence[str], presliding: float) -> Array:
    """Return (rows, terms) that a law's coefficients [N] multiply."""
    x, p = record.columns["displacement"] / _STROKE, record.columns["pressure"] / _PRESSURE
    factors = {"1": np.ones(len(x)), "x": x, "p": p}
    if any("s" in term for term in terms):
        factors["s"] = friction_state(record.columns["displacement"], presliding)
    return np.stack([np.prod([factors[name] for name in term.split()], axis=0) for term in terms], axis=1)


def _without_each(table: Array, force: Array, record: Indices) -> Array:
    """Return (records, terms) N: the coefficients without each of the records, which are (N,) of the rows."""
    others = [record != k for k in range(record[-1] + 1)]
    return np.array([np.linalg.lstsq(table[rows], force[rows])[0] for rows in others])

"""The stretch law of a cloth strip: tension over strain, J-shaped."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.errors import InputError
from fabdesign.files.law_tables import BenchLaw, MembraneCurve
from fabdesign.geometry.curves import design_matrix, least_squares_with_inequalities
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import BenchRecord
from studies.benches.law import Law, Predict, twice

# A repeat counts half as much as the next one: cloth runs in. Chosen on repeats 1 to 4 of the 16 knits alone,
# predicting repeats 3 and 4 from those before: 1.00 N RMS on average, 1.05 with equal weights, 1.09 from the last one.
RECENCY = 0.5
_SPANS = 16
_SMOOTHNESS = 0.03  # of second differences, for forces scaled to 1
_MIN_SLOPE = 1e-3  # of the mean slope, so that the law rises strictly
_SAMPLES = 33  # of a curve in a file


@dataclass(frozen=True, eq=False)
class StripLaw(Law):
    """Force [N] over strain: rises, ever more steeply; linear beyond the measured strains."""

    columns: ClassVar = (("stretch",), ("force",))
    damped: ClassVar = False
    slow: ClassVar = ("stress_relaxation", -1.0)

    coefficients: Array  # N, cubic B-splines over the measured strains
    start: float  # strain of the first knot
    step: float  # strain between knots
    spread: Array  # (n,) N, standard deviation from record to record at n even strains
    records: int

    @staticmethod
    def fit(records: Sequence[BenchRecord], *, recency: float = RECENCY) -> "StripLaw":
        """Fit by least squares over records in the order of testing; `recency`: weight of one over that of the next.

        Raises InputError below eight rows in a record.
        """
        for record in records:
            strain = record.columns["stretch"] - 1
            if len(strain) < 8 or np.ptp(strain) <= 0:
                raise InputError(
                    f"{record.name}: {len(strain)} rows over a strain of {np.ptp(strain):.3g}; expected 8 rows or more"
                )
        law = _fitted(records, recency)
        strain = law.start + law.step * np.linspace(0, _SPANS, _SAMPLES)
        alone = [_fitted([record], recency)._at(strain) for record in records]
        return replace(law, spread=np.std(alone, axis=0, ddof=1)) if len(records) > 1 else law

    def force(self, stretch: ArrayLike) -> Array:
        """Return N over stretch, l / l0."""
        return self._at(np.asarray(stretch, dtype=float) - 1)

    def _at(self, strain: Array) -> Array:
        rows = design_matrix((strain.ravel() - self.start) / self.step, len(self.coefficients))
        return np.asarray((rows @ self.coefficients).reshape(strain.shape))

    def predict(self, record: BenchRecord) -> Array:
        return self.force(record.columns["stretch"])

    def written(self, *, sized: bool) -> Predict:
        """Return what its file says: its samples; where the width is known, a cloth's, whose tension begins at zero."""
        return of_strip(*self.samples()) if sized else super().written(sized=sized)

    def file(self, output: str) -> BenchLaw:
        """Return samples with the band of another record."""
        strain, _ = self.samples()
        low, high = self.interval90(1 + strain)
        columns = {"strain": strain, "force_n": self.force(1 + strain), "low90_n": low, "high90_n": high}
        return BenchLaw("strip", output, columns)

    @staticmethod
    def read(law: BenchLaw) -> Predict:
        """Return the line through its samples."""
        return of_strip(law.columns["strain"], law.columns["force_n"])

    def interval90(self, stretch: ArrayLike) -> tuple[Array, Array]:
        """Return N, where another record would lie in 9 of 10 cases, by how the fitted ones differ (Student's t)."""
        from scipy.stats import t

        n = max(self.records, 2)
        strain = np.linspace(self.start, self.start + _SPANS * self.step, len(self.spread))
        half = t.ppf(0.95, n - 1) * np.sqrt(1 + 1 / n) * np.interp(np.asarray(stretch) - 1, strain, self.spread)
        force = self.force(stretch)
        return force - half, force + half

    def samples(self) -> tuple[Array, Array]:
        """Return the strain from 0 on and force [N] above that at 0, both rising."""
        strain = np.linspace(0, self.start + _SPANS * self.step, _SAMPLES)
        force = self.force(1 + strain)
        return strain, force - force[0]

    def membrane_curve(self, width: float, *, across: bool = True, down: bool = True) -> MembraneCurve:
        """Return tension per width [N/m] of a strip of this width [m], for the directions asked for."""
        strain, tension = (tuple(values.tolist()) for values in (self.samples()[0], self.samples()[1] / width))
        return MembraneCurve(
            (strain if across else (), strain if down else ()), (tension if across else (), tension if down else ())
        )


def of_strip(strain: Array, force: Array) -> Predict:
    """Return a prediction that is linear between the samples and beyond them."""
    from scipy.interpolate import interp1d

    line = interp1d(strain, force, fill_value="extrapolate")
    return lambda record: twice(line(record.columns["stretch"] - 1))


def _fitted(records: Sequence[BenchRecord], recency: float) -> StripLaw:
    """Return the law without its spread: a rising convex P-spline."""
    strain = np.concatenate([r.columns["stretch"] for r in records]) - 1
    force = np.concatenate([r.columns["force"] for r in records])
    age = np.repeat(np.arange(len(records))[::-1], [len(r.columns["force"]) for r in records])
    start, step = float(strain.min()), float(np.ptp(strain)) / _SPANS
    weight, count = recency ** (age / 2), _SPANS + 3
    scale = np.abs(force).max() or 1.0
    bend = np.diff(np.eye(count), 2, axis=0)
    rows = np.vstack(
        [design_matrix((strain - start) / step, count) * weight[:, None], _SMOOTHNESS * bend, 1e-4 * np.eye(count)]
    )
    goal = np.concatenate([force / scale * weight, np.zeros(2 * count - 2)])
    shape = np.vstack([np.diff(np.eye(count)[:2], axis=0), bend])
    least = np.concatenate([[_MIN_SLOPE / _SPANS], np.zeros(count - 2)])
    coefficients = scale * least_squares_with_inequalities(rows, goal, shape, least)
    return StripLaw(coefficients, start, step, np.zeros(_SAMPLES), len(records))

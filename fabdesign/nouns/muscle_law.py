"""A smooth law of isometric muscle tension from a noisy bench table.

F(p, eps) = S(p, eps) + K(p) max(-eps, 0): a tensor product of cubic B-splines with a roughness penalty
(P-splines: Eilers and Marx 1996, doi:10.1214/ss/1038425655; smoothness by generalised cross-validation), and the
extra stiffness K in stretch that makes the kink at rest length. Monotone by construction: differences of B-spline
coefficients bound the derivatives, so every wish is a linear inequality of one small least-squares problem.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.errors import InputError
from fabdesign.geometry.curves import design_matrix, least_squares_with_inequalities
from fabdesign.nouns.array import Array
from fabdesign.units import in_kpa

if TYPE_CHECKING:
    from fabdesign.nouns.muscle import BenchTable


_PRESSURE_SPANS = 8  # at most; a table with fewer pressures gets fewer
_CONTRACTION_SPANS = 10
_MIN_SLOPE = 0.01  # of the table's mean slope, so that the law falls strictly
_MARGIN = 1e-8  # of the table's largest force: what rounding may take from an inequality
_PENALTIES = (1e-4, 1e-2, 1.0, 1e2, 1e4)  # candidates for cross-validation, and tenfold of the best; data scaled to 1


@dataclass(frozen=True, eq=False)
class MuscleLaw:
    """Isometric tension [N] over gauge pressure [Pa] and contraction (1 - l / l0).

    Falls strictly with contraction everywhere. Rises with pressure wherever tension is positive, up to the table's
    largest contraction. Continues linearly beyond the table, where it is not to be trusted.
    """

    coefficients: Array  # (m, n) N, B-spline coefficients of S over pressure and contraction
    kink: Array  # (m,) N per unit strain, B-spline coefficients of K over pressure
    pressure_limits: tuple[float, float]  # Pa, of the table
    contraction_limits: tuple[float, float]  # of the table
    pressure_step: float  # Pa between knots; the first knot lies at 0
    contraction_start: float  # first knot: the table's smallest contraction, 0 at most
    contraction_step: float
    misfit: float  # N, root mean square over the table's rows

    @staticmethod
    def fit(table: "BenchTable") -> "MuscleLaw":
        """Return the law of a bench table in any order and layout.

        Raises InputError for a table with fewer than two pressures, two contractions or four rows.
        """
        p, eps, force = (np.asarray(x, dtype=float) for x in (table.pressure, table.contraction, table.force))
        _check(p, eps, force)
        rows = len(np.unique(p))
        p_spans = min(_PRESSURE_SPANS, rows - 1)
        start, end = min(eps.min(), 0.0), max(eps.max(), 0.0)
        p_step, e_step = p.max() / p_spans, (end - start) / _CONTRACTION_SPANS
        m, n = p_spans + 3, _CONTRACTION_SPANS + 3

        scale = np.abs(force).max() or 1.0
        basis_p, basis_e = design_matrix(p / p_step, m), design_matrix((eps - start) / e_step, n)
        smooth = (basis_p[:, :, None] * basis_e[:, None, :]).reshape(len(p), m * n)
        stretch = basis_p * (np.maximum(-eps, 0.0) / e_step)[:, None]
        a, b = np.hstack([smooth, stretch]), force / scale
        penalty = _cross_validated_penalty(a, b, m, n)
        min_fall = _MIN_SLOPE * np.ptp(force) / scale / np.ptp(eps) * e_step
        # The law must rise with pressure where it is positive; how far that is, the fit tells: widen until it holds.
        positive_to = 1
        while True:
            inequality, least = _shape_constraints(m, n, positive_to, min_fall, bool((eps < 0).any()))
            x = least_squares_with_inequalities(
                np.vstack([a, penalty]), np.concatenate([b, np.zeros(len(penalty))]), inequality, least
            )
            law = MuscleLaw(
                coefficients=scale * x[: m * n].reshape(m, n),
                kink=scale * x[m * n :] / e_step,
                pressure_limits=(float(p.min()), float(p.max())),
                contraction_limits=(float(eps.min()), float(eps.max())),
                pressure_step=float(p_step),
                contraction_start=float(start),
                contraction_step=float(e_step),
                misfit=float(scale * np.sqrt(np.mean((a @ x - b) ** 2))),
            )
            knots = start + e_step * np.linspace(0, _CONTRACTION_SPANS, 20 * _CONTRACTION_SPANS + 1)
            grid = law.tension(np.linspace(0, p.max(), 4 * p_spans + 1)[:, None], knots)
            last = int(np.ceil((knots[(grid > 0).any(axis=0)].max(initial=start) - start) / e_step)) + 3
            if last <= positive_to or positive_to == n:
                return law
            positive_to = min(last, n)

    def tension(self, pressure_pa: ArrayLike, contraction: ArrayLike) -> Array:
        """Return the tension [N], positive pulls; the arguments broadcast. Pressures below zero count as zero."""
        p, eps = np.asarray(pressure_pa, dtype=float), np.asarray(contraction, dtype=float)
        m, n = self.coefficients.shape
        of_p = design_matrix(np.maximum(p, 0.0) / self.pressure_step, m)
        of_eps = design_matrix((eps - self.contraction_start) / self.contraction_step, n)
        force, kink = np.einsum("...j,...j->...", of_p @ self.coefficients, of_eps), of_p @ self.kink
        return np.asarray(force + kink * np.maximum(-eps, 0.0))


@lru_cache(maxsize=64)
def law_of(table: "BenchTable") -> MuscleLaw:
    """Return `MuscleLaw.fit`, computed once for each table: a search makes thousands of designs of one muscle type."""
    return MuscleLaw.fit(table)


def _check(p: Array, eps: Array, force: Array) -> None:
    if not (np.isfinite(p).all() and np.isfinite(eps).all() and np.isfinite(force).all()):
        raise InputError("bench table: holds a value that is not finite; expected finite numbers")
    if (p < 0).any():
        raise InputError(f"bench table: pressure {in_kpa(p.min()):g} kPa; expected gauge pressures of at least 0")
    pressures, contractions = len(np.unique(p)), len(np.unique(eps))
    if pressures < 2 or contractions < 2 or len(p) < 4:
        raise InputError(
            f"bench table: {len(p)} rows at {pressures} pressures and {contractions} contractions; "
            "expected at least 4 rows, 2 pressures and 2 contractions"
        )


def _cross_validated_penalty(a: Array, b: Array, m: int, n: int) -> Array:
    """Return the penalty rows whose two weights minimise the generalised cross-validation score of the unconstrained
    fit: on the roughness of S along pressure and along contraction; that of K, and a slight pull that makes the fit
    unique, have none."""
    second_p, second_e = np.diff(np.eye(m), 2, axis=0), np.diff(np.eye(n), 2, axis=0)
    along_p = np.hstack([np.kron(second_p, np.eye(n)), np.zeros((len(second_p) * n, m))])
    along_e = np.hstack([np.kron(np.eye(m), second_e), np.zeros((m * len(second_e), m))])
    flat_kink = np.hstack([np.zeros((m - 1, m * n)), np.diff(np.eye(m), axis=0)])
    rest = np.vstack([flat_kink, 1e-3 * np.eye(m * n + m)])
    gram, rhs = a.T @ a, a.T @ b
    gram_p, gram_e, gram_rest = (x.T @ x for x in (along_p, along_e, rest))

    def score(wp: float, we: float) -> float:
        system = gram + wp * gram_p + we * gram_e + gram_rest
        solved = np.linalg.solve(system, np.column_stack([rhs, gram]))
        freedom = len(b) - np.trace(solved[:, 1:])
        return float(np.sum((a @ solved[:, 0] - b) ** 2) / max(freedom, 1e-9) ** 2)

    best = min(product(_PENALTIES, _PENALTIES), key=lambda weights: score(*weights))
    around_p, around_e = ((w / 10, w, w * 10) for w in best)
    best = min(product(around_p, around_e), key=lambda weights: score(*weights))
    return np.vstack([np.sqrt(best[0]) * along_p, np.sqrt(best[1]) * along_e, rest])


def _shape_constraints(m: int, n: int, positive_to: int, min_fall: float, stretched: bool) -> tuple[Array, Array]:
    """Return the inequalities G x >= h on the coefficients [S row by row, then K]."""
    s = np.eye(m * n + m)[: m * n].reshape(m, n, -1)
    k = np.eye(m * n + m)[m * n :]
    fall = s[:, :-1] - s[:, 1:]
    parts = [
        (fall, min_fall),
        (s[1:, :positive_to] - s[:-1, :positive_to], _MARGIN),
        # ... and so that linear continuations, to higher pressure and to more stretch, keep both:
        (fall[-1] - fall[-3], _MARGIN),
        ((s[1:, 0] - s[1:, 2]) - (s[:-1, 0] - s[:-1, 2]), _MARGIN),
        (k[1:] - k[:-1], 0.0),
        (k[:1], 0.0),
    ]
    if not stretched:
        parts.append((-k, 0.0))
    g = np.vstack([part.reshape(-1, m * n + m) for part, _ in parts])
    h = np.concatenate([np.full(part.reshape(-1, m * n + m).shape[0], least) for part, least in parts])
    return g, h

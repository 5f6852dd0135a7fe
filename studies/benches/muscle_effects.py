"""Effects of a muscle fitted to its bench records together with its law, by variable projection.

The law and viscosity enter linearly (a coarse tensor product of B-splines, without the wishes of MuscleLaw): for every
value of the effects' parameters they are solved for, and the parameters move by Gauss-Newton on what is left (Golub and
Pereyra 1973, doi:10.1137/0710036), in the descent that fits clouds. Intervals are 90 %.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.errors import InputError
from fabdesign.geometry.curves import design_matrix
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import MUSCLE_TYPES, PARAMETERS, Term
from fabdesign.nouns.model import EffectTerm
from optimize.fit.descent import fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.problem import BenchProblem
from studies.benches.muscle import Rows, motion_columns
from studies.fitting.fitted_model import effect_term, quantities_of

_SPANS = (4, 6)  # of pressure and contraction
_RIDGE = 1e-4  # of the law's coefficients, relative to the tension's size


@dataclass(frozen=True, eq=False)
class FittedEffects:
    terms: tuple[Term, ...] = ()
    effects: tuple[EffectTerm, ...] = ()  # the same with intervals


def bench_vector(free: Sequence[str], name: str) -> FitVector:
    """Return the unknowns of `free` (as of `calibrate --free`) for the muscle type `name`. Raises InputError for an
    effect that one muscle on a bench cannot show."""
    vector = fit_vector(free, PARAMETERS, scope=MUSCLE_TYPES + name)
    for term in vector.terms:
        if EFFECTS[term.name].bench is None:
            known = [effect.name for effect in EFFECTS.values() if effect.bench is not None]
            raise InputError(
                f"--free {term.name}: one muscle on its bench does not show it; expected {', '.join(known)}"
            )
    if any(parameter.is_factor for parameter in vector.parameters):
        raise InputError(f"--free {', '.join(free)}: a bench gives the law itself; expected effects, no factors")
    # none that says what a law has from its bench: here law and effect come from the record itself
    places = [(p, *p.name.partition(".")[::2]) for p in vector.parameters]
    return replace(vector, parameters=tuple(p for p, of, key in places if not EFFECTS[of].parameters[key].tried))


def fit_effects(
    rows_of: Callable[[tuple[Term, ...]], Rows],
    vector: FitVector,
    tell: Callable[[float], None] = lambda share: None,
) -> FittedEffects:
    """Return the fitted effects. rows_of(terms): the records' rows with the effects in them. tell: is given the share
    done."""
    plain = rows_of(())
    spans, acting = _Spans.of(plain), {term.name for term in vector.terms}

    def unexplained(x: Array) -> Array:
        return spans.unexplained(rows_of(vector.terms_at(vector.inside(x))), acting)

    problem = BenchProblem(unexplained, np.zeros_like(plain.block), plain.block, vector)
    fitted = fit(problem, progress=lambda _, share: tell(share))
    deviation = np.sqrt(np.diag(fitted.covariance))
    terms = vector.terms_at(fitted.x)
    quantities = quantities_of(vector, fitted.x, deviation)
    effects = [effect_term(label, term, quantities, None) for label, term in zip(vector.labels, terms, strict=True)]
    return FittedEffects(terms, tuple(effects))


@dataclass(frozen=True)
class _Spans:
    """Where the splines lie: over what was measured, whatever the effects make of it."""

    pressure: float  # Pa between knots
    start: float
    contraction: float

    @staticmethod
    def of(rows: Rows) -> "_Spans":
        start, end = min(float(rows.contraction.min()), 0.0), max(float(rows.contraction.max()), 0.0)
        return _Spans(float(rows.pressure.max()) / _SPANS[0], start, (end - start) / _SPANS[1])

    def unexplained(self, rows: Rows, acting: Collection[str]) -> Array:
        """Return (n,) N that law and damping do not explain; no damping that one of the effects `acting` is by
        itself."""
        p = design_matrix(rows.pressure / self.pressure, _SPANS[0] + 3)
        e = design_matrix((rows.contraction - self.start) / self.contraction, _SPANS[1] + 3)
        smooth = (p[:, :, None] * e[:, None, :]).reshape(len(p), -1)
        stretch = p * (np.maximum(-rows.contraction, 0.0) / self.contraction)[:, None]
        damping = motion_columns(rows.rate, friction="braid_hysteresis" not in acting)
        if "muscle_viscosity" in acting:
            damping[:, 0] = 0.0
        columns = np.hstack([smooth, stretch, damping])
        columns = columns[:, np.abs(columns).max(axis=0) > 0]
        ridge = _RIDGE * np.sqrt(len(p)) * np.eye(columns.shape[1])
        goal = rows.force + rows.friction
        steps = np.linalg.lstsq(np.vstack([columns, ridge]), np.r_[goal, np.zeros(len(ridge))], rcond=None)[0]
        return np.asarray(goal - columns @ steps)

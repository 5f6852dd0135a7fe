"""A fit as a model: values with intervals, what each belongs to, and what is known of them jointly."""

from collections.abc import Mapping, Sequence

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.nouns.forward import MUSCLE_TYPES, OF_MUSCLES, Term
from fabdesign.nouns.model import Covariance, EffectTerm, Model, Parameter, Provenance, Quantity
from fabdesign.nouns.pressure import LearnedRange
from fabdesign.nouns.trial import Trial
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import muscle_scope
from optimize.fit.parameters import FitParameter, FitVector

QUANTILE = 1.645  # two-sided 90 %


def fitted_model(
    fit: Fit,
    covariance: np.ndarray,
    *,
    trials: Sequence[Trial],
    reliable: bool,
    points_per_side: int,
    provenance: Provenance,
) -> Model:
    """Return a fit as a model. covariance: (p, p) of its unknowns, all that intervals hold included. trials: fitted."""
    deviation = np.sqrt(np.diag(covariance))
    muscles = muscle_scope([trial.design for trial in trials])
    quantities = quantities_of(fit.vector, fit.x, deviation)
    parameters = {
        p.name: Parameter(quantities[p.name].value, quantities[p.name].interval90, reliable, _scope_of(p, muscles))
        for p in fit.vector.parameters
        if p.is_factor
    }
    for name, factor in fit.vector.factors:
        parameters.setdefault(name, Parameter(factor))
    effects, unnamed = [], False
    for label, term in zip(fit.vector.labels, fit.vector.terms_at(fit.x), strict=True):
        unnamed |= not EFFECTS[term.name].named and len(fit.vector.part(label)) > 0
        effects.append(effect_term(label, term, quantities, muscles))
    return Model(
        parameters,
        tuple(effects),
        points_per_side=points_per_side,
        provenance=provenance,
        without_effects=None if fit.without_effects is None else _plain(fit.without_effects),
        covariance=Covariance(fit.vector.names, covariance),
        learned_range=LearnedRange.of(trial.program for trial in trials) if unnamed else None,
    )


def quantities_of(vector: FitVector, x: np.ndarray, deviation: np.ndarray) -> dict[str, Quantity]:
    """Return each unknown's value with its 90 % interval, by its name. deviation: (p,) of x."""
    return {
        p.name: Quantity(p.value(v), p.unit, (p.value(v - QUANTILE * s), p.value(v + QUANTILE * s)))
        for p, v, s in zip(vector.parameters, x, deviation, strict=True)
    }


def effect_term(label: str, term: Term, quantities: Mapping[str, Quantity], muscles: str | None) -> EffectTerm:
    """Return an effect with its intervals. quantities: of its parameters that were fitted, by LABEL.PARAMETER. muscles:
    the scope of what belongs to a muscle type."""
    declared = EFFECTS[term.name]
    values = {
        key: quantities.get(f"{label}.{key}", Quantity(value, declared.parameters[key].unit))
        for key, value in declared.values(term.values).items()
    }
    scope = muscles if declared.scope == "muscle type" else declared.scope
    return EffectTerm(term.name, values, term.scope or scope)


def _plain(fit: Fit) -> dict[str, Parameter]:
    values = {p.name: Parameter(p.value(x)) for p, x in zip(fit.vector.parameters, fit.x, strict=True)}
    return values | {name: Parameter(factor) for name, factor in fit.vector.factors if name not in values}


def _scope_of(parameter: FitParameter, muscles: str | None) -> str | None:
    if parameter.name.startswith(MUSCLE_TYPES):
        return parameter.name.rpartition(".")[0]
    return muscles if parameter.name in OF_MUSCLES else "fabric"

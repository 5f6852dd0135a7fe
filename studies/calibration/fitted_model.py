"""A fit as a model: values with intervals, what each belongs to, and what is known of them jointly."""

from collections.abc import Sequence

import numpy as np

from fabdesign.design import Design
from fabdesign.effects import EFFECTS
from fabdesign.forward import MUSCLE_TYPES, OF_MUSCLES
from fabdesign.learned_range import LearnedRange
from fabdesign.model import Covariance, EffectTerm, Model, Parameter, Provenance, Quantity
from fabdesign.trial import Trial
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter

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
    """covariance: (p, p) of the fit's unknowns, whatever the intervals hold included. trials: that were fitted."""
    deviation = np.sqrt(np.diag(covariance))
    muscles = muscle_scope([trial.design for trial in trials])
    parameters, quantities = {}, {}
    for parameter, x, s in zip(fit.vector.parameters, fit.x, deviation, strict=True):
        interval = parameter.value(x - QUANTILE * s), parameter.value(x + QUANTILE * s)
        if parameter.is_factor:
            scope = _scope_of(parameter, muscles)
            parameters[parameter.name] = Parameter(parameter.value(x), interval, reliable, scope)
        else:
            quantities[parameter.name] = Quantity(parameter.value(x), parameter.unit, interval)
    for name, factor in fit.vector.factors:
        parameters.setdefault(name, Parameter(factor))
    effects, unnamed = [], False
    for label, term in zip(fit.vector.labels, fit.vector.terms_at(fit.x), strict=True):
        declared = EFFECTS[term.name]
        unnamed |= not declared.named and len(fit.vector.part(label)) > 0
        values = {
            key: quantities.get(f"{label}.{key}", Quantity(value, declared.parameters[key].unit))
            for key, value in declared.values(term.values).items()
        }
        own = muscles if declared.scope == "muscle type" else declared.scope
        effects.append(EffectTerm(term.name, values, term.scope or own))
    return Model(
        parameters,
        tuple(effects),
        points_per_side=points_per_side,
        provenance=provenance,
        without_effects=None if fit.without_effects is None else _plain(fit.without_effects),
        covariance=Covariance(fit.vector.names, covariance),
        learned_range=LearnedRange.of(trial.program for trial in trials) if unnamed else None,
    )


def _plain(fit: Fit) -> dict[str, Parameter]:
    values = {p.name: Parameter(p.value(x)) for p, x in zip(fit.vector.parameters, fit.x, strict=True)}
    return values | {name: Parameter(factor) for name, factor in fit.vector.factors if name not in values}


def muscle_scope(designs: Sequence[Design]) -> str | None:
    """Of the one muscle type that all designs use; None where there are several, or none."""
    types = {muscle.type for design in designs for muscle in design.muscles}
    return f"{MUSCLE_TYPES}{types.pop()}" if len(types) == 1 else None


def _scope_of(parameter: FitParameter, muscles: str | None) -> str | None:
    if parameter.name.startswith(MUSCLE_TYPES):
        return parameter.name.rpartition(".")[0]
    return muscles if parameter.name in OF_MUSCLES else "fabric"

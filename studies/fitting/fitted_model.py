"""A fit as a model: values with intervals, what each belongs to, and what is known of them jointly. The intervals are
wider by the difference between engines.

How far factors are off because the simulator is not the engine that made the data is estimated on two others: by
`benchmarks/coverage.py` on effect-free sets of the virtual rig, and by `benchmarks/engines.py` on sets of a third whose
true factors are known. The larger counts, since a laboratory's cloth is none of them. It acts on what the data say:
where they leave a factor to the data sheet, the engine has no part in it. Intervals hold only if the model is right but
for its factors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.formats.csv_table import decimal, read_raw_table
from fabdesign.geometry.metrics import over
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import CAP
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import MUSCLE_TYPES, OF_MUSCLES, PARAMETERS, Term
from fabdesign.nouns.model import NORMAL90, Covariance, EffectTerm, Model, Parameter, Provenance, Quantity
from fabdesign.nouns.pressure import LearnedRange
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import muscle_scope
from optimize.fit.parameters import DECLARED, FitParameter, FitVector

FILE = Path(__file__).parent / "engine_difference.csv"
EXCESS = 0.0005  # m over the noise that a right model may leave
OUTLYING = 0.03  # share of frames far off from which on it is said


def engine_columns() -> dict[str, dict[str, float]]:
    """Return the standard deviations of logarithms, mean error included, by engine and factor."""
    (_, *engines), rows, *_ = read_raw_table(FILE)
    return {
        engine: {name: float(decimal(values[k], FILE, line, name)) for line, (name, *values) in rows}
        for k, engine in enumerate(engines)
    }


def engine_difference(vector: FitVector = DECLARED) -> Array:
    """Return (p,) standard deviations of the unknowns for the engine that differs most; 0 for effects' parameters, of
    which none is known."""
    columns = engine_columns().values()
    values = {name: max(column[name] for column in columns) for name in PARAMETERS}
    return np.array(
        [
            values.get(name.rpartition(".")[2], 0.0) if p.is_factor else 0.0
            for name, p in zip(vector.names, vector.parameters, strict=True)
        ]
    )


def data_share(deviation: Array, vector: FitVector = DECLARED) -> Array:
    """Return the share (..., p) of the data in the fitted unknowns, the prior's being the rest. deviation: (..., p),
    their standard deviations."""
    return np.clip(1 - np.square(deviation / vector.prior), 0.0, 1.0)


def with_engines(fit: Fit, engines: Array | None = None) -> Array:
    """Return the covariance (p, p) of a fit, wider by the engines' difference where data, not the data sheet, decide.
    engines: (p,) standard deviations of the unknowns, by default those of the virtual rig."""
    difference = engine_difference(fit.vector) if engines is None else engines
    share = data_share(np.sqrt(np.diag(fit.covariance)), fit.vector)
    return np.asarray(fit.covariance + np.diag(np.square(share * difference)))


def noise_rms(noise: SensorNoise) -> float:
    """Return the RMS, m, of capped distances of points on the surface but for the sensor's noise and strays."""
    reach = max(noise.stray_reach, 1e-12)
    inner = min(reach, CAP)  # strays are even over the reach
    stray = (inner**3 / 3 + (reach - inner) * CAP**2) / reach
    return float(np.sqrt((1 - noise.strays) * noise.sigma**2 + noise.strays * stray))


def excess(rms: float, noise: SensorNoise) -> float:
    """Return what a capped RMS `rms` [m] has over the noise, in quadrature, m."""
    return over(rms, noise_rms(noise))


def expected_rms(noise: SensorNoise, model_error: float = EXCESS) -> float:
    """Return the capped RMS, m, of which `model_error` [m] is over the noise, in quadrature."""
    return float(np.hypot(noise_rms(noise), model_error))


def interval_warnings(rms: float, outlying: float, noise: SensorNoise) -> list[str]:
    """Return why the intervals of a fit that leaves `rms` [m] and a share of frames far off are not reliable."""
    warnings = []
    if not (remaining := excess(rms, noise)) <= EXCESS:
        warnings.append(f"the fit leaves {in_mm(remaining):.2f} mm over the noise, expected at most {in_mm(EXCESS):g}")
    if outlying >= OUTLYING:
        warnings.append(f"{outlying:.0%} of the frames fitted are far off, expected under {OUTLYING:.0%}")
    return warnings


def far_factors(fit: Fit) -> list[str]:
    """Return that the factors are not plausible, and which; nothing where they are."""
    vector, x = fit.vector, fit.x
    if vector.is_plausible(x):
        return []
    implausible = np.flatnonzero(vector.are_factors & (np.abs(x) > 2 * vector.prior))
    far = [f"{vector.names[k].replace('_', ' ')} {vector.parameters[k].value(x[k]):.2f}" for k in implausible]
    return [
        f"the factors are farther from the data sheet than those of one specimen in a thousand ({', '.join(far)}): an "
        "effect that the model lacks may hide in them"
    ]


def fitted_model(
    fit: Fit,
    covariance: np.ndarray,
    *,
    trials: Sequence[Trial],
    points_per_side: int,
    provenance: Provenance,
) -> Model:
    """Return a fit as a model. covariance: (p, p) of its unknowns, all that intervals hold included. trials: fitted."""
    deviation = np.sqrt(np.diag(covariance))
    muscles = muscle_scope([trial.design for trial in trials])
    quantities = quantities_of(fit.vector, fit.x, deviation)
    parameters = {
        p.name: Parameter(quantities[p.name].value, quantities[p.name].interval90, scope=_scope_of(p, muscles))
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


def doubted(model: Model) -> Model:
    """Return a model whose fit left too much for the intervals of its factors to hold."""
    factors = {k: p if p.interval90 is None else replace(p, reliable=False) for k, p in model.parameters.items()}
    return replace(model, parameters=factors)


def quantities_of(vector: FitVector, x: np.ndarray, deviation: np.ndarray) -> dict[str, Quantity]:
    """Return each unknown's value with its 90 % interval, by its name. deviation: (p,) of x."""
    return {
        p.name: Quantity(p.value(v), p.unit, (p.value(v - NORMAL90 * s), p.value(v + NORMAL90 * s)))
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

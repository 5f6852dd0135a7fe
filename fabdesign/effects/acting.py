"""A case's effects at work: the specimen and the pressures that they leave, and what is observed of it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import ActingPressure, Effect, Specimen
from fabdesign.effects.registry import check_values, effect_named
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import MUSCLE_TYPES, Case, Term


def terms_of(case: Case) -> tuple[Term, ...]:
    """Return what acts in a case: what its design's benches found, then its own. An effect of the case replaces the
    design's of the same name and scope; one without a scope those of any."""
    acting = {(term.name, term.scope) for term in case.effects}
    declared = (t for t in case.design.effects if not {(t.name, t.scope), (t.name, None)} & acting)
    return (*declared, *case.effects)


def active(case: Case) -> Iterator[tuple[Effect, dict[str, float], Term]]:
    """Yield each effect that is not off, with all its values; what is learned comes last, since it adds to what named
    effects set. Raises InputError for an unknown one or a bad value."""
    terms = [(effect_named(term.name, "effects"), term) for term in terms_of(case)]
    for effect, term in sorted(terms, key=lambda each: not each[0].named):
        check_values(effect, term.values, "effects")
        if not effect.is_off(term.values):
            yield effect, effect.values(term.values), term


def specimen_of(case: Case) -> Specimen:
    """Return the case's design with its scale factors and effects in its constants."""
    muscles = case.design.muscles

    def factors(name: str) -> Array:
        common = case.factors.get(name, 1.0)
        return np.array([case.factors.get(f"{MUSCLE_TYPES}{m.type}.{name}", common) for m in muscles], dtype=float)

    specimen = Specimen(
        case.design,
        case.factors,
        case.order,
        {
            "gain": factors("muscle_gain"),
            "lever": factors("axis_offset"),
            "pressure_loss": np.zeros(len(muscles)),
        },
    )
    for effect, values, term in active(case):
        if effect.specimen is not None:
            specimen = effect.specimen(specimen, values, muscles_of(case, term))
    return specimen


def muscles_of(case: Case, term: Term) -> NDArray[np.bool_]:
    """Return (m,) whether a term acts on each muscle of the case's design."""
    scope = term.scope
    type_name = scope.removeprefix(MUSCLE_TYPES) if scope is not None and scope.startswith(MUSCLE_TYPES) else None
    return np.array([type_name is None or muscle.type == type_name for muscle in case.design.muscles], dtype=bool)


def acting_pressure(case: Case, ticks: int, tick: float) -> ActingPressure:
    """Return the pressures that act in the case over `ticks` ticks of `tick` s each."""
    acting = ActingPressure(case.program, ticks, tick)
    for effect, values, _ in active(case):
        if effect.pressure is not None:
            acting = effect.pressure(acting, values)
    return acting


def seen_at(case: Case, times: Array) -> Array:
    """Return (T,) s: the instants whose shapes frames of these `times` show."""
    for effect, values, _ in active(case):
        if effect.clock is not None:
            times = effect.clock(times, values)
    return times


def is_sensing(name: str) -> bool:
    """Return whether an effect changes only what is observed of a motion."""
    return effect_named(name, "effects").site == "sensing"


def observed(case: Case, points: NDArray[Any]) -> NDArray[Any]:
    """Return (..., 3) m: points of the cloth as the sensors give them."""
    for effect, values, _ in active(case):
        if effect.observed is not None:
            points = effect.observed(points, values).astype(points.dtype)
    return points

"""A second look, from the data sheet, where no candidate is certain at the refitted model.

A large effect drives the refit far off: the declared parameters take what they can of it, and the differences there say
little. Here every effect is put into the model at a few sizes at the data sheet, where the truth is near once the right
one is there; the declared parameters move to first order along.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.effects import EFFECTS
from studies.calibration.clouds import cut
from studies.tracing.dictionary import Variant, added_of, entries_of
from studies.tracing.fit import LOST, Bench, State, expected
from studies.tracing.vector import FACTORS, Added, Array, value_at

UNTIL = 1.5  # s of a trial that is looked at


@dataclass(frozen=True, eq=False)
class Start:
    """An effect at its most promising place. x: (size,) of the vector with it; expected: m^2, the mean square of the
    residuals once the declared parameters have moved to first order."""

    effect: str
    added: Added
    x: Array
    expected: float


def starts_from_sheet(
    bench: Bench, state: State, types: list[str], channels: int, known: Sequence[str] = ()
) -> list[Start]:
    """Of every effect that is not in the model yet its best start, the most promising first. The effects that the state
    has stay where they are."""
    bench = replace(bench, samples=[cut(sample, UNTIL) for sample in bench.samples])
    vector = state.vector
    sheet = np.concatenate([np.zeros(FACTORS), state.x[FACTORS:]])
    base = bench.with_slopes(bench.states(vector, [sheet])[0])
    _, variants = entries_of(channels, [*known, *(added.name for added in vector.added)])
    places: dict[str, tuple[Added, list[Array]]] = {}
    for variant in variants:
        for added, begin in _places(variant, types):
            places.setdefault(repr(added), (added, []))[1].append(np.concatenate([sheet, begin]))
    found: dict[str, Start] = {}
    for added, xs in places.values():
        for other in bench.states(vector.with_effect(added), xs):
            lost = np.isnan(other.found.residual).mean() > LOST
            left = np.inf if lost else expected(bench, base, other)
            if added.name not in found or left < found[added.name].expected:
                found[added.name] = Start(added.name, added, other.x, left)
    return sorted(found.values(), key=lambda start: start.expected)


def _places(variant: Variant, types: list[str]) -> list[tuple[Added, Array]]:
    """The effect at the variant's shape and size, each strength alone up and, where its bounds allow, down."""
    effect = EFFECTS[variant.effect]
    places = []
    for k, name in enumerate(effect.strengths):
        for sign in (1.0, -1.0):
            parameter = effect.parameters[name]
            if value_at(parameter, sign * variant.size) == parameter.off:
                continue
            coefficients = [sign * float(j == k) for j in range(len(effect.strengths))]
            places.append(added_of(variant, coefficients, types))
    return places

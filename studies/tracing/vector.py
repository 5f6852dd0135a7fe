"""The vector of a fit: the declared factors, then the parameters of the effects that were added, all in units of their
prior's standard deviations, so that the prior is a standard normal one."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects import EFFECTS, EffectParameter
from fabdesign.forward import MUSCLE_TYPES, PARAMETERS, Case, Term
from fabdesign.trial import Trial
from studies.calibration.parameters import PRIOR

Array = NDArray[np.float64]
FACTORS = len(PARAMETERS)
WIDE = 2.0  # times the declared deviation: that of a fitted effect, which was chosen because it is there


@dataclass(frozen=True)
class Added:
    """An effect of the model that is fitted: the parameters that are free, and the values of those that are not."""

    name: str
    free: tuple[str, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    scope: str | None = None

    @property
    def declared(self) -> list[EffectParameter]:
        return [EFFECTS[self.name].parameters[name] for name in self.free]

    def values(self, x: Array) -> dict[str, float]:
        """All values at `x`, those of its free parameters, within their bounds."""
        return {**self.fixed, **{n: value_at(p, float(v)) for n, p, v in zip(self.free, self.declared, x, strict=True)}}

    def term(self, x: Array) -> Term:
        return Term(self.name, self.values(x), self.scope)


@dataclass(frozen=True)
class Vector:
    """What is fitted: the declared factors and these effects."""

    added: tuple[Added, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*PARAMETERS, *(f"{a.name}.{p}" for a in self.added for p in a.free))

    @property
    def size(self) -> int:
        return FACTORS + sum(len(a.free) for a in self.added)

    @property
    def precision(self) -> Array:
        """(size,) of the prior."""
        return np.concatenate([np.ones(FACTORS), np.full(self.size - FACTORS, 1 / WIDE**2)])

    def centre(self) -> Array:
        """(size,) the data sheet, with every effect off and its shape typical."""
        return np.zeros(self.size)

    def factors(self, x: Array) -> dict[str, float]:
        logs = [PRIOR[name] * v for name, v in zip(PARAMETERS, x, strict=False)]
        return {name: float(np.exp(v)) for name, v in zip(PARAMETERS, logs, strict=True)}

    def terms(self, x: Array) -> tuple[Term, ...]:
        return tuple(a.term(x[part]) for a, part in zip(self.added, self.parts(), strict=True))

    def parts(self) -> list[slice]:
        """Where each effect's parameters are."""
        ends = FACTORS + np.cumsum([0, *(len(a.free) for a in self.added)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends.tolist())]

    def case(self, trial: Trial, x: Array, more: tuple[Term, ...] = ()) -> Case:
        return Case(trial.design, trial.program, self.factors(x), (*self.terms(x), *more), trial.order)

    def within(self, x: Array) -> Array:
        """`x` with effects' parameters moved into their bounds."""
        x = x.copy()
        for added, part in zip(self.added, self.parts(), strict=True):
            x[part] = [place_of(p, value_at(p, float(v))) for p, v in zip(added.declared, x[part], strict=True)]
        return x

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(size,) twice: the least and the largest place of each parameter."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for added, part in zip(self.added, self.parts(), strict=True):
            low[part], high[part] = np.transpose([[place_of(p, b) for b in p.bounds] for p in added.declared])
        return low, high

    def with_effect(self, added: Added) -> "Vector":
        return replace(self, added=(*self.added, added))


def value_at(parameter: EffectParameter, x: float) -> float:
    """The value that lies `x` prior standard deviations from the prior's centre, within the bounds."""
    moved = parameter.deviation * x
    value = parameter.centre * np.exp(moved) if parameter.transform == "log" else parameter.centre + moved
    return float(np.clip(value, *parameter.bounds))


def place_of(parameter: EffectParameter, value: float) -> float:
    """The inverse of `value_at`."""
    if parameter.transform == "log":
        return float(np.log(value / parameter.centre) / parameter.deviation)
    return float((value - parameter.centre) / parameter.deviation)


def scope_of(name: str, types: list[str]) -> str | None:
    """The scope of an effect found on designs with these muscle types: its declared one, for a muscle's the one type;
    None where there are several, which it then belongs to alike."""
    scope = EFFECTS[name].scope
    if scope != "muscle type":
        return scope
    return f"{MUSCLE_TYPES}{types[0]}" if len(types) == 1 else None

"""Unknowns of a fit: factors on declared values, and the parameters of effects, each with its transform and prior.

The unknown of a parameter is x = t(value) - t(centre), t the logarithm or nothing; its prior is normal about zero.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fabdesign.effects.registry import EFFECTS, label_effect, labels_of
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column
from fabdesign.nouns.forward import FACTOR_RANGE, MUSCLE_TYPES, PARAMETERS, Case, Term
from fabdesign.nouns.trial import Trial

# Standard deviations of the logarithms: data sheets are good to tens of percent, their damping to 30 %. A cloth's mass
# per area is sold to some 5 % and weighed in a minute. It alone says how large all forces are: a hung cloth moves the
# same where stiffness, weight, damping and muscles' gain are all twice as much.
TYPICAL = 0.15  # also counts as a factor's where steps are judged
PRIOR = dict.fromkeys(PARAMETERS, TYPICAL) | {"areal_density": 0.05, "damping": 0.30}


@dataclass(frozen=True)
class FitParameter:
    """One unknown of a fit. name: that of a factor, or EFFECT.PARAMETER."""

    name: str
    deviation: float  # of the prior, of x
    centre: float = 1.0  # value at x = 0
    transform: Literal["linear", "log"] = "log"
    unit: str = "1"
    bounds: tuple[float, float] = FACTOR_RANGE  # of the value
    start: float = 0.0  # x at which a fit begins

    def value(self, x: float) -> float:
        moved = self.centre * float(np.exp(x)) if self.transform == "log" else self.centre + float(x)
        return min(max(moved, self.bounds[0]), self.bounds[1])

    def unknown(self, value: float) -> float:
        """Return x of a value."""
        if self.transform == "log":
            return float(np.log(value / self.centre))
        return value - self.centre

    @property
    def limits(self) -> tuple[float, float]:
        """Return the least and the largest x."""
        return self.unknown(self.bounds[0]), self.unknown(self.bounds[1])

    @property
    def is_factor(self) -> bool:
        return self.name in PARAMETERS or self.name.startswith(MUSCLE_TYPES)


@dataclass(frozen=True)
class FitVector:
    """The unknowns of a fit, in order, and what it holds: factors, and effects whose parameters may be among them."""

    parameters: tuple[FitParameter, ...]
    factors: tuple[tuple[str, float], ...] = ()
    terms: tuple[Term, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def prior(self) -> Array:
        """Return the standard deviations (p,) of x."""
        return np.array([parameter.deviation for parameter in self.parameters])

    @cached_property
    def precision(self) -> Array:
        """Return the precision (p, p) of the prior, of x."""
        return np.diag(1 / self.prior**2)

    @cached_property
    def are_factors(self) -> NDArray[np.bool_]:
        """Return which of the unknowns (p,) are factors, not parameters of effects."""
        return np.array([parameter.is_factor for parameter in self.parameters], dtype=bool)

    @cached_property
    def scale(self) -> Array:
        """Return (p,) of x that counts as much as 1 of a factor's logarithm for the length of a step."""
        return np.array([1.0 if p.is_factor else p.deviation / TYPICAL for p in self.parameters])

    @cached_property
    def start(self) -> Array:
        return np.array([parameter.start for parameter in self.parameters])

    @property
    def without_effects(self) -> "FitVector":
        """Return the vector of the factors alone."""
        return FitVector(tuple(p for p in self.parameters if p.is_factor), self.factors)

    @cached_property
    def limits(self) -> Array:
        """Return the limits (2, p) of x."""
        return np.array([parameter.limits for parameter in self.parameters]).T.reshape(2, -1)

    def inside(self, x: Array) -> Array:
        return np.clip(x, *self.limits)

    def is_plausible(self, x: Array) -> bool:
        """Return whether the factors at x are among 999 in 1000 of their prior, by chi squared of their distance."""
        squares = np.square(x / self.prior)[self.are_factors]
        return float(squares.sum()) <= float(chdtri(max(len(squares), 1), _RARE))

    def factors_at(self, x: Array) -> dict[str, float]:
        fitted = {p.name: p.value(v) for p, v in zip(self.parameters, x, strict=True) if p.is_factor}
        return {**dict(self.factors), **fitted}

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Return each term's name, which begins its parameters': its effect, and of several of one what was chosen."""
        return labels_of(self.terms)

    def terms_at(self, x: Array) -> tuple[Term, ...]:
        values = {p.name: p.value(v) for p, v in zip(self.parameters, x, strict=True)}
        return tuple(
            replace(
                term,
                values={**term.values} | {
                    key: values[f"{label}.{key}"]
                    for key in EFFECTS[term.name].parameters if f"{label}.{key}" in values
                },
            )
            for label, term in zip(self.labels, self.terms, strict=True)
        )  # fmt: skip

    def part(self, label: str) -> NDArray[np.intp]:
        """Return which unknowns are those of a term."""
        return np.flatnonzero([name.rpartition(".")[0] == label and "." in name for name in self.names])

    def strengths(self, label: str) -> NDArray[np.intp]:
        """Return which unknowns switch a term off; all of it where none of them does."""
        part, keys = self.part(label), EFFECTS[label_effect(label)].strengths
        strengths = [k for k in part if self.names[k].rpartition(".")[2] in keys]
        return np.array(strengths, dtype=np.intp) if strengths else part

    def parts(self, labels: Iterable[str]) -> NDArray[np.intp]:
        """Return which unknowns are those of several terms, one after another."""
        return np.concatenate([np.zeros(0, dtype=np.intp), *(self.part(label) for label in labels)])

    def idle(self, channels: int) -> Array:
        """Return (k, p) unit directions along which no motion of designs with so many channels changes: a factor up and
        all choices of an effect that adds up to it down as much, where all are unknown."""
        rows = []
        for effect in {term.name: EFFECTS[term.name] for term in self.terms}.values():
            labels = [label for label, term in zip(self.labels, self.terms, strict=True) if term.name == effect.name]
            part = self.parts(labels)
            if effect.adds_up_to in self.names and len(part) == len(labels) == channels:
                row = np.zeros(len(self.parameters))
                row[self.names.index(effect.adds_up_to)], row[part] = 1.0, -1.0
                rows.append(row / np.linalg.norm(row))
        return np.array(rows).reshape(len(rows), len(self.parameters))

    def only(self, labels: Collection[str]) -> tuple["FitVector", NDArray[np.intp]]:
        """Return the factors and the terms of `labels`, named as they then are, and which unknowns these keep."""
        kept = [k for k, label in enumerate(self.labels) if label in labels]
        terms = tuple(self.terms[k] for k in kept)
        named = dict(zip((self.labels[k] for k in kept), labels_of(terms), strict=True))
        index = [k for k, p in enumerate(self.parameters) if p.is_factor or p.name.rpartition(".")[0] in named]
        parameters = []
        for parameter in (self.parameters[k] for k in index):
            label, _, key = parameter.name.rpartition(".")
            parameters.append(parameter if parameter.is_factor else replace(parameter, name=f"{named[label]}.{key}"))
        return FitVector(tuple(parameters), self.factors, terms), np.array(index, dtype=np.intp)

    def case(self, trial: Trial, x: Array) -> Case:
        return Case(trial.design, trial.program, self.factors_at(x), self.terms_at(x), trial.order)

    def column(self, k: int, step: float) -> Column:
        """Return an unknown as a column, moved by a `step` of its prior's deviation; a case's terms are the vector's,
        behind those that a model has."""
        parameter = self.parameters[k]
        label, _, key = parameter.name.rpartition(".")
        term = None if parameter.is_factor else self.labels.index(label) - len(self.terms)

        def x_of(case: Case) -> float:
            if term is None:
                return parameter.unknown(case.factors.get(parameter.name, 1.0))
            return parameter.unknown(case.effects[term].values[key])

        def moved(case: Case, by: float) -> Case:
            value = parameter.value(x_of(case) + by)
            if term is None:
                return replace(case, factors={**case.factors, parameter.name: value})
            effects = [*case.effects]
            effects[term] = replace(effects[term], values={**effects[term].values, key: value})
            return replace(case, effects=tuple(effects))

        def room(case: Case) -> tuple[float, float]:
            low, high = parameter.limits
            return low - x_of(case), high - x_of(case)

        size = step * parameter.deviation
        return Column(parameter.name, "1", size, size, moved, room, differences=False)

    def steps(self, x: Array, rows: Array) -> Array:
        """Return (p, p) differences from x that stay within the limits: the rows, turned round where that keeps them
        in, or of single unknowns where their cut ones would not tell all apart."""
        chosen = np.array([self._step(x, row) for row in rows])
        scaled = chosen / self.scale
        lengths = np.linalg.norm(scaled, axis=1)
        if lengths.min() > 0 and np.linalg.cond(scaled / lengths[:, None]) < _ILL:
            return chosen
        sizes = np.abs(rows).max(axis=0)
        low, high = self.limits
        return np.diag(np.where(x + sizes <= high, sizes, -np.minimum(sizes, x - low)))

    def _step(self, x: Array, row: Array) -> Array:
        steps = [self.inside(x + sign * row) - x for sign in (1.0, -1.0)]
        unclipped = [step for step in steps if np.allclose(np.abs(step), np.abs(row))]
        return (unclipped or [max(steps, key=lambda step: float(np.abs(step / self.scale).sum()))])[0]


_ILL = 1e6
_RARE = 0.001

DECLARED = FitVector(tuple(FitParameter(name, PRIOR[name]) for name in PARAMETERS))

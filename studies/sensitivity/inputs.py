"""The inputs of a sweep: a point of the unit cube becomes a case."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtri

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.study_files.sensitivity_file import SensitivityStudy, moved_paths
from fabdesign.units import from_kpa

JOINT = "covariance"  # the group of all that the model's covariance covers
WITHIN = 0.90  # of a normal distribution, what Morris' levels span


@dataclass(frozen=True, eq=False)
class Inputs:
    """The inputs that vary in a study: first its own parameters, then the model's, as independent standard normals.

    The k-th normal is what the k-th parameter of the covariance has of its own, given those before it.
    """

    study: SensitivityStudy

    @cached_property
    def names(self) -> tuple[str, ...]:
        return (*(v.name for v in self.study.varied), *(f"{JOINT}: {name}" for name in self._joint))

    @property
    def units(self) -> tuple[str, ...]:
        return (*(v.unit for v in self.study.varied), *["standard deviations"] * len(self._joint))

    @property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Inputs by what a Sobol index is given for: each of them, and the covariance as a whole."""
        single = {name: (i,) for i, name in enumerate(self.names)}
        together = tuple(range(len(self.study.varied), len(self.names)))
        return single | ({JOINT: together} if len(together) > 1 else {})

    @property
    def _joint(self) -> tuple[str, ...]:
        return self._ensemble.names if self.study.joint else ()

    @cached_property
    def _ensemble(self) -> Ensemble:
        return Ensemble(self.study.model or Model())

    def values(self, cube: Array, *, screened: bool = False) -> Array:
        """Return (n, inputs) in their units, of points of the unit cube. screened: its edges are those of a 90 %
        interval where an input is normal, as Morris' levels need it."""
        low, high = (np.array([getattr(v, side) for v in self.study.varied]) for side in ("low", "high"))
        varied = low + (high - low) * cube[:, : len(low)]
        rest = cube[:, len(low) :]
        return np.concatenate([varied, ndtri((1 - WITHIN) / 2 + WITHIN * rest if screened else rest)], axis=1)

    def case(self, values: Array, spread: Array | None = None) -> Case:
        """Return the case of (inputs,) values. spread: (channels,) factors on the pressures."""
        study, given = self.study, dict(zip(self.study.varied, values, strict=False))
        model = study.model or Model()
        if study.joint:
            model = self._ensemble.at(values[len(given) :])
        pressures = study.pressures.copy()
        for v, x in given.items():
            if v.kind == "pressure":
                pressures[int(v.key[0])] = from_kpa(x)
        factors = {str(v.key[0]): float(x) for v, x in given.items() if v.kind == "factor"}
        terms = model.terms
        for v, x in given.items():
            if v.kind == "effect":
                terms = _with(terms, str(v.key[0]), str(v.key[1]), float(x))
        shifts = {v.key: float(x) for v, x in given.items() if v.kind == "position"}
        program = constant_program(pressures if spread is None else pressures * spread)
        return Case(_moved(study.design, shifts), program, model.factors | factors, terms, study.order)

    @property
    def centre(self) -> Array:
        """(inputs,) the middle of every range."""
        return self.values(np.full((1, len(self.names)), 0.5))[0]


def _with(terms: tuple[Term, ...], name: str, parameter: str, value: float) -> tuple[Term, ...]:
    """Return the effects with one number changed; an effect that is not there comes last."""
    if all(term.name != name for term in terms):
        return (*terms, Term(name, {parameter: value}))
    return tuple(replace(t, values={**t.values, parameter: value}) if t.name == name else t for t in terms)


def _moved(design: Design, shifts: dict[Any, float]) -> Design:
    if not shifts:
        return design
    paths = moved_paths(design, shifts)
    muscles = tuple(
        replace(muscle, path=tuple((float(u), float(v)) for u, v in path))
        for muscle, path in zip(design.muscles, paths, strict=True)
    )
    return replace(design, muscles=muscles)

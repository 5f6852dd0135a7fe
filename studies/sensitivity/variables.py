"""The variables of a sweep. Inputs: a point of the unit cube becomes a case. Outputs: numbers in mm, 1/m and N."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.shape import mean_curvature, tip
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.study_files.sensitivity_file import Output, SensitivityStudy, moved_paths
from fabdesign.study_files.study_targets import ShapeOutput, read_shape_output
from fabdesign.units import from_kpa, in_mm
from optimize.search.objective import Objective, Target

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
        return (*(v.name for v in self.study.varied), *(f"{JOINT}: {name}" for name in self._ensemble.names))

    @property
    def units(self) -> tuple[str, ...]:
        return (*(v.unit for v in self.study.varied), *["standard deviations"] * self._ensemble.size)

    @property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Return inputs by what a Sobol index is given for: each of them, and the covariance as a whole."""
        single = {name: (i,) for i, name in enumerate(self.names)}
        together = tuple(range(len(self.study.varied), len(self.names)))
        return single | ({JOINT: together} if len(together) > 1 else {})

    @cached_property
    def _ensemble(self) -> Ensemble:
        model = self.study.model or Model()
        return Ensemble(model if self.study.joint else replace(model, covariance=None))

    def values(self, cube: Array, part: str) -> Array:
        """Return (n, inputs) in their units, of points of the unit cube; for the part "morris" its edges are those of a
        90 % interval where an input is normal, as its levels need it."""
        low, high = (np.array([getattr(v, side) for v in self.study.varied]) for side in ("low", "high"))
        varied = low + (high - low) * cube[:, : len(low)]
        rest = cube[:, len(low) :]
        return np.concatenate([varied, ndtri((1 - WITHIN) / 2 + WITHIN * rest if part == "morris" else rest)], axis=1)

    def case(self, values: Array, spread: Array | None = None) -> Case:
        """Return the case of (inputs,) values. spread: (channels,) factors on the pressures."""
        study, given = self.study, dict(zip(self.study.varied, values, strict=False))
        model, pressures = self._ensemble.at(values[len(given) :]), study.pressures.copy()
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
        """Return (inputs,) the middle of every range."""
        return self.values(np.full((1, len(self.names)), 0.5), "sobol")[0]


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


_LEAST_OF_SHAPE = 1e-2  # mm or degrees, of an output that a study says in words
ROUNDING = 1e-9  # of outputs of unknown unit


@dataclass(frozen=True)
class OutputColumn:
    name: str
    unit: str
    least: float  # standard deviation, in the unit, under which it does not vary


COLUMNS = {
    "tip": [OutputColumn(f"tip_{axis}", "mm", 1e-2) for axis in "xyz"],
    "mean_curvature": [OutputColumn("mean_curvature", "1/m", 1e-3)],
    "chamfer": [OutputColumn("chamfer", "mm", 1e-3)],
    "largest_tension": [OutputColumn("largest_tension", "N", 1e-3)],
}


@dataclass(frozen=True, eq=False)
class Outputs:
    """names: of COLUMNS, or outputs in words (`shape_output`). functions: see SensitivityStudy. rest (3362, 3)
    m: what `tip` is measured from. target: of `chamfer`; of markers it is their mean distance to the cloth. at: s;
    none: at rest."""

    names: tuple[str, ...]
    fabric: Fabric
    rest: Array
    target: Target | None = None
    at: tuple[float, ...] = ()
    functions: Mapping[str, Output] = field(default_factory=dict)

    @property
    def columns(self) -> list[OutputColumn]:
        moments = [f" at {t:g} s" for t in self.at] or [""]
        every = [column for name in self.names for column in self._columns_of(name)]
        asked = [replace(column, name=column.name + moment) for moment in moments for column in every]
        return asked + [OutputColumn(name, "", ROUNDING) for name in self.functions]

    @cached_property
    def _in_words(self) -> dict[str, ShapeOutput]:
        return {name: read_shape_output(name, self.fabric, "outputs") for name in self.names if name not in COLUMNS}

    def _columns_of(self, name: str) -> list[OutputColumn]:
        return COLUMNS.get(name) or [OutputColumn(name, self._in_words[name].unit, _LEAST_OF_SHAPE)]

    def of(self, frames: NDArray[np.float32], tension: NDArray[np.float32] | None) -> Array:
        """Return (columns,) of (T, 3362, 3) m, and of the intervals' tensions (T, intervals) N where they are watched;
        NaN where a frame is."""
        values: list[float] = []
        for k, points in enumerate(frames):
            lost = not np.isfinite(points).all()
            for name in self.names:
                if lost:
                    values += [np.nan] * len(self._columns_of(name))
                elif name in self._in_words:
                    values.append(self._in_words[name].of(points))
                elif name == "tip":
                    values += (in_mm(tip(points, self.fabric) - tip(self.rest, self.fabric))).tolist()
                elif name == "mean_curvature":
                    values.append(mean_curvature(points))
                elif name == "chamfer":
                    assert self.target is not None
                    values.append(in_mm(Objective((self.target,)).value(points[None])))
                else:
                    assert tension is not None
                    values.append(float(tension[k].max(initial=0.0)))
        time, lost = np.array(self.at or (0.0,)), not np.isfinite(frames).all()
        values += [np.nan if lost else float(function(time, frames)) for function in self.functions.values()]
        return np.array(values)


LEVELS = 4  # of Morris' grid
STEP = LEVELS / (2 * (LEVELS - 1))  # of an elementary effect: 2/3, which makes all levels equally likely
_EDGE = 1e-6  # of the cube, where a normal distribution has no value


def trajectories(inputs: int, count: int, seed: int) -> Array:
    """Return (count, inputs + 1, inputs): one input a step, in a random order, up or down (Morris 1991)."""
    rng = np.random.default_rng([seed, 1])
    low = np.arange(LEVELS // 2) / (LEVELS - 1)  # from where a step up stays within the cube
    paths = np.empty((count, inputs + 1, inputs))
    for path in paths:
        up = rng.random(inputs) < 0.5
        start = rng.choice(low, inputs)
        moved = rng.permutation(inputs)  # the step at which each input does
        on = np.arange(inputs + 1)[:, None] > moved
        path[:] = start + STEP * np.where(up, on, ~on)
    return paths


def saltelli_rows(inputs: int, groups: Sequence[Sequence[int]], count: int, seed: int) -> Array:
    """Return (count, 2 + groups, inputs): a, b, and a with each group's inputs from b (Saltelli et al. 2010), where (a,
    b) are scrambled Sobol points."""
    points = qmc.Sobol(2 * inputs, rng=np.random.default_rng([seed, 2])).random_base2(int(np.ceil(np.log2(count))))
    a, b = np.clip(points[:count, :inputs], _EDGE, 1 - _EDGE), np.clip(points[:count, inputs:], _EDGE, 1 - _EDGE)
    rows = np.stack([a, b, *[a] * len(groups)], axis=1)
    for k, group in enumerate(groups):
        rows[:, 2 + k, list(group)] = b[:, list(group)]
    return rows

"""The outputs of a shape that a sweep watches: numbers for people, in mm, 1/m and N."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.metrics import chamfer_to, distance_to_faces
from fabdesign.geometry.shape import mean_curvature, tip
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.study_files.sensitivity_file import Output
from fabdesign.study_files.study_targets import ShapeOutput, read_shape_output
from fabdesign.units import in_mm
from studies.layout_search.target import LoadedTarget

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
    target: LoadedTarget | None = None
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
                    values.append(in_mm(_distance(self.target, points)))
                else:
                    assert tension is not None
                    values.append(float(tension[k].max(initial=0.0)))
        time, lost = np.array(self.at or (0.0,)), not np.isfinite(frames).all()
        values += [np.nan if lost else float(function(time, frames)) for function in self.functions.values()]
        return np.array(values)


def _distance(target: LoadedTarget, points: NDArray[np.float32]) -> float:
    """Return the distance [m]."""
    if target.landmarks is not None:
        return target.landmarks.mean(points)
    target = target.beside(np.asarray(points, float))
    if target.markers:
        return distance_to_faces(target.points, points, target.face, target.weighting)
    return chamfer_to(points, target.face, target.weighting).of(target.points)


def needs_tension(names: Sequence[str]) -> bool:
    return "largest_tension" in names

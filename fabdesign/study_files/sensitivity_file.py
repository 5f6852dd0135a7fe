"""Study files of kind "sensitivity": what is varied, what is watched, and how much of it is computed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.design_file import read_design
from fabdesign.formats.schema import ABOVE_0, GRIDS, Key, Second, Within
from fabdesign.formats.table import Table
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import HOLD, RISE
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import covered, joint_root
from fabdesign.nouns.pressure import limits
from fabdesign.runtime.effort import LONGEST
from fabdesign.study_files.shape_output import EXPECTED, read_shape_output
from fabdesign.study_files.study_file import START_PRESSURES, Hold, Name, Order, Rise, Seed, StudyModel, study_of
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.study_files.varied_inputs import LowHigh, Varied, read_varied

Output = Callable[[NDArray[np.float64], NDArray[np.float32]], float]
METHODS = ("morris", "sobol")
OUTPUTS = ("tip", "mean_curvature", "chamfer", "largest_tension")
MOST = 1 << 16  # rows, trajectories: far more than anybody waits for
GRID = 21  # points a side: docs/lab/sensitivity.md says what 41 would change
MIDDLE = 200e3  # Pa, of channels that nothing is said of


def _outputs(value: tuple[str, ...], table: Table) -> tuple[str, ...] | None:
    """Return names of OUTPUTS and outputs in words; None where one stands twice."""
    for text in value:
        if text not in OUTPUTS and "(" not in text:
            raise table.bad("outputs", f"some of {', '.join(OUTPUTS)}, or {EXPECTED}")
        if text not in OUTPUTS:
            read_shape_output(text, table.find("design").fabric, f"{table.where}: outputs")
    return value if len({*value}) == len(value) else None


def _methods(value: Any, table: Table) -> tuple[str, ...] | None:
    methods = (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list | tuple) else ()
    fits = methods and all(method in METHODS for method in methods)
    return tuple(method for method in METHODS if method in methods) if fits else None


def _functions(table: Table) -> Mapping[str, Output]:
    """Return what Python gives; a file has none."""
    given = table["functions"] if table.has("functions") else {}
    if not isinstance(given, Mapping) or not all(callable(each) for each in given.values()):
        raise table.error("unknown key functions")
    return cast(Mapping[str, Output], given)


_TIMES = f"rising times in s after rest, up to {LONGEST:g}"
_PARAMETERS = Key("parameters.*", form=Mapping[str, LowHigh], rest=True, read=read_varied)
_OUTPUTS = Key(
    form=tuple[str, ...],
    read=_outputs,
    expected=f"some of {', '.join(OUTPUTS)}, each once",
    absent=lambda table: () if table.has("functions") else ("tip", "mean_curvature"),
)
_PRESSURES = replace(START_PRESSURES, absent=lambda table: np.minimum(MIDDLE, limits(table.find("design"))))
_METHODS = Key("method", read=_methods, expected='"morris", "sobol" or ["morris", "sobol"]')
_MANY = Within(least=8, most=MOST)


@dataclass(frozen=True, eq=False)
class SensitivityStudy:
    """A study of what a shape depends on. joint: the model's parameters are drawn from its joint covariance, all of
    them, beside `varied`. functions: outputs of one's own, by name, of times [s] and points (T, 3362, 3) m; a shape at
    rest has one frame. seconds: of computing, all sessions together."""

    name: Name
    design: Annotated[Design, Key(file=read_design), "whose motions are computed"]
    varied: Annotated[tuple[Varied, ...], _PARAMETERS, "what varies"]
    joint: Annotated[bool, Key("parameters.covariance", absent=lambda table: False), "what the model's covers varies"]
    outputs: Annotated[tuple[str, ...], _OUTPUTS, f"some of {', '.join(OUTPUTS)}, or in words (sensitivity.md)"]
    pressures: Annotated[NDArray[np.float64], _PRESSURES, "of channels that do not vary; absent: 200"]
    model: StudyModel = None
    methods: Annotated[tuple[str, ...], _METHODS, "morris, sobol, or both"] = METHODS
    samples: Annotated[int, _MANY, "a power of two: samples * (parameters + 2) shapes of Sobol's design"] = 256
    trajectories: Annotated[int, Within(least=4, most=MOST), "of Morris' design, of parameters + 1 shapes"] = 16
    at: Annotated[tuple[Second, ...], Key(expected=_TIMES), "of motions from rest; absent: shapes at rest"] = ()
    target: Annotated[TargetFile | None, "of the output chamfer"] = None
    seed: Seed = 1
    order: Order = 0
    points_per_side: Annotated[int, GRIDS, "of the simulator's grid"] = GRID
    rise: Rise = RISE
    hold: Hold = HOLD
    seconds: Annotated[Second | None, Key("limits.seconds"), ABOVE_0, "absent: until all is computed"] = None
    functions: Annotated[Mapping[str, Output], Key("", absent=_functions)] = field(default_factory=dict)

    def resolved(self, table: Table) -> "SensitivityStudy":
        """Raise InputError for what does not go together."""
        parameters = table.within(["parameters"])
        if "parameters" not in table:
            raise table.missing("parameters")
        if not self.varied and not self.joint:
            raise parameters.error("nothing varies; expected tables with low and high, or covariance = true")
        model = self.model or Model()
        if self.joint and model.covariance is None:
            raise parameters.bad("covariance", "a model with a [covariance], as calibrate and trace write it")
        if self.joint:
            joint_root(model)  # sound, or said at once
        if twice := [v.name for v in self.varied if self.joint and v.name in covered(model)]:
            raise parameters.error(f"{', '.join(twice)} vary with the covariance; expected no table of their own")
        if not (self.outputs or self.functions):
            raise table.bad("outputs", f"some of {', '.join(OUTPUTS)}, each once")
        if "chamfer" in self.outputs and self.target is None:
            raise table.error("expected one [target], beside the output chamfer")
        if "chamfer" not in self.outputs and self.target is not None:
            raise table.error('a target, and no "chamfer" among the outputs; expected both or neither')
        if self.samples & (self.samples - 1):
            raise table.bad("samples", "a power of two, such as 256: Sobol points are even in no other number")
        if any(not 0 < t <= LONGEST for t in self.at) or list(self.at) != sorted({*self.at}):
            raise table.bad("at", _TIMES)
        return self


def read_sensitivity(path: Path | str | Mapping[str, Any]) -> SensitivityStudy:
    """Read a study of kind "sensitivity". Raises InputError."""
    return study_of(SensitivityStudy, "sensitivity", path)

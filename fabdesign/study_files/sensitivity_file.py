"""Study files of kind "sensitivity": what is varied (pressures, places of muscles, factors on declared values,
parameters of effects), what is watched, and how much of it is computed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.registry import check_values, effect_named
from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design
from fabdesign.files.pressure_file import note_slight
from fabdesign.formats.codec import decode_part
from fabdesign.formats.schema import ABOVE_0, GRIDS, Key, Second, Within
from fabdesign.formats.table import Table, nearest
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import FACTOR_RANGE, HOLD, MUSCLE_TYPES, OF_MUSCLES, PARAMETERS, RISE
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import covered, joint_root
from fabdesign.nouns.pressure import limits
from fabdesign.runtime.effort import LONGEST
from fabdesign.study_files.study_file import START_PRESSURES, Hold, Name, Order, Rise, Seed, StudyFile, StudyModel
from fabdesign.study_files.study_targets import EXPECTED, TargetFile, read_shape_output
from fabdesign.units import in_kpa, pascals

Kind = Literal["pressure", "position", "factor", "effect"]
_AXES = {"u": 0, "v": 1}
_FORMS = (
    "pressure.CHANNEL, position.MUSCLE.u (or .v, or position.MUSCLE.CORNER.u), a factor "
    f"({', '.join(PARAMETERS)}, muscle_types.NAME.muscle_gain) or effects.NAME.PARAMETER"
)
_Meaning = tuple[Kind, tuple[str | int, ...], str, tuple[float, float], tuple[float, float] | None]
Output = Callable[[NDArray[np.float64], NDArray[np.float32]], float]
METHODS = ("morris", "sobol")
OUTPUTS = ("tip", "mean_curvature", "chamfer", "largest_tension")
MOST = 1 << 16  # rows, trajectories: far more than anybody waits for
GRID = 21  # points a side: docs/lab/sensitivity.md says what 41 would change
MIDDLE = 200e3  # Pa, of channels that nothing is said of


@dataclass(frozen=True)
class Varied:
    """One parameter, drawn evenly from `low` to `high` in `unit`.

    key: of a pressure (channel,); of a position (muscle, corner or -1 for all of them, axis), a shift against the
    design; of a factor (its name,); of an effect (its name, its parameter).
    """

    name: str
    kind: Kind
    key: tuple[str | int, ...]
    low: float
    high: float
    unit: str

    @property
    def what(self) -> str:
        """Return in words which part of the design or of the model it is, numbers as in the design's file."""
        if self.kind == "pressure":
            return f"pressure of channel {self.key[0]}"
        if self.kind == "position":
            muscle, corner, axis = self.key
            of = f"muscle {muscle}" if corner == -1 else f"corner {corner} of muscle {muscle}"
            return f"shift of {of} {'down' if axis else 'across'}"
        if self.kind == "factor":
            return "factor on the declared value"
        return f"{self.key[1]} of the effect {self.key[0]}".replace("_", " ")


@dataclass(frozen=True)
class LowHigh:
    """The ends between which a parameter is drawn, as a file has them."""

    low: Annotated[float | None, "in the parameter's unit"] = None
    high: Annotated[float | None, "absent: the model's 90 % interval"] = None


def read_varied(parameters: dict[str, Any], table: Table) -> tuple[Varied, ...]:
    """Return the parameters of a sweep that is being decoded. Raises InputError."""
    design, model = table.find("design"), table.find("model") or Model()
    leaves = [leaf for name, value in parameters.items() for leaf in _leaves(name, value, table)]
    varied = tuple(_varied(name, leaf, design, model) for name, leaf in leaves)
    size = np.array([design.fabric.width, design.fabric.height])
    for side in ("low", "high"):
        shifts = {v.key: getattr(v, side) for v in varied if v.kind == "position"}
        for number, path in enumerate(moved_paths(design, shifts)):  # type: ignore[arg-type]
            if (path < -1e-9).any() or (path > size + 1e-9).any():
                raise table.error(f"position.{number}: {side} takes muscle {number} off the cloth")
    return varied


def _leaves(name: str, value: Any, outer: Table) -> list[tuple[str, Table]]:
    """Return tables that hold no tables, by their keys joined with dots: `[parameters.pressure.0]` is pressure.0."""
    if not isinstance(value, Mapping):
        raise outer.bad(name, "a table")
    table = Table(value, f"{outer.where}: {name}", outer.file, outer)
    inner = {key: below for key, below in value.items() if isinstance(below, Mapping)}
    if not inner:
        return [(name, table)]
    if len(inner) < len(value):
        raise table.error("values beside tables; expected low and high in tables of their own")
    return [(f"{name}.{rest}", leaf) for key, below in inner.items() for rest, leaf in _leaves(key, below, table)]


def _varied(name: str, table: Table, design: Design, model: Model) -> Varied:
    kind, key, unit, bounds, interval = _meaning(name, table.where, design, model)
    ends = decode_part(LowHigh, table, LowHigh(*(interval or ())))
    low, high, in_unit = ends.low, ends.high, f" {unit}" if unit else ""
    if low is None or high is None:
        raise table.error(f"no {'low' if low is None else 'high'}; expected low and high{in_unit}")
    table.finish()
    if not bounds[0] <= low < high <= bounds[1]:
        raise table.error(
            f"low = {low:g}, high = {high:g}; expected low < high, from {bounds[0]:g} to {bounds[1]:g}{in_unit}"
        )
    if kind == "pressure":
        note_slight(pascals(str(high)), design, table.where)
    return Varied(name, kind, key, low, high, unit)


def _meaning(name: str, where: str, design: Design, model: Model) -> _Meaning:
    """Return kind, key, unit, what it may be, and the interval that the model gives it, if any."""
    first, *rest = name.split(".")
    if first == "pressure" and len(rest) == 1 and rest[0].isdecimal():
        channel = int(rest[0])
        if channel >= design.channels:
            raise InputError(f"{where}: design {design.name} has channels 0 to {design.channels - 1}")
        return "pressure", (channel,), "kPa", (0.0, in_kpa(float(limits(design)[channel]))), None
    if first == "position" and len(rest) in (2, 3) and rest[-1] in _AXES and all(r.isdecimal() for r in rest[:-1]):
        muscle, corner = int(rest[0]), int(rest[1]) if len(rest) == 3 else -1
        if muscle >= len(design.muscles) or corner >= len(design.muscles[muscle].path):
            raise InputError(f"{where}: no such muscle or corner; both count from 0")
        size = max(design.fabric.width, design.fabric.height)
        return "position", (muscle, corner, _AXES[rest[-1]]), "m", (-size, size), None
    if first == "effects" and len(rest) == 2:
        label, key = rest
        effect = effect_named(label, where)
        if key not in effect.parameters:
            check_values(effect, {key: 0.0}, where)  # which says what there is
        parameter = effect.parameters[key]
        if parameter.integer:
            raise InputError(f"{where}: {name} is a choice, not a quantity; expected one that can be varied")
        ends = (e.parameters[key].interval90 for e in model.effects if e.name == label and key in e.parameters)
        return "effect", (label, key), parameter.unit, parameter.bounds, next(ends, None)
    of_types = {f"{MUSCLE_TYPES}{kind}.{factor}" for kind in design.muscle_types for factor in OF_MUSCLES}
    if name in {*PARAMETERS, *of_types}:
        if hiding := [factor for factor in model.factors if factor.endswith(f".{name}")]:
            raise InputError(f"{where}: the model has {', '.join(hiding)}; expected that name")
        ends = (p.interval90 for factor, p in model.parameters.items() if name in Model({factor: p}).factors)
        return "factor", (name,), "", FACTOR_RANGE, next(ends, None)
    raise InputError(f"{where}: unknown parameter {name}; expected {_FORMS}{nearest(name, PARAMETERS)}")


def moved_paths(design: Design, shifts: dict[tuple[int, int, int], float]) -> list[np.ndarray]:
    """Return (corners, 2) m of every muscle, with shifts [m] by (muscle, corner or -1, axis)."""
    paths = [np.array(muscle.path, dtype=float) for muscle in design.muscles]
    for (muscle, corner, axis), shift in shifts.items():
        paths[muscle][slice(None) if corner < 0 else corner, axis] += shift
    return paths


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
class SensitivityStudy(StudyFile):
    """A study of what a shape depends on. joint: the model's parameters are drawn from its joint covariance, all of
    them, beside `varied`. functions: outputs of one's own, by name, of times [s] and points (T, 3362, 3) m; a shape at
    rest has one frame. seconds: of computing, all sessions together."""

    kind = "sensitivity"
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

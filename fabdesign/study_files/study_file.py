"""Study files: `fabdesign.study/1`, what a person asks of a search."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design
from fabdesign.files.model_file import read_model
from fabdesign.files.pressure_file import note_slight, pressure_file_of, read_pressures
from fabdesign.formats.codec import decode, decode_part
from fabdesign.formats.schema import ABOVE_0, FROM_0, FileUnit, Key, Kilopascal, Metre, Second, Within
from fabdesign.formats.table import STUDY, Table, load_part
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import HOLD, RISE
from fabdesign.nouns.model import Model
from fabdesign.nouns.pressure import LARGEST, PressureProgram, limits
from fabdesign.runtime.effort import MUSCLES
from fabdesign.study_files.study_targets import NO_PRICE, Price, Robust, ShapeOutput, TargetFile, read_shape_outputs
from fabdesign.units import in_kpa

Kind = Literal["optimize", "sensitivity", "layouts", "unseen", "loop", "follow"]
KINDS = get_args(Kind)
Side = Literal["front", "back"]
MeasureName = Literal["chamfer", "surface_rms"]  # each is a `Measure` of optimize/search/objective.py
CORNERS = 3  # between a muscle's ends, at most
HIGHEST = 400e3  # Pa, of the pressures searched where the study does not say


@dataclass(frozen=True)
class StudyHead:
    """The keys that studies of all kinds have."""

    kind: Annotated[Kind, "of the study"]
    cluster: Annotated[str | None, "address of a Dask scheduler whose workers compute; absent: this machine"] = None


class StudyFile:
    """A study of some kind, as its file holds it, or the same keys in Python."""

    kind: ClassVar[Kind]

    @classmethod
    def read(cls, source: Path | str | Mapping[str, Any]) -> Self:
        """Return the study of a file, or of the same keys in Python, whose design and model may be objects. Paths are
        relative to the file; targets are opened when it runs. Raises InputError, also for a study of another kind."""
        if isinstance(source, Mapping):
            return decode(cls, Table(source, cls.kind, Path(cls.kind)))
        root = load_part(Path(source), STUDY)
        if decode_part(StudyHead, root).kind != cls.kind:
            raise root.bad("kind", f'"{cls.kind}", the kind that this command runs')
        return decode(cls, root)


MANY = Within(least=1, most=MUSCLES)
_FACES = '"front", "back" or both'


@dataclass(frozen=True)
class MuscleChoice:
    """How many muscles a layout may have, on which faces, and with how many corners between a muscle's ends."""

    least: Annotated[int, Key("min", absent=lambda table: 1), MANY, "muscles; absent: 1"]
    most: Annotated[int, Key("max"), MANY, "muscles"]
    sides: Annotated[tuple[Side, ...], Key(expected=_FACES), "faces that they may lie on"] = ("front", "back")
    corners: Annotated[int, Within(least=0, most=CORNERS), "that a muscle gets between its ends, at most"] = 1

    def resolved(self, table: Table) -> "MuscleChoice":
        """Raise InputError for no counts or no faces."""
        if self.most < self.least:
            raise table.bad("max", f"a whole number{Within(least=self.least, most=MUSCLES)}")
        if not self.sides:
            raise table.bad("sides", _FACES)
        return self

    @property
    def counts(self) -> range:
        return range(self.least, self.most + 1)


@dataclass(frozen=True, eq=False)
class EarlierResult:
    """The result of an earlier search, to begin with."""

    file: Path
    design: Design
    pressures: NDArray[np.float64]  # (poses, channels) Pa


_AIR = FileUnit("m^3")  # at atmospheric pressure
_LOW_HIGH = "[lowest, highest] in kPa, from 0"


@dataclass(frozen=True)
class StudyLimits:
    """The limits of a layout and its pressures, and when a search ends."""

    pressure: Annotated[
        tuple[Kilopascal, Kilopascal],
        FROM_0,
        Key(expected=_LOW_HIGH),
        "lowest, highest; absent: at most the muscles'",
    ] = (0.0, HIGHEST)  # Pa
    spacing: Annotated[Metre, FROM_0, "between muscles on one face"] = 0.006
    edge: Annotated[Metre, FROM_0, "between a muscle's corner points and the cloth's edge"] = 0.005
    seconds: Annotated[Second, ABOVE_0, "of search; then the best so far"] = 600.0
    evaluations: Annotated[int, Within(least=1), "of search; then the best so far"] = 20_000
    contraction: Annotated[float | None, Within(above=0, most=0.5), "1 - l / l0 of any interval, at most"] = None
    channels: Annotated[int | None, MANY, "of pressure, at most; absent: one for each muscle if need be"] = None
    air: Annotated[float | None, _AIR, Within(above=0, most=1), "that fills all muscles in a pose, at most"] = None

    def resolved(self, table: Table) -> "StudyLimits":
        """Return the limits with pressures that the muscles bear. Raises InputError for what the cloth is too small
        for, and for pressures that the muscles do not bear."""
        design: Design = table.find("design")
        size = min(design.fabric.width, design.fabric.height)
        most = float(
            min([*limits(design), *(t.max_pressure or LARGEST for t in design.muscle_types.values())], default=LARGEST)
        )
        pressure = self.pressure if "pressure" in table else (0.0, min(HIGHEST, most))
        if not pressure[0] < pressure[1]:
            raise table.bad("pressure", _LOW_HIGH)
        if pressure[1] > most:
            raise table.bad("pressure", f"at most {in_kpa(most):g} kPa, the muscles' maximum")
        if "pressure" in table:
            note_slight(pressure[1], design, f"{table.where}: pressure")
        if self.spacing >= size:
            raise table.bad("spacing", "less than the cloth, in m")
        if 2 * self.edge >= size:
            raise table.bad("edge", "less than half the cloth, in m")
        return replace(self, pressure=pressure)


def read_start_pressures(value: tuple[float, ...], table: Table) -> NDArray[np.float64]:
    """Return (channels,) Pa. Raises InputError for another number of them."""
    design: Design = table.find("design")
    if len(value) != design.channels or min(value) < 0:
        raise table.bad("start_pressures", f"{design.channels} pressures in kPa, from 0")
    note_slight(max(value), design, f"{table.where}: start_pressures")
    return np.array(value)


def read_program(value: str, table: Table) -> PressureProgram:
    """Return what `simulate` takes too: a file, or a row."""
    file = table.file.parent / value
    return read_pressures(file if file.suffix in (".csv", ".npz") else value, table.find("design"))


def result_in(folder: Path) -> EarlierResult:
    """Return what the folder of a result holds: its design.toml, pressures.csv, pressures_2.csv, ... Raises
    InputError."""
    design = read_design(folder / "design.toml")
    files = [folder / "pressures.csv"]
    while (further := folder / pressure_file_of(len(files) + 1)).is_file():
        files.append(further)
    return EarlierResult(folder, design, np.array([read_pressures(file, design).pressure[-1] for file in files]))


def _earlier(folder: Path, table: Table) -> EarlierResult | None:
    there = all((folder / name).is_file() for name in ("design.toml", "pressures.csv"))
    return result_in(folder) if there else None


StudyModel = Annotated[Model | None, Key(file=read_model), "of the specimen; absent: the data sheet"]
Name = Annotated[str, Key(absent=lambda table: table.file.stem), "by default the file's"]
Seed = Annotated[int, FROM_0, "of random numbers"]
Order = Annotated[int, FROM_0, "place in the specimen's session of what is computed; 0 is rested"]
Rise = Annotated[Second, Within(least=0.01, most=60), "in which all pressures rise to a shape at rest"]
Hold = Annotated[Second, Within(least=0, most=3600), "for which they then hold, where effects have memory"]
_START = Key(
    "start",
    form=Path,
    read=_earlier,
    expected="the folder of an earlier result, with design.toml and pressures.csv",
)
START_PRESSURES = Key("start_pressures", form=tuple[Kilopascal, ...], read=read_start_pressures)
Outputs = Annotated[
    tuple[ShapeOutput, ...],
    Key(form=tuple[str, ...], read=read_shape_outputs, expected="each once"),
    "of the result's shapes, in words (sensitivity.md)",
]


_ONE_OR_SEVERAL = "one [target], or [[targets]] that share one layout"
_TARGETS = Key(
    expected=_ONE_OR_SEVERAL,
    one_of={
        "target": Annotated[TargetFile, "the shape that is wanted"],
        "targets": Annotated[tuple[TargetFile, ...], "poses that share one layout"],
    },
)
_POSITIONS = Key("variables.positions", absent=lambda table: table.within(["variables"]).has("muscles"))


@dataclass(frozen=True, eq=False)
class Study(StudyFile):
    """A search for the design and pressures that come closest to one target, or to several with one layout.

    `start_pressures` (channels,) Pa is where the search begins, and what holds where pressures do not vary; None: the
    middle of the limits.
    """

    kind = "optimize"
    name: Name
    design: Annotated[Design, Key(file=read_design), "the start, and whatever is not varied"]
    targets: Annotated[tuple[TargetFile, ...], _TARGETS]
    model: StudyModel = None
    seed: Seed = 1
    pressures: Annotated[bool, Key("variables.pressures"), "whether they vary"] = True
    positions: Annotated[bool, _POSITIONS, "of corner points vary; absent: where muscles is there"] = False
    muscles: Annotated[MuscleChoice | None, Key("variables.muscles"), "absent: the count stays"] = None
    limits: StudyLimits = StudyLimits()
    objective: Annotated[MeasureName, "what is made small"] = "chamfer"
    start_pressures: Annotated[NDArray[np.float64] | None, START_PRESSURES, "where the search begins"] = None
    earlier: Annotated[EarlierResult | None, _START, "the folder of an earlier result, to begin with"] = None
    order: Order = 0
    rise: Rise = RISE
    hold: Hold = HOLD
    price: Price = NO_PRICE
    robust: Annotated[Robust | None, "absent: copies with scatter are not asked for"] = None
    outputs: Outputs = ()

    def resolved(self, table: Table) -> "Study":
        """Raise InputError for no target, and for a measure that wishes do not have."""
        if not self.targets:
            raise table.error(f"expected {_ONE_OR_SEVERAL}")
        if self.objective != "chamfer" and any(target.wishes for target in self.targets):
            raise table.bad("objective", '"chamfer" for wishes, which have a distance of their own')
        return self


def read_study(path: Path | str | Mapping[str, Any]) -> Study:
    """Return a study of kind "optimize" in which something may vary. Raises InputError."""
    study = Study.read(path)
    require_searchable(study, "optimize" if isinstance(path, Mapping) else str(path))
    return study


def read_head(path: Path | str) -> StudyHead:
    """Return what studies of all kinds have. Raises InputError."""
    return decode_part(StudyHead, load_part(Path(path), STUDY))


def require_searchable(study: Study, where: str) -> None:
    """Raise InputError unless there is something to vary."""
    name = study.design.name
    if study.muscles is None and not study.design.muscles:
        raise InputError(f"{where}: design {name} has no muscles; expected some, or muscles = {{ max = N }}")
    if study.muscles is not None and not study.design.muscle_types:
        raise InputError(f"{where}: design {name} has no muscle types; expected one to lay out")
    if study.muscles is not None and not study.pressures:
        raise InputError(f"{where}: variables: muscles without pressures; expected pressures = true")
    if study.muscles is None and study.design.channels > (study.limits.channels or MUSCLES):
        raise InputError(
            f"{where}: limits: channels = {study.limits.channels}; expected {study.design.channels} or more, those of "
            f"design {name}, or muscles = {{ max = N }}"
        )
    if not (study.pressures or study.positions or study.muscles):
        raise InputError(f"{where}: variables: nothing may change; expected pressures, positions or muscles")

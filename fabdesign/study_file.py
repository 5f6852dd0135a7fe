"""Study files: `fabdesign.study/1`, what a person asks of a search."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.design_file import read_design
from fabdesign.effort import MUSCLES
from fabdesign.errors import InputError, note
from fabdesign.forward import HOLD, RISE
from fabdesign.model import Model
from fabdesign.model_file import read_model
from fabdesign.pressure import LARGEST, limits
from fabdesign.pressure_file import pressure_file_of, read_pressures, told_slight_pressure
from fabdesign.search_terms import Price, Robust, read_price, read_robust
from fabdesign.shape_output import ShapeOutput, read_shape_outputs
from fabdesign.study_targets import TargetFile, read_targets
from fabdesign.table import STUDY, Table, load_toml
from fabdesign.units import in_kpa, pascals

FORMAT = STUDY
KINDS = ("optimize", "sensitivity", "layouts", "unseen", "loop")
Side = Literal["front", "back"]
Measure = Literal["chamfer", "surface_rms"]
CORNERS = 3  # between a muscle's ends, at most
HIGHEST = 400e3  # Pa, of the pressures searched where the study does not say


@dataclass(frozen=True)
class MuscleChoice:
    """How many muscles a layout may have, on which faces, and with how many corners between a muscle's ends."""

    least: int
    most: int
    sides: tuple[Side, ...] = ("front", "back")
    corners: int = 1

    @property
    def counts(self) -> range:
        return range(self.least, self.most + 1)


@dataclass(frozen=True, eq=False)
class EarlierResult:
    """What an earlier search found, to begin with."""

    file: Path
    design: Design
    pressures: NDArray[np.float64]  # (poses, channels) Pa


@dataclass(frozen=True)
class StudyLimits:
    pressure: tuple[float, float] = (0.0, HIGHEST)  # Pa
    spacing: float = 0.006  # m, between muscles on one face
    edge: float = 0.005  # m, between a muscle's corner points and the cloth's edge
    seconds: float = 600.0  # of search
    evaluations: int = 20_000
    contraction: float | None = None  # 1 - l / l0, of any interval of a muscle; None: any
    channels: int | None = None  # of pressure; None: one for each muscle if need be
    air: float | None = None  # m^3 at atmospheric pressure that fill all muscles; None: any


@dataclass(frozen=True, eq=False)
class Study:
    """A search for the design and pressures that come closest to one target, or to several with one layout.

    `start_pressures` (channels,) Pa is where the search begins, and what holds where pressures do not vary; None: the
    middle of the limits.
    """

    name: str
    design: Design
    targets: tuple[TargetFile, ...]
    model: Model | None = None
    seed: int = 1
    pressures: bool = True
    positions: bool = False
    muscles: MuscleChoice | None = None
    limits: StudyLimits = StudyLimits()
    objective: Measure = "chamfer"
    start_pressures: NDArray[np.float64] | None = None
    earlier: EarlierResult | None = None
    order: int = 0  # the place in the specimen's session of what is searched for
    rise: float = RISE  # s, in which pressures rise on the way to an equilibrium
    hold: float = HOLD  # s, for which they then hold, where effects remember
    price: Price = field(default_factory=Price)
    robust: Robust | None = None
    outputs: tuple[ShapeOutput, ...] = ()  # said of the result's shapes; the search does not ask for them


def read_study(path: Path | str) -> Study:
    """Read a study of kind "optimize" with the design and model that it names; targets are opened when it runs.

    Keys: docs/files.md. `positions` is true by default where `muscles` is there. Paths are relative to the file.
    Raises InputError.
    """
    path = Path(path)
    root = load_toml(path, FORMAT, partial=True)
    require_kind(root, "optimize")
    study = read_search(root, path)
    require_searchable(study, str(path))
    return study


def read_kind(path: Path | str) -> str:
    """The kind of a study. Raises InputError."""
    kind: str = load_toml(Path(path), FORMAT, partial=True).text("kind", choices=KINDS)
    return kind


def read_cluster(path: Path | str) -> str | None:
    """The address of the scheduler whose workers compute a study. Raises InputError."""
    address: str | None = load_toml(Path(path), FORMAT, partial=True).text("cluster", None)
    return address


def require_kind(root: Table, kind: str) -> None:
    """Raise InputError for a study of another kind. Takes what studies of all kinds may have: `cluster`."""
    root.text("cluster", None)
    if root.text("kind", choices=KINDS) != kind:
        raise root.bad("kind", f'"{kind}", the kind that this command runs')


def read_search(root: Table, path: Path) -> Study:
    """A search from the table of its study at `path`, whose other keys have been taken. Raises InputError."""
    return search_of(root, path, *read_subject(root, path))


def read_subject(root: Table, path: Path) -> tuple[Design, Model | None]:
    """The design and the model, if any, that the study at `path` names. Raises InputError."""
    design = read_design(root.path("design", path.parent))
    model_name = root.text("model", None)
    return design, None if model_name is None else read_model(path.parent / model_name)


def search_of(root: Table, path: Path, design: Design, model: Model | None) -> Study:
    """As `read_search`, of a design and model that are read already."""
    targets = read_targets(root, path, design.fabric)
    variables = root.table("variables", None) or Table({}, f"{path}: variables")
    choice = _choice(variables)
    pressures, positions = variables.flag("pressures", True), variables.flag("positions", choice is not None)
    variables.finish()
    study = Study(
        name=root.text("name", path.stem),
        design=design,
        targets=targets,
        model=model,
        seed=root.integer("seed", 1, least=0),
        pressures=pressures,
        positions=positions,
        muscles=choice,
        limits=_limits(root, path, design),
        objective=root.text("objective", "chamfer", choices=("chamfer", "surface_rms")),
        start_pressures=read_start_pressures(root, design),
        earlier=_earlier(root, path),
        order=root.integer("order", 0, least=0),
        rise=root.number("rise", RISE, least=0.01, most=60),
        hold=root.number("hold", HOLD, least=0, most=3600),
        price=read_price(root),
        robust=read_robust(root),
        outputs=read_shape_outputs(root, path, design.fabric),
    )
    if study.objective != "chamfer" and any(target.wishes for target in targets):
        raise root.bad("objective", '"chamfer" for wishes, which have a distance of their own')
    root.finish()
    return study


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


def _choice(variables: Table) -> MuscleChoice | None:
    table = variables.table("muscles", None)
    if table is None:
        return None
    least = table.integer("min", 1, least=1, most=MUSCLES)
    sides = cast(tuple[Side, ...], table.texts("sides", ("front", "back")))  # checked below
    choice = MuscleChoice(
        least,
        table.integer("max", least=least, most=MUSCLES),
        sides,
        table.integer("corners", MuscleChoice.corners, least=0, most=CORNERS),
    )
    if not choice.sides or not set(choice.sides) <= {"front", "back"}:
        raise table.bad("sides", '"front", "back" or both')
    table.finish()
    return choice


def _limits(root: Table, path: Path, design: Design) -> StudyLimits:
    table = root.table("limits", None) or Table({}, f"{path}: limits")
    default = StudyLimits()
    most = min([*limits(design), *(t.max_pressure or LARGEST for t in design.muscle_types.values())], default=LARGEST)
    pressure = (0.0, min(HIGHEST, float(most)))
    if "pressure" in table:
        low, high = table.numbers("pressure", count=2)
        if not 0 <= low < high:
            raise table.bad("pressure", "[lowest, highest] in kPa, from 0")
        pressure = (pascals(str(low)), pascals(str(high)))
        if pressure[1] > most:
            raise table.bad("pressure", f"at most {in_kpa(most):g} kPa, the muscles' maximum")
        _say_slight(pressure[1], design, f"{table.where}: pressure")
    own = StudyLimits(
        pressure=pressure,
        spacing=table.number("spacing", default.spacing, least=0),
        edge=table.number("edge", default.edge, least=0),
        contraction=table.number("contraction", above=0, most=0.5) if "contraction" in table else None,
        channels=table.integer("channels", least=1, most=MUSCLES) if "channels" in table else None,
        air=table.number("air", above=0, most=1) if "air" in table else None,
        seconds=table.number("seconds", default.seconds, above=0),
        evaluations=table.integer("evaluations", default.evaluations, least=1),
    )
    if own.spacing >= min(design.fabric.width, design.fabric.height):
        raise table.bad("spacing", "less than the cloth, in m")
    if 2 * own.edge >= min(design.fabric.width, design.fabric.height):
        raise table.bad("edge", "less than half the cloth, in m")
    table.finish()
    return own


def read_start_pressures(root: Table, design: Design) -> NDArray[np.float64] | None:
    """(channels,) Pa; None where the study has none."""
    values = root.numbers("start_pressures", None)
    if values is None:
        return None
    if len(values) != design.channels or min(values) < 0:
        raise root.bad("start_pressures", f"{design.channels} pressures in kPa, from 0")
    pressures = np.array([pascals(str(value)) for value in values])
    _say_slight(float(pressures.max(initial=0.0)), design, f"{root.where}: start_pressures")
    return pressures


def _say_slight(highest: float, design: Design, where: str) -> None:
    if line := told_slight_pressure(highest, design, where):
        note(line)


def _earlier(root: Table, path: Path) -> EarlierResult | None:
    """`start = "DIR"`, the folder of an earlier result: its design.toml, pressures.csv, pressures_2.csv, ..."""
    name = root.text("start", None)
    if name is None:
        return None
    folder = root.path("start", path.parent)
    if not (folder / "design.toml").is_file() or not (folder / "pressures.csv").is_file():
        raise root.bad("start", "the folder of an earlier result, with design.toml and pressures.csv")
    design = read_design(folder / "design.toml")
    files = [folder / "pressures.csv"]
    while (further := folder / pressure_file_of(len(files) + 1)).is_file():
        files.append(further)
    return EarlierResult(folder, design, np.array([read_pressures(file, design).pressure[-1] for file in files]))

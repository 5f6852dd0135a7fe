"""Study files of kind "unseen": a layout or muscle type predicted before it is sewn, and designs left out in turn."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.design_file import read_design
from fabdesign.effort import COARSEST, FINEST, LONGEST
from fabdesign.errors import InputError
from fabdesign.forward import HOLD, RISE
from fabdesign.measurement_set import read_set
from fabdesign.model import Model
from fabdesign.model_file import read_model
from fabdesign.model_sampling import joint_root
from fabdesign.pressure import PressureProgram, limits
from fabdesign.pressure_file import read_pressures
from fabdesign.rig_limits_file import USUAL_LIMITS, RigLimits, read_rig_limits
from fabdesign.shape_output import ShapeOutput, read_shape_outputs
from fabdesign.study_file import FORMAT, require_kind
from fabdesign.table import Table, load_toml
from fabdesign.trial import MeasurementSet
from fabdesign.units import pascals

GRID = 21  # points a side, where there is no model whose factors belong to a grid
FREE = "measured.free:"  # as an error says it


@dataclass(frozen=True, eq=False)
class CandidateMeasurement:
    """A measurement that could be made: a program on a design."""

    name: str
    design: Design
    program: PressureProgram


@dataclass(frozen=True, eq=False)
class Unsewn:
    """What is not sewn yet: a design under `poses` (n, channels) Pa, the model that is to predict it, and what is said
    of its shapes beside the lower edge."""

    design: Design
    model: Model
    poses: NDArray[np.float64]
    outputs: tuple[ShapeOutput, ...]
    candidates: tuple[CandidateMeasurement, ...]


@dataclass(frozen=True, eq=False)
class UnseenStudy:
    """trials: of each design that is left out, how many are evaluated at most. free: effects that are fitted to the
    others besides, as `calibrate --free` takes them. samples: models drawn."""

    name: str
    unsewn: Unsewn | None
    measured: MeasurementSet | None
    folder: Path | None = None  # of the measured set
    trials: int = 12
    free: tuple[str, ...] = ()
    samples: int = 32
    seed: int = 1
    points_per_side: int = GRID
    rise: float = RISE
    hold: float = HOLD
    rig: RigLimits = USUAL_LIMITS
    seconds: float | None = None


def read_unseen(path: Path | str) -> UnseenStudy:
    """Read a study of kind "unseen". Keys: docs/files.md. Raises InputError."""
    path = Path(path)
    root = load_toml(path, FORMAT, partial=True)
    require_kind(root, "unseen")
    if "design" not in root:
        return unseen_of(root, path)
    return unseen_of(
        root, path, read_design(root.path("design", path.parent)), read_model(root.path("model", path.parent))
    )


def unseen_of(
    root: Table,
    path: Path,
    design: Design | None = None,
    model: Model | None = None,
    measured: MeasurementSet | None = None,
) -> UnseenStudy:
    """A study from the table of its file at `path`, whose other keys have been taken. measured: in place of the set
    that the table names. Raises InputError."""
    rig = read_rig_limits(root, path)
    unsewn = None if design is None or model is None else _unsewn(root, path, rig, design, model)
    table = root.table("measured", None)
    free: tuple[str, ...] = ()
    folder, trials = None, 12
    if table is not None:
        if measured is None:
            folder = table.path("set", path.parent)
            measured = read_set(folder)
        trials, free = table.integer("trials", 12, least=1), table.texts("free", ())
        if len(measured.designs) < 2:
            raise InputError(f"{table.where}: one design; expected two or more, to leave each out in turn")
        table.finish()
    if unsewn is None and measured is None:
        raise InputError(f"{path}: nothing to compute; expected a design with a model, a [measured] set, or both")
    cut = root.table("limits", None) or Table({}, "")
    study = UnseenStudy(
        name=root.text("name", path.stem),
        unsewn=unsewn,
        measured=measured,
        folder=folder,
        trials=trials,
        free=free,
        samples=root.integer("samples", 32, least=8, most=1000),
        seed=root.integer("seed", 1, least=0),
        points_per_side=root.integer(
            "points_per_side", unsewn.model.points_per_side if unsewn else GRID, least=COARSEST, most=FINEST
        ),
        rise=root.number("rise", RISE, least=0.01, most=60),
        hold=root.number("hold", HOLD, least=0, most=LONGEST),
        rig=rig,
        seconds=cut.number("seconds", None, above=0),
    )
    cut.finish()
    root.finish()
    return study


def _unsewn(root: Table, path: Path, rig: RigLimits, design: Design, model: Model) -> Unsewn:
    joint_root(model)  # sound, or said at once
    if not design.muscles:
        raise InputError(f"{path}: design {design.name} has no muscles; expected some")
    if rig.channels is not None and design.channels > rig.channels:
        raise InputError(f"{path}: design {design.name} has {design.channels} channels; the rig has {rig.channels}")
    candidates = tuple(_candidate(table, path, design) for table in root.tables("candidates"))
    outputs = read_shape_outputs(root, path, design.fabric)
    return Unsewn(design, model, _poses(root, design, rig), outputs, candidates)


def _poses(root: Table, design: Design, rig: RigLimits) -> NDArray[np.float64]:
    """`pressures`, rows of kPa; else one face after the other at the highest pressure."""
    most = limits(design)
    rows = root.take("pressures", None)
    if rows is None:
        on = {side: {m.channel for m in design.muscles if m.side == side} for side in ("front", "back")}
        faces = [np.isin(np.arange(design.channels), [*channels]) for channels in on.values() if channels]
        return np.array([np.where(face, np.minimum(most, rig.pressure), 0.0) for face in faces])
    try:
        poses = np.array([[pascals(x) for x in row] for row in rows])
    except (ArithmeticError, TypeError, ValueError):
        poses = np.empty(0)
    if poses.ndim != 2 or poses.shape[1] != design.channels or (poses < 0).any() or (poses > most).any():
        raise root.bad("pressures", f"rows of {design.channels} pressures in kPa, within the muscles' limits")
    return poses


def _candidate(table: Table, path: Path, design: Design) -> CandidateMeasurement:
    """`program`: as `simulate` takes it; on another `design` where there is one."""
    own = read_design(table.path("design", path.parent)) if "design" in table else design
    spec = table.text("program")
    file = path.parent / spec
    program = read_pressures(file if file.suffix in (".csv", ".npz") else spec, own)
    candidate = CandidateMeasurement(table.text("name", spec), own, program)
    table.finish()
    return candidate

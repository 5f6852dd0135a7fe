"""Study files of kind "sensitivity": what is varied, what is watched, and how much of it is computed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.effort import COARSEST, FINEST, LONGEST
from fabdesign.errors import InputError
from fabdesign.forward import HOLD, RISE
from fabdesign.model import Model
from fabdesign.model_sampling import covered, joint_root
from fabdesign.pressure import limits
from fabdesign.shape_output import EXPECTED, read_shape_output
from fabdesign.study_file import FORMAT, read_start_pressures, read_subject, require_kind
from fabdesign.study_targets import TargetFile, read_targets
from fabdesign.table import Table, load_toml
from fabdesign.varied import Varied, read_varied

Output = Callable[[NDArray[np.float64], NDArray[np.float32]], float]
NO_FUNCTIONS: Mapping[str, Output] = {}
METHODS = ("morris", "sobol")
OUTPUTS = ("tip", "mean_curvature", "chamfer", "largest_tension")
MOST = 1 << 16  # rows, trajectories: far more than anybody waits for
GRID = 21  # points a side: docs/results/sensitivity.md says what 41 would change
MIDDLE = 200e3  # Pa, of channels that nothing is said of


@dataclass(frozen=True, eq=False)
class SensitivityStudy:
    """joint: the model's parameters are drawn from its joint covariance, all of them, beside `varied`.

    outputs: names of OUTPUTS, or what `read_shape_output` reads.
    at: s after rest, of motions under constant pressures from there; none: shapes at rest. pressures (channels,) Pa
    hold where they do not vary. samples: rows of the Sobol design, a row being one sample and, for every parameter,
    one with that parameter exchanged. trajectories: of Morris' design. seconds: of computing, all sessions together.
    functions: outputs of one's own, by name, of times [s] and points (T, 3362, 3) m; a shape at rest has one frame.
    """

    name: str
    design: Design
    varied: tuple[Varied, ...]
    joint: bool
    outputs: tuple[str, ...]
    pressures: NDArray[np.float64]
    model: Model | None = None
    methods: tuple[str, ...] = METHODS
    samples: int = 256
    trajectories: int = 16
    at: tuple[float, ...] = ()
    target: TargetFile | None = None
    seed: int = 1
    order: int = 0
    points_per_side: int = GRID
    rise: float = RISE  # s, in which pressures rise on the way to rest
    hold: float = HOLD  # s, for which they then hold, where effects remember
    seconds: float | None = None
    functions: Mapping[str, Output] = field(default_factory=dict)


def read_sensitivity(path: Path | str) -> SensitivityStudy:
    """Read a study of kind "sensitivity". Keys: docs/files.md. Raises InputError."""
    path = Path(path)
    root = load_toml(path, FORMAT, partial=True)
    require_kind(root, "sensitivity")
    return sensitivity_of(root, path, *read_subject(root, path))


def sensitivity_of(
    root: Table, path: Path, design: Design, model: Model | None, functions: Mapping[str, Output] = NO_FUNCTIONS
) -> SensitivityStudy:
    """A study from the table of its file at `path`, whose other keys have been taken. functions: outputs beside those
    that the table names. Raises InputError."""
    varied, joint = _parameters(root.table("parameters"), design, model or Model())
    outputs = root.texts("outputs", () if functions else ("tip", "mean_curvature"))
    if not (outputs or functions) or len({*outputs}) < len(outputs):
        raise root.bad("outputs", f"some of {', '.join(OUTPUTS)}, each once")
    for text in outputs:
        if text not in OUTPUTS and "(" not in text:
            raise root.bad("outputs", f"some of {', '.join(OUTPUTS)}, or {EXPECTED}")
        if text not in OUTPUTS:
            read_shape_output(text, design.fabric, f"{path}: outputs")
    targets = read_targets(root, path, design.fabric) if "target" in root or "chamfer" in outputs else ()
    if targets and "chamfer" not in outputs:
        raise InputError(f'{path}: a target, and no "chamfer" among the outputs; expected both or neither')
    pressures = read_start_pressures(root, design)
    table = root.table("limits", None) or Table({}, f"{path}: limits")
    study = SensitivityStudy(
        name=root.text("name", path.stem),
        design=design,
        varied=varied,
        joint=joint,
        outputs=outputs,
        functions=functions,
        pressures=np.minimum(MIDDLE, limits(design)) if pressures is None else pressures,
        model=model,
        methods=_methods(root),
        samples=_samples(root),
        trajectories=root.integer("trajectories", 16, least=4, most=MOST),
        at=_times(root),
        target=targets[0] if targets else None,
        seed=root.integer("seed", 1, least=0),
        order=root.integer("order", 0, least=0),
        points_per_side=root.integer("points_per_side", GRID, least=COARSEST, most=FINEST),
        rise=root.number("rise", RISE, least=0.01, most=60),
        hold=root.number("hold", HOLD, least=0, most=LONGEST),
        seconds=table.number("seconds", None, above=0),
    )
    table.finish()
    root.finish()
    return study


def _parameters(root: Table, design: Design, model: Model) -> tuple[tuple[Varied, ...], bool]:
    joint = root.flag("covariance", False)
    tables = {name: table for key in root.names() if key != "covariance" for name, table in _leaves(key, root)}
    varied = read_varied(tables, design, model, root.where)
    if not varied and not joint:
        raise InputError(f"{root.where}: nothing varies; expected tables with low and high, or covariance = true")
    if joint and model.covariance is None:
        raise root.bad("covariance", "a model with a [covariance], as calibrate and trace write it")
    if joint:
        joint_root(model)  # sound, or said at once
    if twice := [v.name for v in varied if joint and v.name in covered(model)]:
        raise InputError(f"{root.where}: {', '.join(twice)} vary with the covariance; expected no table of their own")
    return varied, joint


def _leaves(key: str, root: Table) -> list[tuple[str, Table]]:
    """Tables that hold no tables, by their keys joined with dots: `[parameters.pressure.0]` is pressure.0."""
    table = root.table(key)
    inner = [name for name in table.names() if isinstance(table.take(name), dict)]
    if not inner:
        return [(key, Table({name: table.take(name) for name in table.names()}, table.where))]
    table.finish()
    if len(inner) < len(table.names()):
        raise InputError(f"{table.where}: values beside tables; expected low and high in tables of their own")
    return [(f"{key}.{name}", leaf) for below in inner for name, leaf in _leaves(below, table)]


def _methods(root: Table) -> tuple[str, ...]:
    value: Any = root.take("method", list(METHODS))
    methods = (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else ()
    if not methods or not all(method in METHODS for method in methods):
        raise root.bad("method", '"morris", "sobol" or ["morris", "sobol"]')
    return tuple(method for method in METHODS if method in methods)


def _samples(root: Table) -> int:
    samples: int = root.integer("samples", 256, least=8, most=MOST)
    if samples & (samples - 1):
        raise root.bad("samples", "a power of two, such as 256: Sobol points are even in no other number")
    return samples


def _times(root: Table) -> tuple[float, ...]:
    times: tuple[float, ...] = root.numbers("at", ())
    if any(not 0 < t <= LONGEST for t in times) or list(times) != sorted({*times}):
        raise root.bad("at", f"rising times in s after rest, up to {LONGEST:g}")
    return times

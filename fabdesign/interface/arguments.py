"""Arguments as they come: objects or paths, one or many."""

import os
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.bench_file import is_bench
from fabdesign.cluster import VARIABLE, current, on_cluster
from fabdesign.design import Design
from fabdesign.design_file import read_design
from fabdesign.errors import InputError
from fabdesign.forward import ForwardModel
from fabdesign.measurement_set import read_set
from fabdesign.model import Model
from fabdesign.model_file import usable_model
from fabdesign.pressure import PressureProgram, require_pressures
from fabdesign.pressure_file import constant_program, read_pressures
from fabdesign.study_file import read_cluster
from fabdesign.trial import MeasurementSet
from fabdesign.units import from_kpa

DesignLike = Design | Path | str
ModelLike = Model | Path | str
SetLike = MeasurementSet | Path | str
Pressures = Any  # a program, a file of one, "400,0" or kPa of every channel; a sequence of these
Progress = Callable[[str, float | None], None]
Say = Callable[[str], None]


def unheard(line: str, share: float | None) -> None:
    """Progress that nobody follows."""


def warn(line: str) -> None:
    warnings.warn(line, stacklevel=4)


@contextmanager
def computing(cluster: str | None, study: Path | None = None, say: Say = warn) -> Iterator[None]:
    """A context whose batches go where they are asked to: `cluster`, the environment's, the study's, or here."""
    if cluster is None and current() is None:
        cluster = os.environ.get(VARIABLE) or (read_cluster(study) if study is not None else None)
    with on_cluster(cluster, say=say):
        yield


@contextmanager
def work_folder(out: Path | str | None) -> Iterator[Path]:
    """A folder to work in: the one that is asked for, or one that goes afterwards."""
    if out is not None:
        yield Path(out)
        return
    with tempfile.TemporaryDirectory(prefix="fabdesign_") as folder:
        yield Path(folder) / "work"


def simulator(points_per_side: int, **options: Any) -> ForwardModel:
    from sim import Simulator  # here: it loads Taichi

    return Simulator(points_per_side, **options)


def study_file(design: Any) -> Path:
    """Of a function that is given nothing but a study, as its command takes it."""
    if not isinstance(design, Path | str):
        raise InputError(f"{getattr(design, 'name', design)}: a design alone; expected what is asked of it, or a study")
    return Path(design)


def one_design(design: DesignLike) -> Design:
    _require("design", design, Design)
    return design if isinstance(design, Design) else read_design(design)


def one_model(model: ModelLike | None, without: Sequence[str] = (), say: Say = warn) -> Model | None:
    if model is not None:
        _require("model", model, Model)
        return usable_model(model, without, say=say)
    if without:
        raise InputError(f"--without {','.join(without)}: there is no model; expected it with --model")
    return None


def all_sets(measured: SetLike | Sequence[SetLike]) -> list[MeasurementSet]:
    """Raises InputError for a bench, which is no measurement set."""
    many = [measured] if isinstance(measured, MeasurementSet | Path | str) else many_of("measurement sets", measured)
    if not many:
        raise InputError("no measurement set; expected one or more")
    for one in many:
        _require("measurement set", one, MeasurementSet)
        if not isinstance(one, MeasurementSet) and is_bench(Path(one)):
            raise InputError(f"{one}: a bench; expected measurement sets, or the command, which takes a bench too")
    return [one if isinstance(one, MeasurementSet) else read_set(one) for one in many]


def paths_of(*given: Any) -> list[Path]:
    """Those of the arguments that are files or folders, and where measured sets lie: never written over."""
    flat = [x for each in given for x in (each if isinstance(each, list | tuple) else [each])]
    sets = {trial.file.parent.parent for x in flat if isinstance(x, MeasurementSet) for trial in x.trials}
    return [*(Path(x) for x in flat if isinstance(x, Path | str)), *sorted(sets)]


def one_program(pressures: Pressures, design: Design) -> PressureProgram:
    """None: of a design without channels. Raises InputError."""
    if pressures is None:
        if design.channels:
            raise InputError(f"{design.name}: has {design.channels} channels; expected pressures for them")
        return constant_program([])
    if isinstance(pressures, Path | str):
        return read_pressures(pressures, design)
    if not isinstance(pressures, PressureProgram):
        pressures = constant_program(from_kpa(_numbers(f"pressures of {design.name}", pressures)))
    require_pressures(pressures, design, f"pressures of {design.name}")
    return pressures


def pairs(
    designs: DesignLike | Sequence[DesignLike], pressures: Pressures
) -> tuple[list[tuple[Design, PressureProgram]], bool]:
    """Designs with their pressures, and whether it is one pair alone. One design goes with all pressures, one row of
    pressures with all designs; else they are as many. Raises InputError."""
    one = isinstance(designs, Design | Path | str)
    several: Sequence[Any] = [designs] if one else many_of("designs", designs)
    read = [one_design(each) for each in several]
    rows = [*pressures] if _are_many(pressures) else [pressures]
    lone = one and not _are_many(pressures)
    if len(read) == 1:
        read *= len(rows)
    if len(rows) == 1:
        rows *= len(read)
    if not read or len(read) != len(rows):
        raise InputError(f"{len(read)} designs with {len(rows)} pressures; expected as many, or one of either")
    return [(design, one_program(row, design)) for design, row in zip(read, rows, strict=True)], lone


def _are_many(pressures: Pressures) -> bool:
    if pressures is None or isinstance(pressures, Path | str | PressureProgram):
        return False
    return any(not np.isscalar(each) for each in many_of("pressures", pressures))


def many_of(what: str, given: Any) -> Sequence[Any]:
    """A list of what came; raises InputError for what is none."""
    if isinstance(given, str | Mapping) or not isinstance(given, Iterable):
        raise InputError(f"{what}: {_shown(given)}; expected a list of them")
    return [*given]


def functions_of(outputs: Any) -> dict[str, Callable[..., float]]:
    """Functions of a motion by name. Raises InputError for anything else."""
    functions = dict(outputs) if isinstance(outputs, Mapping) else {}
    if not functions:
        raise InputError("outputs: none; expected functions of a motion, by name")
    for name, function in functions.items():
        if not callable(function):
            raise InputError(f"outputs: {name}: {_shown(function)}; expected a function of a motion")
    return functions


def ends_of(what: str, given: Any) -> tuple[Any, Any]:
    """The least and the most. Raises InputError for what is no pair."""
    ends = [*given] if isinstance(given, Iterable) and not isinstance(given, Mapping) else []
    if len(ends) != 2:
        raise InputError(f"{what}: {_shown(given)}; expected two, the least and the most")
    return ends[0], ends[1]


def _require(what: str, given: Any, kind: type) -> None:
    """Raise InputError for what is neither of a kind nor the name of a file."""
    if not isinstance(given, kind | Path | str):
        raise InputError(f"{what}: {_shown(given)}; expected a {kind.__name__} or its file")


def _numbers(what: str, given: Any) -> np.ndarray:
    """A row of kPa. Raises InputError."""
    try:
        row = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        row = np.empty((0, 0))
    if row.ndim != 1:
        raise InputError(f"{what}: {_shown(given)}; expected kPa of every channel")
    return row


def _shown(given: Any) -> str:
    text = " ".join(repr(given).split())
    return text if len(text) <= 60 else f"{text[:57]}..."

"""Folders that commands made: which there are, what they hold, how they differ; and the evaluations of a search or
sweep as one table, also as a store of Optuna studies, which its dashboard opens. Only this file knows Optuna, the
extra `optuna`."""

import csv
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.formats.csv_table import write_rows
from fabdesign.formats.json_file import read_json
from fabdesign.output import MARK, read_mark
from fabdesign.runtime.store import writing
from fabdesign.units import in_mm

RESULTS = ("result.json", "trace.json", "evaluation.json", "loop.json", "fusion.json")
# what says most about a result, of each that has it
HEADLINES = ("objective_mm", "chamfer", "surface_rms", "verdict", "evaluations", "complete", "wall_s", "stop_reason")

Figure = str | float | bool | None  # what is not a list or a table
HISTORY, SAMPLES = "history.sqlite", "samples.csv"
OBJECTIVE = "objective_mm"
_COLUMNS = ["part", "evaluation", "seconds", "stage", OBJECTIVE, "diverged"]


@dataclass(frozen=True)
class ResultFolder:
    """made_by: the command. result: what its JSON file holds; empty where there is none (yet)."""

    path: Path
    made_by: str
    result: Mapping[str, Any]

    @property
    def figures(self) -> dict[str, Figure]:
        """Return numbers and words of the result by name, those of inner tables as OUTER.INNER; no lists."""
        return dict(_flat(self.result))

    @property
    def headline(self) -> dict[str, Figure]:
        figures = self.figures
        return {name: figures[name] for name in HEADLINES if name in figures}


def read_folder(path: Path) -> ResultFolder:
    """Read a folder of results. Raises InputError for what no command made, and for a damaged result."""
    mark = read_mark(path)
    if mark is None:
        raise InputError(f"{path}: is no folder that fabdesign made (without {MARK}); expected a result's folder")
    files = [path / name for name in RESULTS if (path / name).is_file()]
    return ResultFolder(path, mark.made_by, read_json(files[0]) if files else {})


def folders_below(paths: Sequence[Path]) -> list[ResultFolder]:
    """Return those of `paths` and of what lies in them, folders in a result's folder not. Raises InputError for a path
    that is no folder."""
    folders = []
    for path in paths:
        if not path.is_dir():
            raise InputError(f"{path}: no such folder")
        for top, inner, files in os.walk(path):
            inner.sort()
            if MARK in files and read_mark(Path(top)) is not None:
                folders.append(read_folder(Path(top)))
                inner.clear()
    return folders


def compared(folders: Sequence[ResultFolder]) -> dict[str, list[Figure]]:
    """Return figures in which the results differ, by name: one of each folder, None where it has none."""
    figures = [folder.figures for folder in folders]
    names = dict.fromkeys(name for figure in figures for name in figure)
    rows = {name: [figure.get(name) for figure in figures] for name in names}
    return {name: row for name, row in rows.items() if any(value != row[0] for value in row)}


def _flat(result: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Figure]]:
    for name, value in result.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
        elif not isinstance(value, list):
            yield before + name, value


@dataclass(frozen=True)
class EvaluationsTable:
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]  # None: no value


def read_evaluations(folder: Path) -> EvaluationsTable:
    """Return a row an evaluation of `optimize` and `layouts`, or a sample of `sensitivity`. Nothing in the folder
    changes.

    part: the cell's folder. x_0, ...: what the evaluated layout varies, 0 to 1 within its bounds, positions first.
    Raises InputError where there is neither.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    histories = sorted(folder.rglob(HISTORY))
    if histories:
        return _searches(folder, histories)
    if (folder / SAMPLES).is_file():
        return _samples(folder / SAMPLES)
    raise InputError(f"{folder}: has no {HISTORY} and no {SAMPLES}; expected the folder of a search or of a sweep")


def write_evaluations(table: EvaluationsTable, path: Path) -> None:
    """Write a CSV, or by the ending .parquet a Parquet file, which needs the extra `tables`."""
    if path.suffix.lower() == ".parquet":
        import pandas

        pandas.DataFrame(table.rows, columns=table.columns).to_parquet(path, index=False)
    else:
        write_rows(path, table.columns, [["" if cell is None else cell for cell in row] for row in table.rows])


def _searches(folder: Path, histories: Sequence[Path]) -> EvaluationsTable:
    entries = []
    for history in histories:
        part = history.parent.relative_to(folder).as_posix()
        try:
            entries += [(part, *row[:5], json.loads(row[5])) for row in _read(history)]
        except (TypeError, json.JSONDecodeError) as error:
            raise InputError(f"{history}: cannot be read ({error})") from None
    most = max((len(row[-1]) for row in entries), default=0)
    rows = [
        [part, number, seconds, stage, None if diverged else in_mm(objective), bool(diverged), *x]
        + [None] * (most - len(x))
        for part, number, seconds, stage, objective, diverged, x in entries
    ]
    return EvaluationsTable([*_COLUMNS, *(f"x_{k}" for k in range(most))], rows)


def _read(history: Path) -> list[tuple[Any, ...]]:
    query = "select number, seconds, stage, objective, diverged, x from evaluations order by number"
    at_work = history.with_name(history.name + "-wal").exists()  # else SQLite would leave files of its own beside it
    try:
        how = "mode=ro" if at_work else "mode=ro&immutable=1"
        with closing(sqlite3.connect(f"{history.resolve().as_uri()}?{how}", uri=True)) as file:
            return file.execute(query).fetchall()
    except sqlite3.Error as error:
        raise InputError(f"{history}: cannot be read ({error})") from None


def _samples(path: Path) -> EvaluationsTable:
    """Return numbers where a cell is one: the names of methods are words."""
    try:
        header, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    return EvaluationsTable(header, [[row[0], *map(_number, row[1:])] for row in rows])


def _number(cell: str) -> float | int | None:
    return None if not cell else int(cell) if cell.isdecimal() else float(cell)


def write_optuna_store(table: EvaluationsTable, path: Path, name: str) -> None:
    """Write a SQLite file, for `optuna-dashboard sqlite:///search.db`.

    A search of one design is a study of the folder's name; a grid of layouts has a study a cell. What a layout varies
    is x_0 and so on, 0 to 1 within its bounds. name: of a study that is the only one. Raises InputError for what has no
    objective.
    """
    if OBJECTIVE not in table.columns:
        raise InputError(f"{name}: has no {OBJECTIVE}; expected the folder of a search for an Optuna store")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    opened = {"creator": lambda: sqlite3.connect(path)}  # a URL would take ? and % in a name for its own
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    with writing(path), _unwrapped():
        storage = optuna.storages.RDBStorage("sqlite:///of-the-creator", engine_kwargs=opened)
        try:
            for part, group in groupby(rows, key=lambda row: row["part"]):
                study_name = name if part == "." else part
                study = optuna.create_study(storage=storage, study_name=study_name, direction="minimize")
                study.set_user_attr("objective", OBJECTIVE)
                study.add_trials([_trial_of(row) for row in group])
        finally:
            storage.engine.dispose()


@contextmanager
def _unwrapped() -> Iterator[None]:
    """Return a context that raises what SQLite raised, which SQLAlchemy and Optuna wrap in errors of their own."""
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, sqlite3.OperationalError):
            cause = cause.__cause__ or cause.__context__
        raise cause or error from None


def _trial_of(row: Mapping[str, Any]) -> Any:
    """Return an evaluation as Optuna's trial; one that diverged has failed, without a value."""
    from optuna.distributions import FloatDistribution
    from optuna.trial import TrialState, create_trial

    x = {key: value for key, value in row.items() if key.startswith("x_") and value is not None}
    return create_trial(
        state=TrialState.FAIL if row["diverged"] else TrialState.COMPLETE,
        value=row[OBJECTIVE],
        params=x,
        distributions=dict.fromkeys(x, FloatDistribution(0.0, 1.0)),
        user_attrs={key: row[key] for key in ("evaluation", "seconds", "stage")},
    )

"""Look over what is there: folders that searches, sweeps and traces have made (`fabdesign.studies`), and effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from fabdesign.errors import InputError
from fabdesign.formats.json_file import json_text
from fabdesign.interface.run import Run, paths_of
from fabdesign.interface.verb import Extending, File, Shown, Working, Writing, verb

if TYPE_CHECKING:
    from fabdesign.effects import Effect
    from studies.report.result_folders import EvaluationsTable, Figure, ResultFolder


def _listed(folders: Sequence[ResultFolder], given: Mapping[str, Any]) -> Shown:
    lines = []
    for one in folders:
        headline = "".join(f", {name} {_cell(value)}" for name, value in one.headline.items()) or ", no result yet"
        lines.append(f"{one.path}: {one.made_by}{headline}")
    results = [{"folder": str(one.path), "made_by": one.made_by, **one.headline} for one in folders]
    return Shown({"results": results}, "\n".join(lines) or "no results")


@verb(_listed, "[FOLDERS]...", name="studies list")
def list(folders: Sequence[File] | File = ()) -> Sequence[ResultFolder]:
    """List results, one line each.

    They are looked for in FOLDERS and below; by default in this folder.
    """
    from studies.report.result_folders import folders_below

    return folders_below(paths_of(folders) or [Path()])


def _shown(one: ResultFolder, given: Mapping[str, Any]) -> Shown:
    lines = [f"{one.path}: {one.made_by}", *(f"  {name}: {_cell(value)}" for name, value in one.figures.items())]
    content = {"folder": str(one.path), "made_by": one.made_by, "result": dict(one.result)}
    return Shown(content, "\n".join(lines if one.result else [*lines, "  no result yet"]))


@verb(_shown, name="studies show")
def show(folder: File) -> ResultFolder:
    """Show every value of a result."""
    from studies.report.result_folders import read_folder

    return read_folder(Path(folder))


def _compared(rows: Mapping[str, Sequence[Figure]], given: Mapping[str, Any]) -> Shown:
    folders = [str(folder) for folder in given["folders"]]
    table = [["", *folders], *([name, *map(_cell, values)] for name, values in rows.items())]
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
    return Shown({"folders": folders, "differ": rows}, "\n".join(lines) if rows else "no figure differs")


@verb(_compared, "FOLDERS...", name="studies compare")
def compare(folders: Sequence[File]) -> Mapping[str, Sequence[Figure]]:
    """Compare the results of FOLDERS.

    The table has a row for each value that differs and a column for each folder.
    """
    from studies.report.result_folders import compared, read_folder

    paths = paths_of(folders)
    if len(paths) < 2:
        raise InputError(f"{', '.join(map(str, paths))}: one folder; expected two or more to compare")
    return compared([read_folder(path) for path in paths])


def _tabled(made: EvaluationsTable, given: Mapping[str, Any]) -> Shown:
    out, columns = str(given["out"]), [*made.columns]
    content = {"file": out, "rows": len(made.rows), "columns": columns}
    return Shown(content, f"{out}: {len(made.rows)} rows, {len(columns)} columns")


@verb(_tabled, name="studies table")
def table(folder: File, out: File, **given: Unpack[Writing]) -> EvaluationsTable:
    """Write every evaluation of a search or sweep as one table.

    A NAME.db is a study store of Optuna; only a search has one. Its dashboard opens it: optuna-dashboard
    sqlite:///NAME.db

    out: NAME.csv, NAME.parquet (extra tables) or NAME.db (extra optuna).
    """
    from fabdesign.output import new_file
    from studies.report.result_folders import read_evaluations, write_evaluations, write_optuna_store

    out, folder, force = Path(out), Path(folder), Run(**given).force
    kind = out.suffix.lower()
    needed = {".csv": (), ".parquet": ("pandas", "pyarrow"), ".db": ("optuna",)}
    if kind not in needed:
        raise InputError(f"{out}: expected a name that ends in .csv, .parquet or .db")
    for module in needed[kind]:
        import_module(module)  # missing: said before anything is done
    with new_file(out, force=force) as unfinished:
        evaluations = read_evaluations(folder)
        if kind == ".db":
            write_optuna_store(evaluations, unfinished, folder.resolve().name)
        else:
            write_evaluations(evaluations, unfinished)
    return evaluations


def _cell(value: Figure) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


_SERVES = "for grids up to 41 points a side and designs up to 96 fixed points; others compile at their first use"


@verb(
    lambda seconds, _: Shown({"seconds": seconds}, f"the simulator is compiled, {seconds:.0f} s, {_SERVES}"),
    title="compiling",
    hidden=("force",),
)
def prepare(**given: Unpack[Working]) -> float:
    """Compile the simulator's kernels once on this machine.

    For images and clusters; otherwise that happens at the first use. Two processes may compile side by side.
    """
    from studies.prediction.prepare import prepare as compile_all

    run = Run(**given)
    return compile_all(lambda line: run.progress(line, None))


@verb(lambda content, _: Shown(content, json_text(content, indent=1)), "KIND")
def schema(kind: str) -> dict[str, Any]:
    """Print the JSON Schema of a kind of file, for editors.

    KIND is design, model, study, measurement-set, recording, bench, bench-law or key. An editor that knows it (taplo,
    for example) completes and checks a file while it is typed.
    """
    from studies.check.files import schema_of

    return schema_of(kind)


def _described(effects: dict[str, Effect], given: Mapping[str, Any]) -> Shown:
    from fabdesign.effects.registry import as_text, one_as_text

    name = given["name"]
    return Shown({"effects": [*effects.values()]}, as_text(effects) if name is None else one_as_text(effects[name]))


@verb(_described, "[NAME]", name="effects")
def list_effects(name: str | None = None, **given: Unpack[Extending]) -> dict[str, Effect]:
    """List the effects that a model can have.

    With NAME, describe one: parameters, units, priors, what it looks like in data.
    """
    from fabdesign.effects import EFFECTS
    from fabdesign.effects.registry import effect_named, register_installed

    Run(**given)
    register_installed()
    return EFFECTS if name is None else {name: effect_named(name, "effects")}

"""Look over folders that searches, sweeps and traces have made."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fabdesign.cli.console import FILE, commands, force_option, json_option, print_result
from fabdesign.errors import InputError

if TYPE_CHECKING:
    from studies.result_folders import Figure


@commands.group("studies")
def studies_group() -> None:
    """List, show and compare results."""


@studies_group.command("list")
@click.argument("folders", nargs=-1, type=FILE)
@json_option
def list_results(folders: tuple[Path, ...], as_json: bool) -> None:
    """List results, one line each.

    They are looked for in FOLDERS and below; by default in this folder.
    """
    from studies.result_folders import folders_below

    below = folders_below(folders or (Path(),))
    lines = [f"{folder.path}: {folder.made_by}{_headline_in_words(folder.headline)}" for folder in below]
    results = [{"folder": str(one.path), "made_by": one.made_by, **one.headline} for one in below]
    print_result({"results": results}, "\n".join(lines) or "no results", as_json)


@studies_group.command()
@click.argument("folder", type=FILE)
@json_option
def show(folder: Path, as_json: bool) -> None:
    """Show every value of a result."""
    from studies.result_folders import read_folder

    result = read_folder(folder)
    lines = [
        f"{result.path}: {result.made_by}",
        *(f"  {name}: {_cell(value)}" for name, value in result.figures.items()),
    ]
    content = {"folder": str(result.path), "made_by": result.made_by, "result": dict(result.result)}
    print_result(content, "\n".join(lines if result.result else [*lines, "  no result yet"]), as_json)


@studies_group.command()
@click.argument("folders", nargs=-1, required=True, type=FILE)
@json_option
def compare(folders: tuple[Path, ...], as_json: bool) -> None:
    """Compare the results of FOLDERS.

    The table has a row for each value that differs and a column for each folder.
    """
    from studies.result_folders import compared, read_folder

    if len(folders) < 2:
        raise InputError(f"{folders[0]}: one folder; expected two or more to compare")
    rows = compared([read_folder(folder) for folder in folders])
    table = [["", *map(str, folders)], *([name, *map(_cell, values)] for name, values in rows.items())]
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
    text = "\n".join(lines) if rows else "no figure differs"
    print_result({"folders": [str(folder) for folder in folders], "differ": rows}, text, as_json)


@studies_group.command()
@click.argument("folder", type=FILE)
@click.option(
    "-o", "--output", type=FILE, required=True, help="NAME.csv, NAME.parquet (extra tables) or NAME.db (extra optuna)."
)
@force_option
@json_option
def table(folder: Path, output: Path, force: bool, as_json: bool) -> None:
    """Write every evaluation of a search or sweep as one table.

    A NAME.db is a study store of Optuna; only a search has one. Its dashboard opens it: optuna-dashboard
    sqlite:///NAME.db
    """
    from fabdesign.output import new_file
    from studies.evaluations_table import read_evaluations, write_evaluations, write_optuna_store

    kind = output.suffix.lower()
    if kind not in (".csv", ".parquet", ".db"):
        raise InputError(f"{output}: expected a name that ends in .csv, .parquet or .db")
    if kind == ".parquet":
        import pandas  # noqa: F401 missing: said before anything is done
        import pyarrow  # noqa: F401
    if kind == ".db":
        import optuna  # noqa: F401 the same
    with new_file(output, force=force) as unfinished:
        evaluations = read_evaluations(folder)
        if kind == ".db":
            write_optuna_store(evaluations, unfinished, folder.resolve().name)
        else:
            write_evaluations(evaluations, unfinished)
    result = {"file": str(output), "rows": len(evaluations.rows), "columns": list(evaluations.columns)}
    print_result(result, f"{output}: {len(evaluations.rows)} rows, {len(evaluations.columns)} columns", as_json)


def _headline_in_words(figures: "Mapping[str, Figure]") -> str:
    return "".join(f", {name} {_cell(value)}" for name, value in figures.items()) or ", no result yet"


def _cell(value: "Figure") -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)

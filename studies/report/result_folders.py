"""Folders that commands made: which there are, what they hold, and how they differ."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.formats.json_file import read_json
from fabdesign.output import MARK, read_mark

RESULTS = ("result.json", "trace.json", "evaluation.json", "loop.json", "fusion.json")
# what says most about a result, of each that has it
HEADLINES = ("objective_mm", "chamfer", "surface_rms", "verdict", "evaluations", "complete", "wall_s", "stop_reason")

Figure = str | float | bool | None  # what is not a list or a table


@dataclass(frozen=True)
class ResultFolder:
    """made_by: the command. result: what its JSON file holds; empty where there is none (yet)."""

    path: Path
    made_by: str
    result: Mapping[str, Any]

    @property
    def figures(self) -> dict[str, Figure]:
        """Numbers and words of the result by name, those of inner tables as OUTER.INNER; no lists."""
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
    file = next((path / name for name in RESULTS if (path / name).is_file()), None)
    if file is None:
        return ResultFolder(path, mark.made_by, {})
    return ResultFolder(path, mark.made_by, read_json(file))


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

"""Files that a command may write over: those that the mark of their folder, `.fabdesign`, lists as this program's own,
and never an input, or a file that an input names."""

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.formats.toml_file import parse_toml
from fabdesign.output.atomic import PREFIX, write_text
from fabdesign.version import __version__

MARK = ".fabdesign"
FORMAT = "fabdesign.output/1"
_HEADS = ("set.toml", "recording.toml", "bench.toml")  # of the folders that are read as one
_read_by_all: set[Path] = set()


@dataclass(frozen=True)
class Mark:
    """`made_by`: the command. `files`: paths relative to the folder, with forward slashes."""

    made_by: str
    files: frozenset[str]


def read_mark(folder: Path) -> Mark | None:
    """Return the folder's mark; None where there is none, or none that can be read: then the folder belongs to
    others."""
    try:
        content = json.loads((folder / MARK).read_text(encoding="utf-8"))
        if content["format"] != FORMAT:
            return None
        return Mark(str(content["made_by"]), frozenset(map(str, content["files"])))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def write_mark(folder: Path, made_by: str, files: Iterable[str]) -> None:
    """Write the mark, whole."""
    content = {"format": FORMAT, "made_by": made_by, "version": __version__, "files": sorted(files)}
    write_text(folder / MARK, json.dumps(content, indent=1) + "\n")


def files_in(folder: Path) -> Iterator[str]:
    """Yield what lies in the folder and below it, but for empty folders and what is under way: relative, forward
    slashes."""
    for top, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(PREFIX))
        links = [name for name in folders if (Path(top) / name).is_symlink()]  # which are not walked into
        for name in sorted([*files, *links]):
            if not name.startswith(PREFIX):
                yield (Path(top) / name).relative_to(folder).as_posix()


def others_in(folder: Path) -> Iterator[str]:
    """Yield those of `files_in` that this program did not make, as the mark of the folder and of those in it say."""
    mark_of = cache(read_mark)
    for name in files_in(folder):
        file = folder / name
        above = [parent for parent in file.parents if parent == folder or folder in parent.parents]
        listed = any(file.relative_to(p).as_posix() in mark.files for p in above if (mark := mark_of(p)))
        if not listed and not (file.name == MARK and mark_of(file.parent)):
            yield name


def marked_files(folder: Path) -> set[str]:
    """Return those of `files_in` that this program made."""
    return set(files_in(folder)) - set(others_in(folder))


def always_input(path: Path) -> None:
    """Count `path` among the inputs of whatever this process writes: it was read before a command began."""
    _read_by_all.add(path.resolve())


def require_apart(goal: Path, inputs: Iterable[Path | str]) -> None:
    """Raise InputError where writing `goal` would write over one of `inputs`, or over a file that one of them names.

    goal: a file, or a folder that all its content goes with. inputs: files and folders; what is not there is passed
    over.
    """
    where = goal.resolve()
    for given in (*map(Path, inputs), *_read_by_all):
        for read in _with_named(given):
            if read == where or (where.is_file() and where.samefile(read)):
                raise InputError(f"{goal}: is an input; expected another place to write to")
            if where in read.parents:
                raise InputError(f"{goal}: holds the input {read.relative_to(where)}; expected another folder")
            if where.is_file() and read in where.parents:
                raise InputError(f"{goal}: is part of the input {given}; expected another place to write to")


def _with_named(path: Path) -> Iterator[Path]:
    """Yield the file or folder, and the files that it names, that those name, and so on: resolved, each once."""
    seen: set[Path] = set()
    pending = [path]
    while pending:
        file = pending.pop()
        try:
            file = file.resolve()
            if file in seen or not (file.is_file() or (file.is_dir() and not seen)):
                continue
        except (OSError, ValueError):  # "400,0,200" repeated: no name that a file could have
            continue
        seen.add(file)
        yield file
        if file.is_dir():
            pending += [file / head for head in _HEADS]
        elif file.suffix == ".toml":
            pending += [file.parent / text for text in _texts(file)]


def _texts(path: Path) -> Iterator[str]:
    """Yield all strings in a TOML file; of one that cannot be read, none: whoever reads it says so."""
    try:
        pending: list[Any] = [parse_toml(path)]
    except InputError:
        return
    while pending:
        value = pending.pop()
        if isinstance(value, str) and value:
            yield value
        elif isinstance(value, dict):
            pending += [entry for key, entry in value.items() if key not in ("name", "description")]
            if isinstance(start := value.get("start"), str):  # of a study: the folder of a result
                yield f"{start}/design.toml"
        elif isinstance(value, list):
            pending += value

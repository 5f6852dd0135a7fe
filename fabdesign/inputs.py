"""What a command reads, so that it is never written over."""

import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.table import LARGEST_TOML, read_text

_HEADS = ("set.toml", "recording.toml", "bench.toml")  # of the folders that are read as one
_read_by_all: set[Path] = set()


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
    """The file or folder, and the files that it names, that those name, and so on: resolved, each once."""
    seen: set[Path] = set()
    left = [path]
    while left:
        file = left.pop()
        try:
            file = file.resolve()
            if file in seen or not (file.is_file() or (file.is_dir() and not seen)):
                continue
        except (OSError, ValueError):  # "400,0,200" repeated: no name that a file could have
            continue
        seen.add(file)
        yield file
        if file.is_dir():
            left += [file / head for head in _HEADS]
        elif file.suffix == ".toml":
            left += [file.parent / text for text in _texts(file)]


def _texts(path: Path) -> Iterator[str]:
    """All strings in a TOML file; of one that cannot be read, none: whoever reads it says so."""
    try:
        left: list[Any] = [tomllib.loads(read_text(path, largest=LARGEST_TOML))]
    except ValueError:  # TOMLDecodeError, InputError
        return
    while left:
        value = left.pop()
        if isinstance(value, str) and value:
            yield value
        elif isinstance(value, dict):
            left += [entry for key, entry in value.items() if key not in ("name", "description")]
            if isinstance(start := value.get("start"), str):  # of a study: the folder of a result
                yield f"{start}/design.toml"
        elif isinstance(value, list):
            left += value


def is_bench(source: Path) -> bool:
    """Whether it is a bench's folder, or its bench.toml."""
    return source.name == "bench.toml" or (source / "bench.toml").is_file()

"""The mark that this program leaves in a folder it made: `.fabdesign`, which lists the files that are its own."""

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fabdesign import __version__
from fabdesign.scratch import PREFIX

MARK = ".fabdesign"
FORMAT = "fabdesign.output/1"


@dataclass(frozen=True)
class Mark:
    """`made_by`: the command. `files`: paths relative to the folder, with forward slashes."""

    made_by: str
    files: frozenset[str]


def read_mark(folder: Path) -> Mark | None:
    """The folder's mark; None where there is none, or none that can be read: then the folder belongs to others."""
    try:
        content = json.loads((folder / MARK).read_text(encoding="utf-8"))
        if content["format"] != FORMAT:
            return None
        return Mark(str(content["made_by"]), frozenset(map(str, content["files"])))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_mark(folder: Path, made_by: str, files: Iterable[str]) -> None:
    """Write the mark, whole."""
    content = {"format": FORMAT, "made_by": made_by, "version": __version__, "files": sorted(files)}
    unfinished = folder / f"{PREFIX}-mark"
    unfinished.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    unfinished.replace(folder / MARK)


def files_in(folder: Path) -> Iterator[str]:
    """What lies in the folder and below it, but for empty folders and what is under way: relative, forward slashes."""
    for top, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(PREFIX))
        links = [name for name in folders if (Path(top) / name).is_symlink()]  # which are not walked into
        for name in sorted([*files, *links]):
            if not name.startswith(PREFIX):
                yield (Path(top) / name).relative_to(folder).as_posix()


def others_in(folder: Path) -> Iterator[str]:
    """Those of `files_in` that this program did not make, as the mark of the folder and of those in it say."""
    marks: dict[Path, Mark | None] = {}
    for name in files_in(folder):
        file = folder / name
        above = [parent for parent in file.parents if parent == folder or folder in parent.parents]
        marks |= {parent: read_mark(parent) for parent in above if parent not in marks}
        known = [(parent, mark) for parent in above if (mark := marks[parent]) is not None]
        marks_itself = file.name == MARK and marks[file.parent] is not None
        if not marks_itself and not any(file.relative_to(p).as_posix() in mark.files for p, mark in known):
            yield name


def own_files(folder: Path) -> set[str]:
    """Those of `files_in` that this program made."""
    return set(files_in(folder)) - set(others_in(folder))

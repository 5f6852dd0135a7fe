"""The mark that this program leaves in a folder it made: `.fabdesign`, which lists the files that are its own."""

import json
import os
from collections.abc import Iterable
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
    """The folder's mark; None where there is none, or none that can be read: then the folder is somebody else's."""
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


def files_in(folder: Path) -> set[str]:
    """What lies in the folder and below it, but for empty folders and what is under way: relative, forward slashes."""
    found: set[str] = set()
    for top, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(PREFIX)]
        links = [name for name in folders if (Path(top) / name).is_symlink()]  # which are not walked into
        names = [name for name in files if not name.startswith(PREFIX)]
        found |= {(Path(top) / name).relative_to(folder).as_posix() for name in [*names, *links]}
    return found


def own_files(folder: Path) -> set[str]:
    """Those of `files_in` that this program made, by the folder's mark or by that of a folder in it."""
    found = files_in(folder)
    own: set[str] = set()
    for name in found:
        if name == MARK or name.endswith(f"/{MARK}"):
            inner = Path(name).parent
            mark = read_mark(folder / inner)
            if mark is not None:
                own |= {name, *((inner / file).as_posix() for file in mark.files)}
    return own & found

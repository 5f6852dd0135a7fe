"""Work that is kept as it is done: the same call goes on where it stood, and never from work on other content.

What a result depends on (hashes of files, designs, options, the version of the algorithm, which its author raises) is
its content, by field. A folder's pieces are of one content. A piece that is damaged is said and computed again.
`user_cache`: the folder of results that depend on nothing but what their name hashes.
"""

import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fabdesign import working_time
from fabdesign.errors import InputError, note
from fabdesign.output import WorkFolder, whole_file, write_text

FOLDER = "pieces"
Arrays = dict[str, NDArray[Any]]
Value = TypeVar("Value")
DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    EOFError,
    RecursionError,
    zipfile.BadZipFile,
)  # what a damaged file raises
_CONTENT = "content.json"
_TOLD = 3  # fields that differ
_LONGEST = 50  # characters of a value that is told


class OtherContent(InputError):
    """What is kept is of other content than the work that is to go on."""


class Checkpoint:
    """The pieces of one piece of work, in files of `pieces` in its folder.

    seconds: after so much computing no further piece is begun; None: no limit. Raises OtherContent, which says what
    differs, where the folder holds pieces of other content, unless it is worked in anew, or they go by `force`.
    """

    def __init__(
        self, work: WorkFolder, content: Mapping[str, str], *, seconds: float | None = None, force: bool = False
    ) -> None:
        self._work, self._seconds = work, seconds
        self._folder = work.folder / FOLDER
        file = self._folder / _CONTENT
        if file.is_file():
            known = read_kept(file, _json_table, "what lies beside it")
            if known == content:
                return
            if known is not None and not (work.anew or force):
                require_same(known, content, work.folder, "other work")
            work.clear()
            for piece in self._folder.glob("*"):
                piece.unlink()
        self._folder.mkdir(exist_ok=True)
        self._write(_CONTENT, dict(content))

    @property
    def spent(self) -> float:
        """s of computing, all sessions together, in pieces by `get`."""
        total = 0.0
        for file in self._folder.glob("*.json"):
            if file.name != _CONTENT:
                with suppress(*DAMAGE):  # which is said where the piece is asked for
                    total += float(_json_table(file)["seconds"])
        return total

    def has(self, name: str) -> bool:
        """Whether a piece is kept."""
        return any(self._file(name, ending).is_file() for ending in ("json", "npz"))

    def own(self, *files: str) -> Path:
        """The folder of the pieces, where others write `files`, each of them whole."""
        self._work.claim(*(f"{FOLDER}/{file}" for file in files))
        return self._folder

    def get(self, name: str, compute: Callable[[], Any], *, files: Callable[[Any], object] | None = None) -> Any:
        """What JSON can hold: what is kept of this name, else computed and kept; None where there is no time to begin
        it.

        files: reads what belongs to a kept value and lies in files; where it raises, the piece is damaged.
        """
        file = self._file(name, "json")

        def read(path: Path) -> list[Any]:
            value = _json_table(path)["found"]
            if files is not None:
                files(value)
            return [value]

        if file.is_file() and (kept := read_kept(file, read, "it")) is not None:
            return kept[0]
        if self._seconds is not None and self.spent >= self._seconds:
            return None
        begun = working_time.seconds()
        value = compute()
        self._write(file.name, {"found": value, "seconds": working_time.seconds() - begun})
        return _json_table(file)["found"]

    def arrays(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """The same of arrays by name."""
        file = self._file(name, "npz")
        if file.is_file() and (kept := read_kept(file, _read_arrays, "it")) is not None:
            return kept
        arrays = compute()
        self.own(file.name)
        needed = sum(array.nbytes for array in arrays.values())
        with whole_file(file, needed=needed) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
        return arrays

    def _file(self, name: str, ending: str) -> Path:
        return self._folder / f"{''.join(c if c.isalnum() or c == '_' else '-' for c in name)}.{ending}"

    def _write(self, name: str, content: Any) -> None:
        self.own(name)
        write_text(self._folder / name, json.dumps(content) + "\n")


def read_kept(file: Path, read: Callable[[Path], Value], again: str) -> Value | None:
    """Return what `read` gives of a kept file; None of a damaged one, which is said: `again` is done again."""
    try:
        return read(file)
    except DAMAGE as error:
        reason = str(error) or type(error).__name__
        note(f"{file}: damaged ({reason if file.stat().st_size else 'empty'}); {again} is computed again")
        return None


def _json_table(file: Path) -> dict[str, Any]:
    table = json.loads(file.read_text(encoding="utf-8"))
    if not isinstance(table, dict):
        raise ValueError("no table")
    return table


def _read_arrays(file: Path) -> Arrays:
    with np.load(file, allow_pickle=False) as kept:
        return {key: kept[key] for key in kept.files}


def require_same(known: Mapping[str, str], content: Mapping[str, str], folder: Path, holds: str) -> None:
    """Raise OtherContent, which says what differs, where what is kept is of other content. holds: what it then is."""
    if known != content:
        raise OtherContent(
            f"{folder}: holds {holds} ({differences(known, content)}); expected the same one, or --force to start anew"
        )


def differences(known: Mapping[str, str], content: Mapping[str, str]) -> str:
    """A clause a field, of the first few."""
    differing = [name for name in {**known, **content} if known.get(name) != content.get(name)]
    told = []
    for name in differing[:_TOLD]:
        before, now = known.get(name, "not there"), content.get(name, "not there")
        long = max(len(before), len(now)) > _LONGEST
        told.append(f"{name} differs" if long else f"{name} was {before}, now {now}")
    more = len(differing) - len(told)
    return "; ".join([*told, *([f"and {more} more"] if more else [])])


def sha256(path: Path) -> str:
    """Of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def user_cache(kind: str) -> Path:
    """The folder of one kind of result: in FABDESIGN_CACHE, else in the user's cache folder. It need not be there."""
    base = os.environ.get("FABDESIGN_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "fabdesign" / kind

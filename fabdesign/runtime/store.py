"""The one store of work that is kept as it is done: whole or not there, on the disk before it counts, and never taken
for work on other content (fabdesign/runtime/fingerprint.py). What is damaged is said in a line and done again.

`kept`: one file, such as a result in `user_cache`, whose name hashes all that it depends on. `Checkpoint`: the pieces
of a work folder. `Database`: rows that come by the thousand, in SQLite.
"""

import errno
import json
import os
import sqlite3
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import note
from fabdesign.formats.json_file import exact, read_json
from fabdesign.output import WorkFolder, atomic_file, cannot_write, sweep, write_text
from fabdesign.runtime import working_time
from fabdesign.runtime.fingerprint import OtherContent, require_same
from fabdesign.runtime.shortage import free_bytes

FOLDER = "pieces"
ASIDE = ".damaged"  # ending of a damaged database
Arrays = dict[str, NDArray[Any]]
Value = TypeVar("Value")
# what a damaged file raises
_DAMAGE = OSError, ValueError, KeyError, TypeError, EOFError, RecursionError, zipfile.BadZipFile
_CONTENT = "content.json"
_CONTENT_TABLE = "create table if not exists content (field text primary key, value text);"
_PAGES = 1 << 16  # bytes that SQLite needs to write at all


def user_cache(kind: str) -> Path:
    """Return the folder of one kind of result: in FABDESIGN_CACHE, else in the user's cache folder. It need not be
    there."""
    base = os.environ.get("FABDESIGN_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "fabdesign" / kind


def read_kept(file: Path, read: Callable[[Path], Value], again: str = "it") -> Value | None:
    """Return what `read` gives of a kept file; None where it is not there, or damaged, which is said: `again` is done
    again."""
    if not file.is_file():
        return None
    try:
        return read(file)
    except _DAMAGE as error:
        reason = str(error).removeprefix(f"{file}: ") or type(error).__name__
        note(f"{file}: damaged ({reason if file.stat().st_size else 'empty'}); {again} is computed again")
        return None


def kept(
    file: Path, compute: Callable[[], Value], read: Callable[[Path], Value], write: Callable[[Path, Value], None]
) -> Value:
    """Return what a file keeps; what is not there, or damaged, is computed and kept first. `write` writes it whole."""
    if (value := read_kept(file, read)) is not None:
        return value
    value = compute()
    sweep(file.parent)
    write(file, value)
    return value


def read_arrays(file: Path) -> Arrays:
    """Return the arrays of an npz file by name."""
    with np.load(file, allow_pickle=False) as arrays:
        return {key: arrays[key] for key in arrays.files}


def write_arrays(file: Path, arrays: Arrays) -> None:
    """Write an npz file whole or not at all."""
    with atomic_file(file, needed=sum(array.nbytes for array in arrays.values())) as new, new.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


class Checkpoint:
    """The pieces of one piece of work, in files of `pieces` in its folder.

    seconds: after so much computing no further piece is begun; None: no limit. Raises OtherContent, which says what
    differs, where the folder holds pieces of other content, unless it is worked in anew, or they go by `force`.
    """

    def __init__(
        self, work: WorkFolder, content: Mapping[str, str], *, seconds: float | None = None, force: bool = False
    ) -> None:
        self._work, self._seconds, self._folder = work, seconds, work.folder / FOLDER
        known = read_kept(self._folder / _CONTENT, read_json, "what lies beside it")
        if known == content:
            return
        if known is not None and not (work.anew or force):
            require_same(known, content, work.folder, "other work")
        work.clear()
        for piece in self._folder.glob("*"):
            piece.unlink()
        self._write(_CONTENT, dict(content))

    @property
    def spent(self) -> float:
        """Return s of computing, all sessions together, in pieces by `get`."""
        total = 0.0
        for file in self._folder.glob("*.json"):
            if file.name != _CONTENT:
                with suppress(*_DAMAGE):  # which is said where the piece is asked for
                    total += float(read_json(file)["seconds"])
        return total

    def has(self, name: str) -> bool:
        """Return whether a piece is kept."""
        return any((self._folder / _file_name(name, ending)).is_file() for ending in ("json", "npz"))

    def claim(self, *files: str) -> Path:
        """Return the folder of the pieces, where others write `files`, each of them whole."""
        self._work.claim(*(f"{FOLDER}/{file}" for file in files))
        return self._folder

    def get(self, name: str, compute: Callable[[], Any], *, files: Callable[[Any], object] | None = None) -> Any:
        """Return what JSON holds of a value (`plain`, exact): what is kept of this name, else computed and kept; None
        where there is no time to begin it.

        files: reads what belongs to a kept value and lies in files; where it raises, the piece is damaged.
        """
        file = self._folder / _file_name(name, "json")

        def read(path: Path) -> list[Any]:
            value = read_json(path)["found"]
            if files is not None:
                files(value)
            return [value]

        if (there := read_kept(file, read)) is not None:
            return there[0]
        if self._seconds is not None and self.spent >= self._seconds:
            return None
        begun = working_time.seconds()
        value = compute()
        self._write(file.name, {"found": value, "seconds": working_time.seconds() - begun})
        return read_json(file)["found"]

    def arrays(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """Return the same of arrays by name."""
        file = _file_name(name, "npz")
        return kept(self.claim(file) / file, compute, read_arrays, write_arrays)

    def _write(self, name: str, content: Any) -> None:
        write_text(self.claim(name) / name, json.dumps(exact(content)) + "\n")


def _file_name(name: str, ending: str) -> str:
    return f"{''.join(c if c.isalnum() or c == '_' else '-' for c in name)}.{ending}"


class Database:
    """A SQLite file of work under way: it holds what the work depends on, and a commit is on the disk when it returns.
    One that is damaged is put aside, and the work begins anew: both are said in a line.

    Raises OtherContent, which says what differs, where the file is that of other work; nothing in it changes. Raises
    InputError where it cannot be written.
    """

    schema: ClassVar[str]  # makes tables that are not there
    holds: ClassVar[str]  # what a file of other content has

    def __init__(self, path: Path | str, content: Mapping[str, str]) -> None:
        self._path = Path(path)
        try:
            self._file = self._opened(content)
        except sqlite3.DatabaseError as error:
            if _code(error) not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                raise cannot_write(self._path, _as_os_error(self._path, error)) from None
            aside = self._path.name + ASIDE
            note(f"{path}: damaged ({error}); kept as {aside}, and its work is done again")
            with writing(self._path):
                self._path.replace(self._path.with_name(aside))
                for ending in ("-wal", "-shm"):
                    self._path.with_name(self._path.name + ending).unlink(missing_ok=True)
                self._file = self._opened(content)

    @classmethod
    def of_work(cls, work: WorkFolder, name: str, content: Mapping[str, str]) -> Self:
        """Open the file of a work folder; where that is worked in anew, what is of other content goes."""
        files = [name + ending for ending in ("", "-wal", "-shm", ASIDE)]
        work.claim(*files)
        try:
            return cls(work.folder / name, content)
        except OtherContent:
            if not work.anew:
                raise
        work.clear()
        return cls.of_work(work, name, content)

    def rows(self, query: str, *values: object) -> list[Any]:
        """Return the rows of a query."""
        return self._file.execute(query, values).fetchall()

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Give what statements are executed on, and commit. A full disk, or a file that may not grow, is an
        InputError."""
        with writing(self._path), self._file:
            yield self._file

    def _opened(self, content: Mapping[str, str]) -> sqlite3.Connection:
        file = sqlite3.connect(self._path)
        try:
            file.execute("pragma journal_mode = wal")
            file.execute("pragma synchronous = full")  # a commit is on the disk
            if (problem := file.execute("pragma quick_check(1)").fetchone()[0]) != "ok":
                damage = sqlite3.DatabaseError(" ".join(problem.split()))
                damage.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
                raise damage
            file.executescript(_CONTENT_TABLE + self.schema)
            if known := dict(file.execute("select field, value from content").fetchall()):
                require_same(known, content, self._path.parent, self.holds)
            with file:
                file.executemany("insert or replace into content values (?, ?)", content.items())
        except BaseException:
            file.close()
            raise
        return file

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._file.close()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Give a context in which SQLite writes: a full disk, or a file that may not grow, is an InputError."""
    try:
        yield
    except (OSError, sqlite3.OperationalError) as error:
        raise cannot_write(path, _as_os_error(path, error)) from error


def _code(error: sqlite3.Error) -> int:
    """Return the primary code; 0 where SQLite gave none."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _as_os_error(path: Path, error: OSError | sqlite3.Error) -> OSError:
    """Return the error as the system's, which SQLite does not pass on: of a disk with no room for a page, too, it says
    "disk I/O error"."""
    if isinstance(error, OSError):
        return error
    number = {sqlite3.SQLITE_FULL: errno.ENOSPC, sqlite3.SQLITE_IOERR: errno.EIO}.get(_code(error), errno.EACCES)
    if number == errno.EIO and free_bytes(path) < _PAGES:
        number = errno.ENOSPC
    return OSError(number, str(error))

"""A SQLite file of work under way: it holds what the work depends on, and a commit is on the disk when it returns.

One that is damaged is put aside, and the work begins anew: both are said in a line.
"""

import errno
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fabdesign.checkpoint import require_same
from fabdesign.errors import note
from fabdesign.output import cannot_write
from fabdesign.shortage import free_bytes

ASIDE = ".damaged"  # ending of what is put aside
_PAGES = 1 << 16  # bytes that SQLite needs to write at all
_CONTENT = "create table if not exists content (field text primary key, value text);"


def files_of(name: str) -> tuple[str, ...]:
    """Return the names of all files that a database `name` may leave, for the mark of its folder."""
    return tuple(name + ending for ending in ("", "-wal", "-shm", ASIDE))


def open_database(path: Path | str, schema: str, content: Mapping[str, str], holds: str) -> sqlite3.Connection:
    """Open the file, which `schema` makes where it is not there.

    content: what the work depends on, by field. holds: what the file has where that differs. Raises OtherContent, which
    says what differs, where it is that of other work; nothing in it changes. Raises InputError where it cannot be
    written.
    """
    try:
        return _opened(path, schema, content, holds)
    except sqlite3.DatabaseError as error:
        if not _damaged(error):
            raise cannot_write(Path(path), _as_os_error(Path(path), error)) from None
        note(f"{path}: damaged ({error}); kept as {Path(path).name}{ASIDE}, and its work is done again")
    file = Path(path)
    with writing(file):
        file.replace(file.with_name(file.name + ASIDE))
        for ending in ("-wal", "-shm"):
            file.with_name(file.name + ending).unlink(missing_ok=True)
        return _opened(path, schema, content, holds)


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """A context in which a full disk, or a file that may not grow, is an InputError that names `path`."""
    try:
        yield
    except (OSError, sqlite3.OperationalError) as error:
        raise cannot_write(Path(path), _as_os_error(Path(path), error)) from error


def _opened(path: Path | str, schema: str, content: Mapping[str, str], holds: str) -> sqlite3.Connection:
    file = sqlite3.connect(path)
    try:
        file.execute("pragma journal_mode = wal")
        file.execute("pragma synchronous = full")  # a commit is on the disk
        if (problem := file.execute("pragma quick_check(1)").fetchone()[0]) != "ok":
            raise _damage(problem)
        file.executescript(_CONTENT + schema)
        known = dict(file.execute("select field, value from content").fetchall())
        if known:
            require_same(known, content, Path(path).parent, holds)
        with file:
            file.executemany("insert or replace into content values (?, ?)", content.items())
    except BaseException:
        file.close()
        raise
    return file


def _damage(problem: str) -> sqlite3.DatabaseError:
    error = sqlite3.DatabaseError(" ".join(problem.split()))
    error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return error


def _code(error: sqlite3.Error) -> int:
    """Return the primary code; 0 where SQLite gave none."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _damaged(error: sqlite3.Error) -> bool:
    return _code(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def _as_os_error(path: Path, error: OSError | sqlite3.Error) -> OSError:
    """Return the error as the system's, which SQLite does not pass on: of a disk with no room for a page, too, it says
    "disk I/O error"."""
    if isinstance(error, OSError):
        return error
    number = {sqlite3.SQLITE_FULL: errno.ENOSPC, sqlite3.SQLITE_IOERR: errno.EIO}.get(_code(error), errno.EACCES)
    if number == errno.EIO and free_bytes(path) < _PAGES:
        number = errno.ENOSPC
    return OSError(number, str(error))

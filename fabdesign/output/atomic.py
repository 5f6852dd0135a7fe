"""A temporary file that becomes the whole one by a rename, and hidden folders for unfinished output: locked while their
process lives, swept when it was killed."""

import errno
import os
import re
import shutil
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO
from uuid import uuid4

from fabdesign.errors import InputError
from fabdesign.runtime.shortage import concerns_disk, disk_line
from fabdesign.runtime.supervisor import record

PREFIX = ".unfinished"
_LOCK = "lock"
_LOCK_CONTENT = b"fabdesign"  # in a lock: folders of others may have one too
_LONE = re.compile(re.escape(PREFIX) + r"-[0-9a-f]{32}(\..*)?")  # names of unfinished files
_OLD = 3600.0  # s: a lone unfinished file takes a moment to write
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)


def try_lock(stream: IO[bytes]) -> bool | None:
    """Return whether `stream`'s file is now this process's, until it closes the stream or ends; None where the file
    system knows no locks."""
    from filelock import lock_descriptor  # here: it takes 0.1 s to load

    try:
        return lock_descriptor(stream.fileno(), blocking=False)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return None
        raise


class Scratch:
    """A folder `at`, this process's until `release` or `discard`."""

    def __init__(self, at: Path, lock: IO[bytes], made: list[Path]) -> None:
        self.at, self._lock, self._made = at, lock, made

    def release(self) -> None:
        """Give it up, as it is."""
        self._lock.close()

    def discard(self) -> None:
        """Remove it, and folders above that were made for it and hold nothing."""
        _remove(self.at, self._lock)
        unmake(self._made)
        self._lock.close()


@contextmanager
def scratch(goal: Path, at: Path) -> Iterator[Scratch]:
    """Hold the folder `at` while `goal` is written; `release` what is held within the block, or it goes at its end.

    Folders above are made. What killed processes left beside `at` is swept; what one left in it is there still.
    Raises InputError where another process holds it, where it cannot be written, and where the disk is full within the
    block.
    """
    made = make_folders(at.parent, goal)
    sweep(at.parent, but=at)
    record(scratch=str(at))
    try:
        lock = _acquire(at)
    except OSError as error:
        unmake(made)
        raise cannot_write(goal, error) from None
    if lock is None:
        raise InputError(f"{goal}: another run is writing there; expected to be the only one")
    held = Scratch(at, lock, made)
    try:
        yield held
    except OSError as error:
        if not concerns_disk(error):
            raise
        raise cannot_write(goal, error, written=_bytes_in(at)) from error
    finally:
        if not lock.closed:
            held.discard()


def _acquire(at: Path) -> IO[bytes] | None:
    """Return the lock of the folder `at`, made where it is not there; None where another process has it."""
    while True:
        at.mkdir(exist_ok=True)
        try:
            if not _is_users(at) or (any(at.iterdir()) and not (at / _LOCK).exists()):
                raise InputError(
                    f"{at}: is a link, another user's, or holds other files; expected nothing of this name"
                )
            lock = (at / _LOCK).open("ab")
        except FileNotFoundError:
            continue  # another process swept the folder meanwhile
        if try_lock(lock) is False:
            lock.close()
            return None
        if os.fstat(lock.fileno()).st_nlink:  # its last holder may have removed it before letting go
            if not lock.tell():
                lock.write(_LOCK_CONTENT)
                lock.flush()
            return lock
        lock.close()


def abandoned(at: Path) -> Scratch | None:
    """Return the scratch folder of an ended process, to be released; None where it was, or another one holds it."""
    lock = _acquire(at) if at.is_dir() else None
    return None if lock is None else Scratch(at, lock, [])


def _remove(at: Path, lock: IO[bytes]) -> None:
    """Remove the lock last, so that whoever takes it meanwhile finds all of the folder or none of it."""
    for entry in at.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        elif entry.name != _LOCK:
            entry.unlink(missing_ok=True)
    if os.name == "nt":
        lock.close()  # an open file cannot be removed there
    with suppress(OSError):
        (at / _LOCK).unlink()
        at.rmdir()


def sweep(folder: Path, *, but: Path | None = None) -> None:
    """Remove what killed processes of this program and user left in `folder`, except `but`. Links are not followed."""
    for entry in folder.glob(f"{PREFIX}*"):
        if entry == but:
            continue
        with suppress(OSError):
            if not _is_users(entry):
                continue
            if entry.is_file():
                if _LONE.fullmatch(entry.name) and time.time() - entry.stat().st_mtime > _OLD:
                    entry.unlink()
            elif _is_users(entry / _LOCK) and (entry / _LOCK).read_bytes() == _LOCK_CONTENT:
                with (entry / _LOCK).open("ab") as lock:
                    if try_lock(lock):  # where there are no locks, nothing says that it was left
                        _remove(entry, lock)


def _is_users(path: Path) -> bool:
    """Return whether a file or folder is this user's, and no link."""
    state = path.lstat()
    return not stat.S_ISLNK(state.st_mode) and (not hasattr(os, "getuid") or state.st_uid == os.getuid())


def make_folders(path: Path, goal: Path) -> list[Path]:
    """Make `path` and what is missing above it; the ones made, deepest first. InputError names `goal`."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    record(made=[str(folder.absolute()) for folder in missing])
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        unmake(missing)
        raise cannot_write(goal, error) from None
    for folder in missing:
        _flush(folder.parent)
    return missing


def unmake(folders: list[Path]) -> None:
    """Remove folders, deepest first, as far as they hold nothing."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return  # not empty, or never made


def cannot_write(path: Path, error: OSError, *, needed: int | None = None, written: int = 0) -> InputError:
    """Return what says so in a line. needed: bytes of the whole file, where they are known. written: bytes so far."""
    return InputError(disk_line(_shown(path), error, needed=needed, written=written))


def _shown(path: Path) -> Path:
    """Return where a file that is written within a hidden folder will lie."""
    parts = path.parts
    hidden = next((k for k, part in enumerate(parts[:-1]) if part.startswith(PREFIX)), None)
    if hidden is None:
        return path
    inner = parts[hidden + 1 :]  # new/NAME, where NAME is that of the goal; or piece
    goal_is_folder = parts[hidden] == PREFIX
    return _shown(Path(*parts[:hidden], *(inner[2:] if goal_is_folder and inner[0] == "new" else inner[1:])))


def _bytes_in(path: Path) -> int:
    """Return the size of a file, or of what a folder holds."""
    with suppress(OSError):
        return sum(file.stat().st_size for file in (path, *path.rglob("*")) if file.is_file())
    return 0


def settle(moves: Mapping[Path, Path]) -> None:
    """Rename files to their places, in this order. When it returns, what they hold and their names are on the disk:
    neither a kill nor a power cut takes them back. Where a signal asks the program to end meanwhile, all still move."""

    def replace_remaining() -> None:
        for source, place in moves.items():
            if source.exists():
                source.replace(place)

    for source in moves:
        flush_file(source)
    try:
        replace_remaining()
    except BaseException as error:
        if not isinstance(error, Exception):
            replace_remaining()
        raise
    for folder in {place.parent for place in moves.values()}:
        _flush(folder)


def flush_file(path: Path) -> None:
    """Bring what a file holds to the disk. Raises OSError where it does not fit."""
    if path.is_file():
        with path.open("rb+" if os.name == "nt" else "rb") as stream:
            os.fsync(stream.fileno())


def _flush(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


@contextmanager
def atomic_file(path: Path | str, *, needed: int | None = None) -> Iterator[Path]:
    """Return a temporary path beside `path`; it replaces `path` when the block ends well, and goes when it does not.

    Folders above `path` are made. needed: bytes, where they are known. Raises InputError where nothing can be written
    and where the disk is full within the block.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected a file name to write to")
    made = make_folders(path.parent, path)
    temporary = path.with_name(f"{PREFIX}-{uuid4().hex}{path.suffix}")
    record(file=str(temporary.absolute()))
    try:
        temporary.touch(exist_ok=False)
    except OSError as error:
        unmake(made)
        raise cannot_write(path, error) from None
    try:
        yield temporary
        settle({temporary: path})
    except OSError as error:
        if not concerns_disk(error):
            raise
        # what is free is asked while the file takes its room
        raise cannot_write(path, error, needed=needed, written=_bytes_in(temporary)) from error
    finally:
        temporary.unlink(missing_ok=True)
        unmake(made)  # those that hold nothing


def write_text(path: Path | str, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all; it replaces one that is there.

    A file's name in the text keeps its bytes, also where they are no UTF-8.
    """
    content = text.encode("utf-8", "surrogateescape")
    with atomic_file(path, needed=len(content)) as temporary:
        temporary.write_bytes(content)

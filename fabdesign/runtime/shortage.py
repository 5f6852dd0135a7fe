"""Answers to a machine that has too little of something: messages on disk, memory, or what its limits allow, which
`fabdesign/output` says of what it writes, the command line of all else (`line_of`); and a folder for what Taichi, Numba
and Matplotlib compile and keep, where the user's own cannot be written, or is full.

Homes are read-only in containers, and on clusters that run jobs for others. Taichi then ends with a segmentation fault,
Numba with an error. All three take the place from XDG_CACHE_HOME, Matplotlib its settings from MPLCONFIGDIR.
"""

import errno
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from fabdesign.errors import InputError, note

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_BROKEN = (errno.EIO, errno.EROFS)
# what others raise where they get no memory: the loader, Taichi, LLVM
_NO_MEMORY = re.compile(r"memory allocation|cannot allocate memory|failed to map segment|out of memory|bad_alloc", re.I)
_STALE = 60.0  # s
_ROOM = 1_000_000  # bytes: Matplotlib's list of fonts has some 100 kB


def concerns_disk(error: BaseException) -> bool:
    """Return whether an error says that the disk, or a limit of a file's size, ended a write."""
    return isinstance(error, OSError) and error.errno in (*_FULL, *_BROKEN)


def disk_line(path: Path, error: OSError, *, needed: int | None = None, written: int = 0) -> str:
    """Return why `path` cannot be written, in a line: with the bytes that are free, and those missing of `needed`, or
    those `written` so far where that is not known."""
    reason = error.strerror or str(error)
    if error.errno not in _FULL:
        return f"{path}: cannot be written ({reason})"
    needs = f"{in_bytes(written)} written so far, " if written else ""
    needs = needs if needed is None else f"needs {in_bytes(needed)}, "
    if error.errno == errno.EFBIG:
        most = _limit("RLIMIT_FSIZE")
        allowed = "" if most is None else f"{needs}a file may have {in_bytes(most)} here (ulimit -f)"
        missing = "" if most is None else _missing(needed, most)
        return f"{path}: cannot be written ({reason}): {allowed or 'expected a higher limit'}{missing}"
    free = free_bytes(path)
    room = f"{needs}{in_bytes(free)} free{_missing(needed, free)}"
    return f"{path}: cannot be written ({reason}): {room}; expected more room"


def _missing(needed: int | None, there: int) -> str:
    return "" if needed is None or needed <= there else f", {in_bytes(needed - there)} missing"


def line_of(error: BaseException) -> str | None:
    """Return an error that the machine caused as a line; None of one that it did not."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return _memory_line(error.strerror or "" if isinstance(error, OSError) else str(error))
    if isinstance(error, OSError) and error.errno is not None:
        if error.filename is None:  # of a stream, which knows no name
            return f"an output cannot be written ({error.strerror}); expected room for it"
        where = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else str(error.filename)
        return disk_line(Path(where), error) if error.errno in _FULL else f"{where}: {error.strerror}"
    if isinstance(error, (ImportError, RuntimeError, SystemError)) and _NO_MEMORY.search(str(error)):
        return _memory_line(str(error))
    return None


def in_bytes(count: float) -> str:
    """Return a number of bytes in words, such as 3.4 MB."""
    for power, unit in ((9, "GB"), (6, "MB"), (3, "kB")):
        if count >= 10**power:
            return f"{count / 10**power:.3g} {unit}"
    return f"{count:.0f} bytes"


def _memory_line(reason: str) -> str:
    most, available = _limit("RLIMIT_AS"), _available()
    if most is not None:
        has = f": this process may have {in_bytes(most)} (ulimit -v)"
    else:
        has = "" if available is None else f": {in_bytes(available)} available"
    return (
        f"memory is short ({reason or 'an allocation failed'}){has}; expected more memory, or less to do: fewer "
        "frames, a coarser --grid"
    )


def free_bytes(path: Path) -> int:
    """Return the bytes free for the file system of the nearest folder above `path` that is there."""
    above = next((folder for folder in path.resolve().parents if folder.is_dir()), Path("/"))
    with suppress(OSError):
        return shutil.disk_usage(above).free
    return 0


def _limit(name: str) -> int | None:
    """Return a limit of this process in bytes; None where there is none."""
    try:
        import resource
    except ModuleNotFoundError:  # not on Windows
        return None
    most = resource.getrlimit(getattr(resource, name))[0]
    return None if most == resource.RLIM_INFINITY else most


def _available() -> int | None:
    """Return the bytes of memory that a program can still have; None where the system does not say."""
    with suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("MemAvailable")).split()[1])
    with suppress(ValueError, OSError, AttributeError):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def ensure_cache_folder() -> None:
    """Put a temporary folder in place of the user's cache folder, for this process and those that it starts, where that
    cannot be written; say so in one line. It stays, so that the next run need not compile anew."""
    if sys.platform != "linux":
        return
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME", "")) / ".cache")
    there = [cache, *(folder for folder in (cache / "taichi", cache / "taichi" / "ticache") if folder.exists())]
    if cache.is_absolute() and all(map(is_writable, there)):
        return
    folder = temporary_folder()
    os.environ["XDG_CACHE_HOME"] = str(folder)
    os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))
    note(f"{cache}: cannot be written; {folder} takes its place (XDG_CACHE_HOME sets another)")


def require_writable(variable: str) -> None:
    """Raise InputError where the folder that an environment variable names cannot be written."""
    given = os.environ.get(variable)
    if given and not is_writable(Path(given)):
        raise InputError(f"{variable} is {given!r}: cannot be written; expected another folder")


def remove_stale_lock(folder: Path) -> None:
    """Remove the lock of a folder of Taichi's that a killed process has left: Taichi, which holds it for moments, would
    keep nothing there any more."""
    lock = folder / "ticache.lock"
    with suppress(OSError):
        if time.time() - lock.stat().st_mtime > _STALE:
            lock.unlink()


def is_writable(folder: Path) -> bool:
    """Return whether files can be written in the folder, which is made where it is not there, and hold something."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_ROOM))
        return True
    except OSError as error:
        return error.errno == errno.EFBIG  # a limit that holds in any folder


def temporary_folder() -> Path:
    """Return the user's own one: others must not put kernels there that this user then runs."""
    try:
        folder = Path(tempfile.gettempdir()) / f"fabdesign-cache-{os.getuid()}"
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        state = folder.lstat()
        private = stat.S_ISDIR(state.st_mode) and stat.S_IMODE(state.st_mode) == 0o700 and state.st_uid == os.getuid()
        return folder if private else Path(tempfile.mkdtemp(prefix="fabdesign-cache-"))
    except OSError as error:
        raise InputError(f"no folder for temporary files can be written ({error.strerror}); TMPDIR names one") from None

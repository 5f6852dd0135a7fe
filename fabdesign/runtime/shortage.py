"""Messages for where the machine has too little of something: disk, memory, or what its limits allow.

`fabdesign/output` says it of what it writes, the command line of all else (`line_of`).
"""

import errno
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_BROKEN = (errno.EIO, errno.EROFS)
# what others raise where they get no memory: the loader, Taichi, LLVM
_NO_MEMORY = re.compile(r"memory allocation|cannot allocate memory|failed to map segment|out of memory|bad_alloc", re.I)


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

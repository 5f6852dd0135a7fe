"""A folder for what Taichi, Numba and Matplotlib compile and keep, where the user's own cannot be written, or is full.

Homes are read-only in containers, and on clusters that run jobs for others. Taichi then ends with a segmentation fault,
Numba with an error. All three take the place from XDG_CACHE_HOME, Matplotlib its settings from MPLCONFIGDIR.
"""

import errno
import os
import stat
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from fabdesign.errors import InputError, note

_STALE = 60.0  # s
_ROOM = 1_000_000  # bytes: Matplotlib's list of fonts has some 100 kB


def ensure_cache_folder() -> None:
    """Put a temporary folder in place of the user's cache folder, for this process and those that it starts, where that
    cannot be written; say so in one line. It stays, so that the next run need not compile anew."""
    if sys.platform != "linux":
        return
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME", "")) / ".cache")
    there = [cache, *(folder for folder in (cache / "taichi", cache / "taichi" / "ticache") if folder.exists())]
    if cache.is_absolute() and all(map(_is_writable, there)):
        return
    folder = _temporary()
    os.environ["XDG_CACHE_HOME"] = str(folder)
    os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))
    note(f"{cache}: cannot be written; {folder} takes its place (XDG_CACHE_HOME sets another)")


def require_writable(variable: str) -> None:
    """Raise InputError where the folder that an environment variable names cannot be written."""
    given = os.environ.get(variable)
    if given and not _is_writable(Path(given)):
        raise InputError(f"{variable} is {given!r}: cannot be written; expected another folder")


def remove_stale_lock(folder: Path) -> None:
    """Remove the lock of a folder of Taichi's that a killed process has left: Taichi, which holds it for moments, would
    keep nothing there any more."""
    lock = folder / "ticache.lock"
    with suppress(OSError):
        if time.time() - lock.stat().st_mtime > _STALE:
            lock.unlink()


def _is_writable(folder: Path) -> bool:
    """Return whether files can be written in the folder, which is made where it is not there, and hold something."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_ROOM))
        return True
    except OSError as error:
        return error.errno == errno.EFBIG  # a limit that holds in any folder


def _temporary() -> Path:
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

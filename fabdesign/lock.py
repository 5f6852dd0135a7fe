"""A file that one process holds at a time, and no longer than it lives."""

import errno
import sys
from typing import IO

if sys.platform == "win32":
    import msvcrt

    def try_lock(stream: IO[bytes]) -> bool | None:
        """Whether `stream`'s file is now this process's, until it closes the stream or ends; None where the file system
        knows no locks."""
        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    _NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)

    def try_lock(stream: IO[bytes]) -> bool | None:
        """Whether `stream`'s file is now this process's, until it closes the stream or ends; None where the file system
        knows no locks."""
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno in _NO_LOCKS:
                return None
            raise
        return True

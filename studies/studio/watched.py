"""The design's file, which another program may change meanwhile."""

from pathlib import Path

from fabdesign.design import Design
from fabdesign.design_file import read_design
from studies.studio.autosave import content_hash


class Watched:
    """Notices when a file's content becomes another, once for each change. A file that goes, or was never there, is no
    change."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.seen()

    def seen(self) -> None:
        """What is there now is known."""
        self._hash, self._stamp = content_hash(self._file), self._stamped()

    def changed(self) -> bool:
        stamp = self._stamped()
        if stamp == self._stamp:
            return False
        before = self._hash
        self.seen()
        return self._hash is not None and self._hash != before

    def read(self) -> Design:
        """Raises InputError."""
        self.seen()
        return read_design(self._file)

    def _stamped(self) -> tuple[int, int] | None:
        try:
            status = self._file.stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_size

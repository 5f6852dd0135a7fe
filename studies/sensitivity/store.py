"""The samples of a sweep on disk: what is computed stays, whatever ends the process."""

import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fabdesign.checkpoint import OtherContent, require_same
from fabdesign.errors import InputError

Array = NDArray[np.float64]
FILE = "samples.sqlite"
_SCHEMA = """
create table if not exists content (field text primary key, value text);
create table if not exists samples (part text, number integer, numbers blob, primary key (part, number));
create table if not exists spent (id integer primary key check (id = 0), wall real, cpu real);
insert or ignore into spent values (0, 0, 0);
"""


class Store:
    """A SQLite file of one study's samples, by part (a method's design) and number in it.

    content: what the samples depend on, by field. Raises OtherContent, which says what differs, where the file is that
    of another study.
    """

    def __init__(self, path: Path, content: Mapping[str, str]) -> None:
        try:
            self._file = sqlite3.connect(path)
            self._file.execute("pragma journal_mode = wal")
            self._file.executescript(_SCHEMA)
            known = dict(self._file.execute("select field, value from content").fetchall())
            if known:
                require_same(known, content, path.parent, "another study")
            with self._file:
                self._file.executemany("insert or replace into content values (?, ?)", content.items())
        except OtherContent:
            self._file.close()
            raise
        except (OSError, sqlite3.Error) as error:
            raise InputError(f"{path}: cannot be written ({error})") from None

    def samples(self, part: str) -> dict[int, Array]:
        """Numbers of each sample that is there."""
        rows = self._file.execute("select number, numbers from samples where part = ?", (part,))
        return {number: np.frombuffer(numbers) for number, numbers in rows}

    def add(self, part: str, numbers: Sequence[int], values: Sequence[Array], *, wall: float, cpu: float) -> None:
        """Add samples, and the seconds that they took."""
        rows = [(part, int(n), np.asarray(v, float).tobytes()) for n, v in zip(numbers, values, strict=True)]
        with self._file:
            self._file.executemany("insert or replace into samples values (?, ?, ?)", rows)
            self._file.execute("update spent set wall = wall + ?, cpu = cpu + ?", (wall, cpu))

    @property
    def spent(self) -> tuple[float, float]:
        """s by the clock and of the processor, all sessions together."""
        wall, cpu = self._file.execute("select wall, cpu from spent").fetchone()
        return float(wall), float(cpu)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

"""The samples of a sweep on disk: what is computed stays, whatever ends the process."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import note
from fabdesign.kept_database import open_database, writing

Array = NDArray[np.float64]
FILE = "samples.sqlite"
_SCHEMA = """
create table if not exists samples (part text, number integer, numbers blob, primary key (part, number));
create table if not exists spent (id integer primary key check (id = 0), wall real, cpu real);
insert or ignore into spent values (0, 0, 0);
"""
_DROP_DAMAGED = "delete from samples where typeof(numbers) <> 'blob' or length(numbers) = 0 or length(numbers) % 8 <> 0"


class Store:
    """A SQLite file of one study's samples, by part (a method's design) and number in it.

    content: what the samples depend on, by field. Raises OtherContent, which says what differs, where the file is that
    of another study.
    """

    def __init__(self, path: Path, content: Mapping[str, str]) -> None:
        self._path, self._file = path, open_database(path, _SCHEMA, content, "another study")
        with writing(path), self._file:
            dropped = self._file.execute(_DROP_DAMAGED).rowcount
        if dropped:
            note(f"{path}: {dropped} samples are damaged; they are computed again")

    def samples(self, part: str) -> dict[int, Array]:
        """Numbers of each sample that is there."""
        rows = self._file.execute("select number, numbers from samples where part = ?", (part,))
        return {number: np.frombuffer(numbers) for number, numbers in rows}

    def add(self, part: str, numbers: Sequence[int], values: Sequence[Array], *, wall: float, cpu: float) -> None:
        """Add samples, and the seconds that they took."""
        rows = [(part, int(n), np.asarray(v, float).tobytes()) for n, v in zip(numbers, values, strict=True)]
        with writing(self._path), self._file:
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

"""What a search has evaluated, and where it stands, on disk: an interrupted search goes on from its last round."""

import json
import sqlite3
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fabdesign.checkpoint import require_same

_SCHEMA = """
create table if not exists content (field text primary key, value text);
create table if not exists evaluations
    (number integer primary key, seconds real, stage text, objective real, diverged integer, x text);
create table if not exists checkpoint
    (id integer primary key check (id = 0), evaluations integer, seconds real, state text);
create table if not exists answer (id integer primary key check (id = 0), evaluations integer, value text);
"""


@dataclass(frozen=True)
class Entry:
    """One evaluation: after `seconds` of search, `objective` in m (a penalty where it diverged)."""

    seconds: float
    stage: str
    objective: float
    diverged: bool
    x: tuple[float, ...]


class History:
    """A SQLite file of one study's evaluations. `study`: its name, or what its search depends on, by field.

    Raises OtherContent, which says what differs, where the file is that of another study; nothing in it changes.
    Opening drops what came after the last checkpoint, so that a search resumed there repeats it identically.
    """

    def __init__(self, path: Path | str, study: Mapping[str, str] | str) -> None:
        self._path = path
        self._file = sqlite3.connect(path)
        try:
            self._open({"study": study} if isinstance(study, str) else study)
        except BaseException:
            self._file.close()
            raise

    def _open(self, study: Mapping[str, str]) -> None:
        self._file.execute("pragma journal_mode = wal")
        self._file.executescript(_SCHEMA)
        known = dict(self._file.execute("select field, value from content").fetchall())
        if known:
            require_same(known, study, Path(self._path).parent, "the search of another study")
        self._file.executemany("insert or replace into content values (?, ?)", study.items())
        kept = self._file.execute("select evaluations, seconds from checkpoint").fetchone() or (0, 0.0)
        self._file.execute("delete from evaluations where number > ?", kept[:1])
        self._file.commit()
        self.evaluations: int = kept[0]
        self.seconds: float = kept[1]

    def add(self, entries: Iterable[Entry]) -> None:
        rows = []
        for entry in entries:
            self.evaluations += 1
            self.seconds = entry.seconds
            x = json.dumps(entry.x)
            rows.append((self.evaluations, entry.seconds, entry.stage, entry.objective, entry.diverged, x))
        with self._file:
            self._file.executemany("insert into evaluations values (?, ?, ?, ?, ?, ?)", rows)

    def entries(self) -> list[Entry]:
        rows = self._file.execute("select seconds, stage, objective, diverged, x from evaluations order by number")
        return [Entry(s, stage, f, bool(d), tuple(json.loads(x))) for s, stage, f, d, x in rows]

    @property
    def worst(self) -> float:
        """Largest objective [m] seen; 0 before the first."""
        return float(self._file.execute("select max(objective) from evaluations").fetchone()[0] or 0.0)

    def save(self, state: Any, seconds: float) -> None:
        """Checkpoint: a state that JSON holds exactly."""
        with self._file:
            self._file.execute(
                "insert or replace into checkpoint values (0, ?, ?, ?)", (self.evaluations, seconds, json.dumps(state))
            )

    def load(self) -> Any:
        """The last checkpoint's state; None where there is none."""
        row = self._file.execute("select state from checkpoint").fetchone()
        return json.loads(row[0]) if row else None

    def keep_answer(self, value: Any) -> None:
        """Keep what the search came to: what JSON can hold."""
        with self._file:
            self._file.execute("insert or replace into answer values (0, ?, ?)", (self.evaluations, json.dumps(value)))

    def answer(self) -> Any:
        """What was kept of the search as it stands; None where nothing was."""
        row = self._file.execute("select evaluations, value from answer").fetchone()
        return json.loads(row[1]) if row and row[0] == self.evaluations else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if error is not None and not self.evaluations and isinstance(self._path, Path):
            self._path.unlink(missing_ok=True)  # nothing to go on from

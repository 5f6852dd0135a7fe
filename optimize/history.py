"""What a search has evaluated, and where it stands, on disk: an interrupted search goes on from its last round."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fabdesign.errors import note
from fabdesign.kept_database import open_database, writing

_SCHEMA = """
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
        content = {"study": study} if isinstance(study, str) else study
        self._file = open_database(path, _SCHEMA, content, "the search of another study")
        row = self._file.execute("select evaluations, seconds, state from checkpoint").fetchone()
        sound = row is None or self._sound(*row)
        if not sound:
            note(f"{path}: its checkpoint is damaged; the search begins anew")
        self.evaluations: int = row[0] if row and sound else 0
        self.seconds: float = row[1] if row and isinstance(row[1], float) else 0.0
        with writing(path), self._file:
            if not sound:
                self._file.execute("delete from checkpoint")
            self._file.execute("delete from evaluations where number > ?", (self.evaluations,))

    def _sound(self, evaluations: object, seconds: object, state: Any) -> bool:
        """Return whether a checkpoint and the evaluations before it can be read."""
        valid = "select count(*) from evaluations where number <= ? and json_valid(x)"
        if not isinstance(evaluations, int) or not isinstance(seconds, float):
            return False
        try:
            json.loads(state)
        except (TypeError, ValueError):
            return False
        return bool(self._file.execute(valid, (evaluations,)).fetchone()[0] == evaluations)

    def add(self, entries: Iterable[Entry]) -> None:
        rows = []
        for entry in entries:
            self.evaluations += 1
            self.seconds = entry.seconds
            x = json.dumps(entry.x)
            rows.append((self.evaluations, entry.seconds, entry.stage, entry.objective, entry.diverged, x))
        with writing(self._path), self._file:
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
        with writing(self._path), self._file:
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
        """Return what was kept of the search as it stands; None where nothing was."""
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

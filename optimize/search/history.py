"""The history of a search on disk, its evaluations and where it stands: an interrupted search goes on from its last
round."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fabdesign.errors import note
from fabdesign.runtime.store import Database


@dataclass(frozen=True)
class Entry:
    """One evaluation: after `seconds` of search, `objective` in m (a penalty where it diverged)."""

    seconds: float
    stage: str
    objective: float
    diverged: bool
    x: tuple[float, ...]


class History(Database):
    """A SQLite file of one study's evaluations. `study`: its name, or what its search depends on, by field.

    Raises OtherContent, which says what differs, where the file is that of another study; nothing in it changes.
    Opening drops what came after the last checkpoint, so that a search resumed there repeats it identically.
    """

    schema = """
create table if not exists evaluations
    (number integer primary key, seconds real, stage text, objective real, diverged integer, x text);
create table if not exists checkpoint
    (id integer primary key check (id = 0), evaluations integer, seconds real, state text);
create table if not exists answer (id integer primary key check (id = 0), evaluations integer, value text);
"""
    holds = "the search of another study"

    def __init__(self, path: Path | str, study: Mapping[str, str] | str) -> None:
        super().__init__(path, {"study": study} if isinstance(study, str) else study)
        [(evaluations, seconds, state)] = self.rows("select evaluations, seconds, state from checkpoint") or [
            (0, 0.0, "0")
        ]
        sound = self._sound(evaluations, seconds, state)
        if not sound:
            note(f"{path}: its checkpoint is damaged; the search begins anew")
        self.evaluations: int = evaluations if sound else 0
        self.seconds = seconds if isinstance(seconds, float) else 0.0
        with self.writing() as file:
            if not sound:
                file.execute("delete from checkpoint")
            file.execute("delete from evaluations where number > ?", (self.evaluations,))

    def _sound(self, evaluations: object, seconds: object, state: Any) -> bool:
        """Return whether a checkpoint and the evaluations before it can be read."""
        valid = "select count(*) from evaluations where number <= ? and json_valid(x)"
        try:
            json.loads(state)
        except (TypeError, ValueError):
            return False
        numbers = isinstance(evaluations, int) and isinstance(seconds, float)
        return numbers and self.rows(valid, evaluations) == [(evaluations,)]

    def add(self, entries: Iterable[Entry]) -> None:
        rows = []
        for entry in entries:
            self.evaluations += 1
            self.seconds = entry.seconds
            x = json.dumps(entry.x)
            rows.append((self.evaluations, entry.seconds, entry.stage, entry.objective, entry.diverged, x))
        with self.writing() as file:
            file.executemany("insert into evaluations values (?, ?, ?, ?, ?, ?)", rows)

    def entries(self) -> list[Entry]:
        rows = self.rows("select seconds, stage, objective, diverged, x from evaluations order by number")
        return [Entry(s, stage, f, bool(d), tuple(json.loads(x))) for s, stage, f, d, x in rows]

    @property
    def worst(self) -> float:
        """Return the largest objective [m] seen; 0 before the first."""
        return float(self.rows("select max(objective) from evaluations")[0][0] or 0.0)

    def save(self, state: Any, seconds: float) -> None:
        """Save a checkpoint: a state that JSON holds exactly."""
        row = (self.evaluations, seconds, json.dumps(state))
        with self.writing() as file:
            file.execute("insert or replace into checkpoint values (0, ?, ?, ?)", row)

    def load(self) -> Any:
        """Return the last checkpoint's state; None where there is none."""
        rows = self.rows("select state from checkpoint")
        return json.loads(rows[0][0]) if rows else None

    def keep_answer(self, value: Any) -> None:
        """Keep what the search came to: what JSON can hold."""
        with self.writing() as file:
            file.execute("insert or replace into answer values (0, ?, ?)", (self.evaluations, json.dumps(value)))

    def answer(self) -> Any:
        """Return what was kept of the search as it stands; None where nothing was."""
        rows = self.rows("select value from answer where evaluations = ?", self.evaluations)
        return json.loads(rows[0][0]) if rows else None

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        super().__exit__(kind, error, trace)
        if error is not None and not self.evaluations:
            self._path.unlink(missing_ok=True)  # nothing to go on from

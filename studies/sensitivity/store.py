"""The samples of a sweep on disk: what is computed stays, whatever ends the process; and what they depend on."""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import note
from fabdesign.runtime.fingerprint import content_of, sha256
from fabdesign.runtime.store import Database
from fabdesign.study_files.sensitivity_file import Output, SensitivityStudy
from fabdesign.version import SIMULATOR

Array = NDArray[np.float64]
FILE = "samples.sqlite"
ALGORITHM = 1  # of what samples hold: raised where kept ones are no longer what this code would compute
_RAISED = ("name", "methods", "samples", "trajectories", "seconds")  # what may grow, or changes no sample
_DROP_DAMAGED = "delete from samples where typeof(numbers) <> 'blob' or length(numbers) = 0 or length(numbers) % 8 <> 0"


class Samples(Database):
    """A SQLite file of one study's samples, by part (a method's design) and number in it."""

    schema = """
create table if not exists samples (part text, number integer, numbers blob, primary key (part, number));
create table if not exists spent (id integer primary key check (id = 0), wall real, cpu real);
insert or ignore into spent values (0, 0, 0);
"""
    holds = "another study"

    def __init__(self, path: Path | str, content: Mapping[str, str]) -> None:
        super().__init__(path, content)
        with self.writing() as file:
            dropped = file.execute(_DROP_DAMAGED).rowcount
        if dropped:
            note(f"{path}: {dropped} samples are damaged; they are computed again")

    def of(self, part: str) -> dict[int, Array]:
        """Return the numbers of each sample that is there."""
        rows = self.rows("select number, numbers from samples where part = ?", part)
        return {number: np.frombuffer(numbers) for number, numbers in rows}

    def add(self, part: str, values: Mapping[int, Array], *, wall: float, cpu: float) -> None:
        """Add samples, and the seconds that they took."""
        rows = [(part, int(n), np.asarray(v, float).tobytes()) for n, v in values.items()]
        with self.writing() as file:
            file.executemany("insert or replace into samples values (?, ?, ?)", rows)
            file.execute("update spent set wall = wall + ?, cpu = cpu + ?", (wall, cpu))

    @property
    def spent(self) -> tuple[float, float]:
        """s by the clock and of the processor, all sessions together."""
        [(wall, cpu)] = self.rows("select wall, cpu from spent")
        return float(wall), float(cpu)


def sweep_content(study: SensitivityStudy, target: Array | None) -> dict[str, str]:
    """Return what the samples depend on, by field."""
    more: dict[str, Any] = {f"functions.{name}": _text_of(function) for name, function in study.functions.items()}
    if target is not None:
        more["target.points"] = sha256(target)
    if study.target is not None and study.target.weighting is not None:
        more["target.regions"] = repr(study.target.weighting.regions)
    content = content_of(study, (*_RAISED, "target", "functions"), more)
    return {"simulator": str(SIMULATOR), "algorithm": str(ALGORITHM)} | content


def _text_of(function: Output) -> str:
    """Return that by which a function is known again in another session: what it does, not where it lies."""

    def content(code: Any) -> list[Any]:
        inner = [content(c) if hasattr(c, "co_code") else repr(c) for c in code.co_consts]
        return [code.co_code.hex(), code.co_names, inner]

    code = getattr(inspect.unwrap(function), "__code__", None)
    return repr(type(function)) if code is None else sha256(repr(content(code)))

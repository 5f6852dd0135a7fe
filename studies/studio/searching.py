"""A search from the layout as it stands: `optimize` in a process of its own, its best so far read as it comes."""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tomlkit

from fabdesign.design_file import read_design, write_design
from fabdesign.encoder import Encoder
from fabdesign.errors import InputError
from fabdesign.json_file import read_json
from fabdesign.output import new_folder
from fabdesign.pressure_file import pressure_file_of, read_pressures
from fabdesign.study_targets import TargetFile
from fabdesign.units import from_mm, in_kpa
from optimize.margins import Limits
from studies.studio.layout import Layout
from studies.studio.target import ShownTarget

Vary = Literal["pressures", "pressures and positions", "one more muscle"]
VARIES: tuple[Vary, ...] = ("pressures", "pressures and positions", "one more muscle")
PROGRAM = (sys.executable, "-m", "fabdesign")
_STOPPED = 30.0  # s that a search has to end with its best


@dataclass(frozen=True)
class SearchResult:
    """The best so far, or at the end the result. layouts: one for each pose. objective: m."""

    layouts: tuple[Layout, ...]
    objective: float
    evaluations: int
    stop_reason: str


def study_document(
    layout: Layout,
    targets: Sequence[ShownTarget],
    limits: Limits,
    *,
    vary: Vary,
    seconds: float,
    model: Path | None,
    beside: Path,
) -> str:
    """The study as text, whose `design.toml` lies in the folder `beside` with it. targets: poses of one layout."""
    document = tomlkit.document()
    document["format"] = "fabdesign.study/1"
    document["kind"] = "optimize"
    document["design"] = "design.toml"
    if model is not None:
        document["model"] = _relative(model, beside)
    document["start_pressures"] = [in_kpa(pressure) for pressure in layout.pressures]
    placed = [_placed(target.file, beside) for target in targets]
    if len(placed) == 1:
        document["target"] = placed[0]
    else:
        poses = document["targets"] = tomlkit.aot()
        for pose in placed:
            poses.append(tomlkit.item(pose))
    document["variables"] = _variables(layout, vary)
    document["limits"] = {
        "pressure": [in_kpa(pressure) for pressure in limits.pressure],
        "spacing": limits.spacing,
        "edge": limits.edge,
        "seconds": float(seconds),
    }
    return tomlkit.dumps(document)


def _placed(file: TargetFile, beside: Path) -> dict[str, Any]:
    """Return the table of a target, without regions and wishes, which the page does not show."""
    plain = replace(file, weighting=None, wishes=())
    table: dict[str, Any] = Encoder(beside / "study.toml", brief=True).encode(plain)
    return table


def _variables(layout: Layout, vary: Vary) -> dict[str, Any]:
    if vary == "one more muscle":
        more = len(layout.design.muscles) + 1
        return {"pressures": True, "positions": True, "muscles": {"min": more, "max": more}}
    return {"pressures": True, "positions": vary == "pressures and positions"}


def _relative(path: Path, beside: Path) -> str:
    return os.path.relpath(path.resolve(), beside.resolve()).replace(os.sep, "/")


class Search:
    """One search in `folder`: `study.toml` and `design.toml`, and `result/` as `optimize` leaves it."""

    def __init__(
        self,
        folder: Path,
        layout: Layout,
        targets: Sequence[ShownTarget],
        limits: Limits,
        *,
        vary: Vary,
        seconds: float,
        model: Path | None = None,
    ) -> None:
        """Raises InputError where the folder is there already, or cannot be written."""
        self.folder, self._poses, self._stopped = folder, len(targets), False
        self._seen: dict[str, Any] = {}
        with new_folder(folder, made_by="studio") as unfinished:
            write_design(layout.design, unfinished / "design.toml")
            text = study_document(layout, targets, limits, vary=vary, seconds=seconds, model=model, beside=folder)
            (unfinished / "study.toml").write_text(text, encoding="utf-8", newline="\n")
        command = [*PROGRAM, "optimize", str(folder / "study.toml"), "-o", str(self.result)]
        self._process = subprocess.Popen(
            [*command, "--json"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=os.name != "nt",  # Ctrl-C is for the studio, which then stops the search
        )

    @property
    def result(self) -> Path:
        return self.folder / "result"

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def best(self) -> SearchResult | None:
        """The best so far, when it is another than the last time; at the end the result."""
        try:
            content = read_json(self.result / "result.json")
            if content == self._seen:
                return None
            design = read_design(self.result / "design.toml")
            files = [self.result / pressure_file_of(pose) for pose in range(1, self._poses + 1)]
            rows = [read_pressures(file, design).pressure[-1] for file in files]
        except (OSError, ValueError):  # it is being replaced at this moment
            return None
        self._seen = content
        layouts = tuple(Layout.of(design, tuple(map(float, row))) for row in rows)
        return SearchResult(
            layouts,
            from_mm(float(content["objective_mm"])),
            int(content["evaluations"]),
            str(content.get("stop_reason", "")),
        )

    def stop(self) -> None:
        """Ask it to end with the best so far, which lies in `result` whatever it was about when it was asked."""
        if self.running:
            self._stopped = True
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """It ends now, and leaves a result where it had one."""
        self.stop()
        try:
            self._process.wait(_STOPPED)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stderr is not None:
            self._process.stderr.close()

    @property
    def problem(self) -> str | None:
        """Why it ended without a result, in a line; None while it runs, and where it ended well or was stopped."""
        if self.running or self._process.returncode == 0 or self._process.stderr is None:
            return None
        if self._process.stderr.closed or (self._stopped and (self.result / "result.json").is_file()):
            return None
        lines = [line for line in self._process.stderr.read().splitlines() if line.strip()]
        return lines[-1] if lines else f"the search ended with code {self._process.returncode}"


def next_folder(beside: Path) -> Path:
    """`beside`_search_1, or the first number that is free."""
    number = 1
    while (folder := beside.with_name(f"{beside.name}_search_{number}")).exists():
        number += 1
    return folder


def require_searchable(layout: Layout, vary: Vary) -> None:
    """Raise InputError where there is nothing to search."""
    if not layout.design.muscles and vary != "one more muscle":
        raise InputError(f"{layout.design.name}: has no muscles; expected some, or one more muscle to search for")

"""A search from the layout as it stands: `optimize` in a process of its own, its best so far read as it comes."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import tomlkit

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.formats.codec import Encoder
from fabdesign.formats.json_file import read_json
from fabdesign.formats.table import STUDY
from fabdesign.output import new_folder, write_text
from fabdesign.study_files.study_file import result_in
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.units import from_mm, in_kpa, in_mm
from optimize.search.margins import Limits
from studies.layout_search.target import LoadedTarget
from studies.studio.document import Document
from studies.studio.drawings import Result
from studies.studio.layout import Layout
from studies.studio.opening import search_limits

Vary = Literal["pressures", "pressures and positions", "one more muscle"]
VARIES: tuple[Vary, ...] = get_args(Vary)
PROGRAM = (sys.executable, "-m", "fabdesign")
_STOPPED = 30.0  # s that a search has to end with its best


def study_document(
    layout: Layout,
    targets: Sequence[LoadedTarget],
    limits: Limits,
    *,
    vary: Vary,
    seconds: float,
    model: Path | None = None,
    beside: Path,
) -> str:
    """Return the study as text, whose `design.toml` lies in the folder `beside` with it. targets: poses of one
    layout."""
    encoder = Encoder(beside.resolve() / "study.toml")
    placed = [_placed(target.file, encoder) for target in targets]
    count = len(layout.design.muscles) + 1
    variables: dict[str, Any] = {"pressures": True, "positions": vary != "pressures"}
    if vary == "one more muscle":
        variables["muscles"] = {"min": count, "max": count}
    document = {
        "format": STUDY,
        "kind": "optimize",
        "design": "design.toml",
        **({} if model is None else {"model": Path(os.path.relpath(model.resolve(), beside.resolve())).as_posix()}),
        "start_pressures": [in_kpa(pressure) for pressure in layout.pressures],
        **({"target": placed[0]} if len(placed) == 1 else {"targets": placed}),
        "variables": variables,
        "limits": encoder.encode(replace(limits, seconds=float(seconds))),
    }
    return tomlkit.dumps(document)


def _placed(target: TargetFile, encoder: Encoder) -> dict[str, Any]:
    """Return what a study says of a target: what is not so by default, and no objects, which its file alone can say."""
    bare = replace(target, file=target.file.resolve(), weighting=None, wishes=())
    if target.place == "fit":
        bare = replace(bare, translation=(0.0, 0.0, 0.0))  # the fit finds it
    keys, usual = encoder.encode(bare), encoder.encode(TargetFile(bare.file))
    return {key: value for key, value in keys.items() if key in ("file", "frame", "unit") or value != usual.get(key)}


class Search(Result):
    """A result that `optimize` searches for in `folder`, which has `study.toml` and `design.toml`, and `result/` as
    `optimize` leaves it."""

    def __init__(
        self, folder: Path, layout: Layout, targets: Sequence[LoadedTarget], limits: Limits, **study: Any
    ) -> None:
        """Begin from a layout. study: more of what `study_document` takes. Raises InputError where the folder is there
        already, or cannot be written."""
        super().__init__(state="searching")
        self.folder, self._result = folder, folder / "result"
        self._poses, self._stopped = len(targets), False
        self._content: dict[str, Any] = {}
        with new_folder(folder, made_by="studio") as unfinished:
            write_design(layout.design, unfinished / "design.toml")
            write_text(unfinished / "study.toml", study_document(layout, targets, limits, **study, beside=folder))
        self._process = subprocess.Popen(
            [*PROGRAM, "optimize", str(folder / "study.toml"), "-o", str(self._result), "--json"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=os.name != "nt",  # Ctrl-C is for the studio, which then stops the search
        )

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def read(self) -> bool:
        """Take in the best so far, at the end the result. Return whether it is another than the last time."""
        try:
            content = read_json(self._result / "result.json")
            if content == self._content:
                return False
            best = result_in(self._result)
        except (OSError, ValueError):  # it is being replaced at this moment
            return False
        if len(best.pressures) < self._poses:  # so it is
            return False
        self._content = content
        objective, of = from_mm(float(content["objective_mm"])), f", mean of {self._poses} poses,"
        self.hold(tuple(Layout.of(best.design, tuple(map(float, row))) for row in best.pressures), objective)
        figure = f"{in_mm(objective):.2f} mm{of if self._poses > 1 else ''} after {content['evaluations']} evaluations"
        self.state = f"{figure}; {content.get('stop_reason', '')}"
        return True

    def stop(self) -> None:
        """Ask it to end with the best so far, which lies in `result` whatever it was about when it was asked."""
        if self.running:
            self._stopped = True
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Have it end now, and leave a result where it had one."""
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
        """Return why it ended without a result; None while it runs, and where it ended well or was stopped."""
        if self.running or self._process.returncode == 0 or self._process.stderr is None:
            return None
        if self._process.stderr.closed or (self._stopped and (self._result / "result.json").is_file()):
            return None
        lines = [line for line in self._process.stderr.read().splitlines() if line.strip()]
        return lines[-1] if lines else f"the search ended with code {self._process.returncode}"


class BackgroundSearch:
    """A search in the background, at most one at a time, in a folder beside the one that `save_folder` gives. message:
    how it goes."""

    def __init__(self, document: Document, save_folder: Callable[[], Path]) -> None:
        self._document, self._save_folder = document, save_folder
        self._search: Search | None = None
        self.message = ""

    @property
    def running(self) -> bool:
        return self._search is not None

    def start(self, vary: Vary, seconds: float) -> None:
        """Search; the result is a drawing of its own."""
        document = self._document
        if self.running:
            raise InputError("a search is running")
        if not document.targets:
            raise InputError("no target; expected one to search for")
        design = document.layout.design
        if not design.muscles and vary != "one more muscle":
            raise InputError(f"{design.name}: has no muscles; expected some, or one more muscle to search for")
        document.history.end()
        limits = document.limits if document.opened.targets else search_limits(design)
        number, beside = 1, self._save_folder()
        while (folder := beside.with_name(f"{beside.name}_search_{number}")).exists():
            number += 1
        options = {"vary": vary, "seconds": seconds, "model": document.model_file}
        self._search = search = Search(folder, document.layout, document.targets, limits, **options)
        search.name, search.layouts = f"search {number}: {vary}", document.layouts
        search.begun = search.layouts[0]
        self.message = f"searching in {folder.name}, the first evaluations"
        document.results.append(search)
        document.show_result(search)

    def stop(self) -> None:
        """Have it end; the best so far stays."""
        if self._search is not None:
            self._search.stop()
            self.message = "stopping, with the best so far"
            self._document.show()

    def follow(self) -> None:
        """Read its best so far, and whether it has ended."""
        if (search := self._search) is None:
            return
        document, running = self._document, search.running  # before the result is read: the last is not missed
        if search.read():
            self.message = search.state
            (document.changed if document.shown is search else document.show)()
        if running:
            return
        problem, self._search = search.problem, None
        search.close()
        self.message = problem or f"kept in {search.folder / 'result'}"
        if problem:
            search.state = problem
            document.tell(problem, bad=True)
        document.show()

    def close(self) -> None:
        """Have it end with its best."""
        if self._search is not None:
            self._search.close()

"""The live line of a search, on standard error."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from fabdesign.units import in_mm
from optimize.search.evaluations import Evaluations
from optimize.search.objective import Poses

TENTH = 0.1  # of its limits, after which a search says how far it is
QUIET_INTERVAL = 10.0  # s between lines where standard error is no terminal


def saying_a_tenth(
    floor: Callable[[Poses], float], progress: Callable[[Evaluations], None]
) -> Callable[[Evaluations], None]:
    """Return the progress of a search that also tells, after a tenth of its limits, how far it is. floor: m, of a
    shape."""

    def report(evaluations: Evaluations) -> None:
        best, shape = evaluations.best, evaluations.best_shape
        if not evaluations.told and evaluations.share >= TENTH and best is not None and shape is not None:
            least = floor(shape)
            over = f", {best.value / least:.2f} times the noise floor" if least > 0 else ""
            evaluations.told = (
                f"after a tenth of its time {in_mm(best.value):.2f} mm{over}, in stage {evaluations.stage}"
            )
        progress(evaluations)

    return report


class LiveLine:
    """A context that shows `stage, best, evaluations, seconds` while a search calls `show`: on a terminal beside a bar
    and the seconds that are left at most."""

    def __init__(self, title: str) -> None:
        self._title, self._console = title, Console(stderr=True)
        columns = TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.fields[left]}")
        self._bar = Progress(*columns, console=self._console, transient=True) if self._console.is_terminal else None
        self._task = None if self._bar is None else self._bar.add_task(title, total=1.0, left="")
        self._shown = -QUIET_INTERVAL
        self._told = ""

    def show(self, evaluations: Evaluations) -> None:
        if evaluations.told != self._told:
            self._told = evaluations.told
            self._console.print(f"{self._title}: {self._told}", highlight=False, markup=False, soft_wrap=True)
        best = "none yet" if evaluations.best is None else f"{in_mm(evaluations.best.value):.3f} mm"
        done = f"{evaluations.history.evaluations} evaluations, {evaluations.elapsed:.0f} s"
        remaining = f"{max(0.0, evaluations.seconds - evaluations.elapsed):.0f} s left at most"
        self.say(f"{evaluations.stage}: best {best}, {done}", share=evaluations.share, left=remaining)

    def say(self, text: str, *, share: float | None = None, left: str = "") -> None:
        """Show `title: text`; on a terminal a bar with the share done and what is said of the time left."""
        line = f"{self._title}: {text}"
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, description=line, completed=share, left=left)
        elif time.monotonic() - self._shown > QUIET_INTERVAL:
            self._shown = time.monotonic()
            self._console.print(line, highlight=False, markup=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

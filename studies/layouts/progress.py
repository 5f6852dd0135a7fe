"""The live line of a search, on standard error."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.status import Status

from optimize.evaluations import Evaluations

QUIET_INTERVAL = 10.0  # s between lines where standard error is no terminal


class LiveLine:
    """A context that shows `stage, best, evaluations, seconds` while a search calls `show`."""

    def __init__(self, title: str) -> None:
        self._title, self._console = title, Console(stderr=True)
        self._status = Status(title, console=self._console) if self._console.is_terminal else None
        self._shown = -QUIET_INTERVAL

    def show(self, evaluations: Evaluations) -> None:
        best = "none yet" if evaluations.best is None else f"{1e3 * evaluations.best.value:.3f} mm"
        done = f"{evaluations.history.evaluations} evaluations, {evaluations.elapsed:.0f} s"
        self.say(f"{evaluations.stage}: best {best}, {done}")

    def say(self, text: str) -> None:
        """Show `title: text`."""
        line = f"{self._title}: {text}"
        if self._status is not None:
            self._status.update(line)
        elif time.monotonic() - self._shown > QUIET_INTERVAL:
            self._shown = time.monotonic()
            self._console.print(line, highlight=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

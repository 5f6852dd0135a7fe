"""The live line of a trace, on standard error."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.status import Status


class TraceLine:
    """A context that shows what a trace is at, and for how long it has been."""

    def __init__(self, title: str) -> None:
        self._title, self._console, self._begin = title, Console(stderr=True), time.monotonic()
        self._status = Status(title, console=self._console) if self._console.is_terminal else None

    def show(self, line: str) -> None:
        said = f"{self._title}, {time.monotonic() - self._begin:.0f} s: {line}"
        if self._status is not None:
            self._status.update(said)
        else:
            self._console.print(said, highlight=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

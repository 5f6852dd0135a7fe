"""Clocks that stand still while compiled code is made or loaded: what is done once on a machine, or once in a process,
is no part of a limit, a pace or a figure.

`sim` says when it starts Taichi and when a kernel is called for the first time; Numba says itself when it compiles or
loads (`watch_numba`).
"""

import functools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class Stopwatch:
    """A clock [s] that `stop` and `go` on stop and set going; stops may nest, in several threads."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self.stops, self._stopped_at, self._excluded = 0, 0.0, 0.0

    def seconds(self) -> float:
        """Return the seconds since some instant, without those for which the clock stood still."""
        with self._lock:
            return (self._stopped_at if self.stops else self._clock()) - self._excluded

    @property
    def excluded(self) -> float:
        """Return s for which it has stood still."""
        with self._lock:
            return self._excluded + (self._clock() - self._stopped_at if self.stops else 0.0)

    def stop(self) -> None:
        """Stand still until as many `go` as `stop` were called."""
        with self._lock:
            if self.stops == 0:
                self._stopped_at = self._clock()
            self.stops += 1

    def go(self) -> None:
        """Undo one `stop`."""
        with self._lock:
            self.stops -= 1
            if self.stops == 0:
                self._excluded += self._clock() - self._stopped_at


wall, processor = Stopwatch(lambda: time.monotonic()), Stopwatch(lambda: time.process_time())


def seconds() -> float:
    """Return the seconds since some instant by the clock, without compiling and loading."""
    return wall.seconds()


@contextmanager
def not_counted() -> Iterator[None]:
    """Return a context for which both clocks stand still."""
    _stop()
    try:
        yield
    finally:
        _go()


def _stop() -> None:
    wall.stop()
    processor.stop()


def _go() -> None:
    wall.go()
    processor.go()


@functools.cache
def watch_numba() -> None:
    """Let the clocks stand still while Numba compiles or loads a function; call it where functions are declared."""
    from numba.core import event

    class Watch(event.Listener):
        """Listens to what Numba tells of its compiler."""

        def on_start(self, _: Any) -> None:
            _stop()

        def on_end(self, _: Any) -> None:
            _go()

    # around a compilation, and around loading an earlier one
    event.register("numba:compiler_lock", Watch())  # type: ignore[no-untyped-call]

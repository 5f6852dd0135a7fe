"""The simulator in a process of its own: Taichi's kernels hold Python's lock, and the page must answer meanwhile."""

import contextlib
import multiprocessing
import os
import signal
from multiprocessing.connection import Connection

from studies.studio.solver import Answer, Ask, StudioSolver


class SolverProcess:
    """One process that answers one ask at a time. It ends with its parent, or by `close`."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True, name="fabdesign studio")
        self._process.start()
        theirs.close()

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def send(self, ask: Ask) -> None:
        self.connection.send(ask)

    def receive(self) -> Answer | None:
        """The answer, if it is there."""
        try:
            return self.connection.recv() if self.connection.poll() else None
        except (EOFError, OSError):
            return None

    def close(self) -> None:
        self.connection.close()
        self._process.terminate()
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _serve(connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends this one
    os.environ.setdefault("FABDESIGN_LANES", "1")  # kernels for a lone design
    from sim import Simulator

    solver = StudioSolver(Simulator)
    with contextlib.suppress(EOFError, OSError):  # the parent has gone
        while True:
            connection.send(solver.answer(connection.recv()))

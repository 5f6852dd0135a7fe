"""What is asked of the simulator while someone edits, and its answers; and the process in which it computes.

Taichi's kernels hold Python's lock, and the page must answer meanwhile: so the simulator has a process of its own.
"""

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.errors import InputError, SimulationError
from fabdesign.forward import Case
from fabdesign.model import Model
from fabdesign.pressure import PressureProgram
from fabdesign.pressure_file import constant_program
from studies.forward_model import forward_model

COARSE = 21  # points a side, while something is dragged
Kind = Literal["follow", "exact", "motion"]


@dataclass(frozen=True, eq=False)
class Ask:
    """follow: the shape at rest nearby, on the coarse grid, from the last one. exact: the one where a rise from rest
    leads, on the model's grid. motion: frames at `times` [s]; with sensing, as sensors see it."""

    number: int
    kind: Kind
    design: Design
    program: PressureProgram
    model: Model
    times: NDArray[np.float64] | None = None
    order: int = 0
    sensing: bool = False

    @staticmethod
    def at_rest(number: int, kind: Kind, design: Design, pressures: tuple[float, ...], model: Model) -> "Ask":
        """pressures: (channels,) Pa."""
        return Ask(number, kind, design, constant_program(list(pressures)), model)


@dataclass(frozen=True, eq=False)
class Answer:
    """points: (2 n, 3) m of a shape, (T, 2 n, 3) of a motion; None where there is none, and `error` says why."""

    number: int
    kind: Kind
    points: NDArray[np.float32] | None
    points_per_side: int
    seconds: float
    error: str | None = None


class StudioSolver:
    """Answers asks one by one. make: of a simulator with so many points a side and a tolerance [m]."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make
        self._simulators: dict[int, Any] = {}
        self._last: tuple[Design, NDArray[np.float32]] | None = None  # the shape followed from, and of which design

    def answer(self, ask: Ask) -> Answer:
        begin = time.perf_counter()
        side = COARSE if ask.kind == "follow" else ask.model.points_per_side
        points, error = None, None
        try:
            points = self._points(ask, side)
            if not np.isfinite(points).all():
                points, error = None, f"no shape was found: the {ask.kind} calculation diverged"
        except (InputError, SimulationError) as problem:
            error = str(problem)
        return Answer(ask.number, ask.kind, points, side, time.perf_counter() - begin, error)

    def _points(self, ask: Ask, side: int) -> NDArray[np.float32]:
        simulator = self._simulator(side, ask.kind)
        case = Case(ask.design, ask.program, order=ask.order)
        if ask.kind == "follow":
            return self._followed(simulator, forward_model(simulator, ask.model.without(["corrector"])).case(case))
        model = forward_model(simulator, ask.model, sensing=ask.sensing)
        if ask.kind == "exact":
            return model.equilibria([case])[0]
        assert ask.times is not None
        return model.motions([case], [ask.times])[0]

    def _followed(self, simulator: Any, case: Case) -> NDArray[np.float32]:
        shape = None
        if self._last is not None and self._last[0].fabric == case.design.fabric:
            shape = simulator.follow(case, self._last[1])
        if shape is None or not np.isfinite(shape.middle).all():
            shape = simulator.rest([case])[0]
        self._last = (case.design, shape.middle[0]) if np.isfinite(shape.middle).all() else None
        points: NDArray[np.float32] = shape.points[0]
        return points

    def _simulator(self, side: int, kind: Kind) -> Any:
        key = side if kind != "follow" else -side
        if key not in self._simulators:
            self._simulators[key] = self._make(side, tolerance=1e-6) if kind == "follow" else self._make(side)
        return self._simulators[key]


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

"""A program under edit: its motion goes on from the state before the first set point that is another."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case
from sim import Simulator
from sim.resume import State, at_rest, with_states


class Resumed:
    """Simulates programs of one set point a cycle, and keeps the states at the cycles of the last. first: the frame
    from which on the last answer was simulated anew."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._last: tuple[Case, Array] | None = None  # and its times
        self._states: list[State] = []  # at the begin of each cycle, and at the end
        self._points: NDArray[np.float32] = np.zeros((0, 0, 3), np.float32)
        self.first = 0

    def motion(self, case: Case, times: Array) -> NDArray[np.float32]:
        """Return frames (T, 2 n, 3) m at `times` (T,) s after rest, the last at the program's end at most."""
        rows = case.program.pressure
        cycle = case.program.duration / len(rows)
        begin = self._same_until(case, times)
        if begin == 0:
            self._states, self._points = [at_rest(self._simulator, case)], self._points[:0]
        self.first = int(np.searchsorted(times, begin * cycle + 1e-9, side="right"))
        if self.first == len(times):
            return self._points  # nothing that is shown has changed
        ticks = [round(k * cycle / self._simulator.time_step) for k in range(begin + 1, len(rows) + 1)]
        [kept] = with_states(self._simulator, [case], self._states[begin], times[self.first :], ticks)
        later = kept.motion.points
        self._points = np.concatenate([self._points[: self.first], later]) if begin else later
        self._states[begin + 1 :], self._last = kept.states, (case, times)
        return self._points

    def _same_until(self, case: Case, times: Array) -> int:
        """Return the first cycle whose set points are others than the last program's; 0 for another case."""
        if self._last is None:
            return 0
        (last, at), program = self._last, case.program
        alike = program.duration == last.program.duration and program.pressure.shape == last.program.pressure.shape
        if not alike or not np.array_equal(at, times) or replace(case, program=last.program) != last:
            return 0
        changed = np.flatnonzero((program.pressure != last.program.pressure).any(axis=1))
        return int(changed[0]) if len(changed) else len(program.pressure)

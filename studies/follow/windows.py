"""The solver: windows of a program, one after another, each by Gauss-Newton on simulated motions.

What acts later moves no earlier frame. So a window begins from the simulator's own state at its first cycle, and each
set point's column from the state at its own cycle: a difference of two motions costs what is left of the window alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case
from sim import Simulator
from sim.motion import SimulatedMotion, faces
from sim.resume import KeptMotion, State, at_rest, go_on, with_states
from studies.follow.programs import UNIT, Regulator, Roughness, best_change
from studies.follow.wanted import Distances, Wanted, moved

AHEAD = 0.2  # s of a window that are kept; the rest is solved again with what comes
STEP = 5e3  # Pa, of the differences
FARTHEST = 1e5  # Pa, by which a set point may move at once
SHORTER = 0.3  # of that, after a step that gained nothing
# Levenberg's damping and the share of the step, of the programs that are tried beside one another
TRIED = (0.0, 1.0), (0.0, 0.5), (1e-3, 1.0), (1e-2, 1.0), (1e-2, 0.5), (0.1, 1.0)
ENOUGH = 0.03  # of the cost: where a step by fresh columns gains less, a window is solved
NOISY = 1.06  # of the cost that noise has: so little is not lowered further
WORTH = 0.3  # of the cost: after a step that gains less, columns are made anew


@dataclass(frozen=True, eq=False)
class FollowTask:
    """A program to be found. case: of the design with all that a model adds; only its program is replaced.

    lacks: (K, 2 n, 3) m, what is added to the simulated faces at each wanted instant: what a corrector, or a measured
    motion, says that the simulator lacks; None: nothing.
    """

    case: Case
    wanted: Wanted
    regulator: Regulator
    simulator: Simulator
    lacks: Array | None = None

    def cases(self, programs: Sequence[Array]) -> list[Case]:
        """Return the case with each of the set points (cycles, channels) Pa."""
        return [replace(self.case, program=self.regulator.program(rows)) for rows in programs]


@dataclass(frozen=True, eq=False)
class _Window:
    """Cycles `begin` to `end` of a task, from a state on."""

    task: FollowTask
    begin: int
    end: int
    state: State

    @property
    def moments(self) -> NDArray[np.intp]:
        cycle = self.task.regulator.cycle
        return self.task.wanted.until(self.begin * cycle, self.end * cycle)

    @property
    def times(self) -> Array:
        return self.task.wanted.times[self.moments]

    def ticks(self, cycle: int) -> int:
        return round(cycle * self.task.regulator.cycle / self.task.simulator.time_step)

    def distances(self, motion: SimulatedMotion) -> list[Distances | None]:
        """Return the distances at each instant of the window."""
        shapes = faces(motion.middle, motion.thickness).astype(float)
        if self.task.lacks is not None:
            shapes = shapes + self.task.lacks[self.moments]
        side = self.task.simulator.points_per_side
        return [self.task.wanted.distances(k, shape, side) for k, shape in zip(self.moments, shapes, strict=True)]

    def with_states(self, programs: Sequence[Array]) -> list[KeptMotion]:
        first, *ticks = [self.ticks(k) for k in range(self.begin, self.end + 1)]
        cases, jumping = self.task.cases(programs), [first, *ticks[:-1]]
        return with_states(self.task.simulator, cases, self.state, self.times, ticks, jumping=jumping)


Keep = Callable[[str, Callable[[], Array]], Array | None]  # of a window: its name, and what computes its set points


def solve(
    task: FollowTask,
    program: Array,
    *,
    steps: int,
    length: float = 0.4,
    keep: Keep = lambda name, compute: compute(),
    progress: Callable[[float], None] = lambda share: None,
) -> Array:
    """Return set points (cycles, channels) Pa that bring the motion nearer to what is wanted, beginning with `program`.
    steps: of Gauss-Newton, of a window, at most; length: s of a window. keep: gives the set points of a window, which
    it may have kept from before; None ends the work. progress: hears the share of the windows that are done."""
    program, cycles = program.copy(), len(program)
    longest, ahead = (max(1, round(seconds / task.regulator.cycle)) for seconds in (length, AHEAD))
    [case] = task.cases([program])
    state, begin = at_rest(task.simulator, case), 0
    while begin < cycles:
        window = _Window(task, begin, _end(task, begin, longest, ahead, cycles), state)
        rows = keep(f"{begin}", partial(_solved, window, program, steps))
        if rows is None:
            break
        program[begin : window.end] = rows
        following = min(begin + ahead, cycles)
        if following < cycles:
            [kept] = replace(window, end=following).with_states([program])
            state = kept.states[-1]
        begin = following
        progress(begin / cycles)
    return program


def _end(task: FollowTask, begin: int, length: int, ahead: int, cycles: int) -> int:
    """Return the cycle at which a window ends: where few instants are, it reaches as far as the next one does."""
    cycle, end = task.regulator.cycle, begin + length
    later = task.wanted.times[task.wanted.times > (begin + ahead) * cycle + 1e-9]
    if len(later):
        end = max(end, int(np.ceil(later[0] / cycle - 1e-6)))
    return min(end, cycles)


def _solved(window: _Window, program: Array, steps: int) -> Array:
    """Return the window's set points (end - begin, channels) Pa. Columns serve as long as steps along them gain.
    steps: of Gauss-Newton, at most."""
    begin, end = window.begin, window.end
    if not len(window.moments):
        return program[begin:end]
    [at] = _Place.all_of(window, [program])
    columns, farthest, others = None, FARTHEST, ((begin, len(program) - end), (0, 0))  # set points that stay
    for _ in range(steps):
        if at.is_solved:
            break
        fresh = columns is None
        if columns is None:
            columns = _columns(window, at)
        changes = [share * at.step(columns, farthest, damping) for damping, share in TRIED]
        trials = _Place.all_of(window, [at.program + np.pad(change, others) for change in changes])
        trial = min(trials, key=lambda place: place.cost)
        gained = (at.cost - trial.cost) / at.cost
        if gained > 0:
            at, farthest = trial, FARTHEST
        else:
            farthest *= SHORTER
        if fresh and 0 <= gained < ENOUGH:
            break
        if gained < WORTH:
            columns = None
    return at.program[begin:end]


@dataclass(frozen=True, eq=False)
class _Place:
    """A program in a window: its motion with the states at its cycles, and how far it is from what is wanted."""

    window: _Window
    program: Array
    kept: KeptMotion
    distances: Sequence[Distances | None]
    roughness: Roughness

    @staticmethod
    def all_of(window: _Window, programs: Sequence[Array]) -> "list[_Place]":
        places = []
        for program, kept in zip(programs, window.with_states(programs), strict=True):
            rows = program[window.begin : window.end]
            rough = Roughness.of(_rows_before(program, window.begin), rows, window.task.regulator.rough)
            places.append(_Place(window, program, kept, window.distances(kept.motion), rough))
        return places

    @property
    def cost(self) -> float:
        """Return the weighted squares of all; infinite for a motion that diverged."""
        costs = [np.inf if one is None else one.cost for one in self.distances]
        return float(sum(costs) + self.roughness.value)

    @property
    def is_solved(self) -> bool:
        """Return whether nothing is to be gained: the distances are noise, or the motion diverged."""
        costs = [(one.cost, one.of_noise) for one in self.distances if one is not None]
        return len(costs) < len(self.distances) or sum(c for c, _ in costs) <= NOISY * sum(n for _, n in costs)

    def step(self, columns: Sequence[NDArray[np.floating[Any]]], farthest: float, damping: float) -> Array:
        """Return the change (cycles, channels) Pa that Gauss-Newton takes. damping: Levenberg's, of the mean of the
        Hessian's diagonal."""
        hessian, gradient = self.roughness.hessian, self.roughness.gradient
        for at_instant, moves in zip(self.distances, columns, strict=True):
            assert at_instant is not None
            slopes = UNIT * moved(at_instant, moves)
            hessian = hessian + slopes.T @ (at_instant.robust[:, None] * slopes)
            gradient = gradient + slopes.T @ (at_instant.robust * at_instant.off)
        hessian = hessian + damping * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
        begin = self.window.begin
        rows = _rows_before(self.program, begin)[-1], self.program[begin : self.window.end]
        return best_change(hessian, gradient, self.window.task.regulator, rows, farthest)


def _columns(window: _Window, at: _Place) -> list[NDArray[np.floating[Any]]]:
    """Return how the mid-surface moves with each set point: (cycles channels, n, n, 3) m per Pa of each instant."""
    program, motion, states = at.program, at.kept.motion, [window.state, *at.kept.states]
    regulator, cases, begins, times, moves = window.task.regulator, [], [], [], []
    for k, state in zip(range(window.begin, window.end), states, strict=False):
        later = window.times[window.times > k * regulator.cycle + 1e-9]
        for channel in range(regulator.channels if len(later) else 0):
            by = STEP if program[k, channel] + STEP <= regulator.highest[channel] else -STEP
            trial = program.copy()
            trial[k, channel] += by
            cases.append(trial)
            begins.append(state)
            times.append(later)
            moves.append(by)
    motions = go_on(window.task.simulator, window.task.cases(cases), begins, times, jumps=at.kept.jumps)
    count = (window.end - window.begin) * regulator.channels
    changes = np.zeros((len(window.times), count, *motion.middle.shape[1:]), np.float32)
    for k, moved_one in enumerate(motions):
        rows = len(window.times) - len(times[k])
        changes[rows:, k] = (moved_one.middle - motion.middle[rows:]) / moves[k]
    return list(np.nan_to_num(changes))


def _rows_before(program: Array, begin: int) -> Array:
    """Return the rows before `begin`, (2, channels) Pa; rest before the first."""
    rest = np.zeros((2, program.shape[1]))
    return np.concatenate([rest, program[:begin]])[-2:]

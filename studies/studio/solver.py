"""Questions to the simulator while someone edits, and its answers; and the process in which it computes.

Taichi's kernels hold Python's lock, and the page must answer meanwhile: so the simulator has a process of its own.
"""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.motion_file import Motion
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.metrics import Errors, trial_errors
from fabdesign.geometry.sensor_noise import NOISE_FREE, estimate_noise
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, Corrector, Trust
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from fabdesign.runtime import working_time
from fabdesign.runtime.supervisor import uninterrupted
from studies.follow import Wanted
from studies.prediction.forward_model import forward_model, laced_motions

COARSE = 21  # points a side, while something is dragged
_NOISE_FRAMES = 8  # of a trial, that a sensor's noise is estimated from
Kind = Literal["follow", "nearby", "exact", "motion", "program", "laced"]
Points = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Ask:
    """follow: the shape at rest nearby, on the coarse grid, from the last one. nearby: the same under another model,
    from which nothing is followed. exact: the one where a rise from rest leads, on the model's grid, or with one
    instant in `times` [s] the motion's frame there. motion: frames at `times`; with sensing, as sensors see it.
    program: the same on the coarse grid, from where the last program was another. laced: with the muscles, for other
    programs. wanted: what a motion is compared with."""

    kind: Kind
    case: Case
    model: Model
    times: Array | None = None
    sensing: bool = False
    measured: tuple[NDArray[np.floating[Any]], ...] = ()  # (n_t, 3) m of each frame, where errors are asked for
    wanted: Wanted | None = None

    @property
    def loose(self) -> bool:
        """Return whether it is answered on the coarse grid, to a micrometre."""
        return self.kind in ("follow", "nearby", "program")

    @property
    def points_per_side(self) -> int:
        return COARSE if self.loose else self.model.points_per_side

    @staticmethod
    def at_rest(
        kind: Kind, design: Design, pressures: tuple[float, ...], model: Model, time: float | None = None
    ) -> "Ask":
        """Ask for a shape under pressures (channels,) Pa. time: s after rest, where an exact one is of a motion."""
        if kind == "exact" and time is not None:
            return Ask(kind, Case(design, constant_program(list(pressures), time)), model, np.array([time]))
        return Ask(kind, Case(design, constant_program(list(pressures))), model)

    @staticmethod
    def of_trial(trial: Trial, model: Model) -> "Ask":
        """Ask for a trial's motion as sensors see it, and its errors from what was measured. Raises InputError."""
        case = Case(trial.design, trial.program, order=trial.order)
        return Ask("motion", case, model, trial.times, sensing=True, measured=tuple(trial.load().frames))


@dataclass(frozen=True, eq=False)
class Correction:
    """The shape or motion that a corrector made. ordered: whether its answer is a surface; an unordered cloud is
    not shown, and the points stay the simulated ones."""

    trust: Trust
    ordered: bool
    simulated: Points  # without it

    def moved(self, points: Points) -> Points:
        """Return the distance [m] by which each of `points` (..., 3) was moved."""
        return np.asarray(np.linalg.norm(points - self.simulated, axis=-1))


@dataclass(frozen=True, eq=False)
class Answer:
    """points: (2 n, 3) m of a shape, (T, 2 n, 3) of a motion; None where there is none, and `error` says why. With
    `measured` in the ask: errors of the simulated motion, and of the corrected one where a corrector acts."""

    points: Points | None = None
    seconds: float = 0.0
    error: str = "no motion"
    correction: Correction | None = None
    errors: tuple[Errors, ...] = ()
    laced: Motion | None = None
    off: Array | None = None  # (T,) m from what is wanted, NaN at instants at which nothing is


class StudioSolver:
    """Answers asks one by one. make: of a simulator with so many points a side and a tolerance [m]."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = cache(make)
        self._correctors: dict[tuple[Path, str], Corrector | None] = {}
        self._last: tuple[Design, Points] | None = None  # the shape followed from, and of which design
        self._program: Resumed | None = None

    def answer(self, ask: Ask) -> Answer:
        """Return the answer; what goes wrong is said in it."""
        begin = working_time.seconds()
        try:
            answer = self._computed(ask)
        except (InputError, SimulationError) as problem:
            answer = Answer(error=str(problem))
        return replace(answer, seconds=working_time.seconds() - begin)

    def _computed(self, ask: Ask) -> Answer:
        """Return shape or motion. The corrector acts on exact ones alone; how far it trusts the layout is said of
        all."""
        simulator, correction = self._make(ask.points_per_side, **({"tolerance": 1e-6} if ask.loose else {})), None
        if ask.kind == "laced" and ask.times is not None:
            predictor = replace(forward_model(simulator, ask.model), sensing=ask.sensing)
            (laced,) = laced_motions(predictor, [ask.case], [ask.times])
            return Answer(laced.points, laced=laced)
        given = ask.model.without(["corrector"]) if ask.kind == "nearby" else ask.model
        model = replace(self._predictor(_Remembering(simulator), given), sensing=ask.sensing)
        corrector, bare = model.corrector, replace(model, corrector=None)
        if ask.kind == "program" and ask.times is not None:
            self._program = self._program or Resumed(simulator)
            points = simulated = self._program.motion(model.case(ask.case), ask.times)
        elif ask.loose:
            points = simulated = self._followed(simulator, model.case(ask.case), ask.kind)
        else:
            points = _shown(model if corrector is None or corrector.ordered else bare, ask)
            simulated = points if corrector is None else _shown(bare, ask)
        if corrector is not None:
            correction = Correction(corrector.trust(ask.case.design), corrector.ordered, simulated)
        if not np.isfinite(points).all():
            raise SimulationError(f"no shape was found: the {ask.kind} calculation diverged")
        errors = _errors(ask, points, correction) if ask.measured else ()
        off = None if ask.wanted is None or ask.times is None else ask.wanted.errors(ask.times, points)
        return Answer(points, correction=correction, errors=errors, off=off)

    def _predictor(self, simulator: Any, model: Model) -> Predictor:
        """Return what `forward_model` does; a corrector's file is read once."""
        if model.corrector is None:
            return forward_model(simulator, model)
        key = model.corrector, model.central_hash
        if key not in self._correctors:
            self._correctors[key] = forward_model(simulator, model).corrector
        return Predictor(simulator, model, corrector=self._correctors[key])

    def _followed(self, simulator: Any, case: Case, kind: Kind) -> Points:
        """Return the shape at rest near the last one that was followed."""
        shape = None
        if self._last is not None and self._last[0].fabric == case.design.fabric:
            shape = simulator.follow(case, self._last[1])
        if shape is None or not np.isfinite(shape.middle).all():
            shape = simulator.rest([case])[0]
        if kind == "follow":
            self._last = (case.design, shape.middle[0]) if np.isfinite(shape.middle).all() else None
        points: Points = shape.points[0]
        return points


class _Remembering:
    """A forward model for one case that computes once what a corrector starts from and what is shown without it: asked
    again for the shape, or for some instants of the motion, it gives what it has."""

    def __init__(self, simulator: Any) -> None:
        self._simulator = simulator
        self._shapes: list[Points] | None = None
        self._motion: tuple[Array, Points] | None = None

    def equilibria(self, cases: Sequence[Case]) -> list[Points]:
        self._shapes = self._shapes or self._simulator.equilibria(cases)
        return self._shapes

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[Points]:
        self._motion = self._motion or (times[0], self._simulator.motions(cases, times)[0])
        at, points = self._motion
        return [points[np.searchsorted(at, times[0] - 1e-6)]]


def _shown(model: Predictor, ask: Ask) -> Points:
    if ask.times is None:
        return model.equilibria([ask.case])[0]
    frames = model.motions([ask.case], [ask.times])[0]
    return frames[-1] if ask.kind == "exact" else frames


def _errors(ask: Ask, points: Points, correction: Correction | None) -> tuple[Errors, ...]:
    """Return the errors that `evaluate` has of a trial, over all its frames and by its own noise. Floors are NaN where
    the clouds have too few points to show any."""
    motions = [points] if correction is None else [correction.simulated, points]
    frames = ask.measured[:: -(-len(ask.measured) // _NOISE_FRAMES)]
    try:
        noise = estimate_noise(frames, ask.case.design.fabric.thickness)
    except InputError:
        of_motions = [trial_errors(ask.measured, motion, NOISE_FREE, draws=1) for motion in motions]
        return tuple(replace(errors, chamfer_floor=np.nan, surface_floor=np.nan) for errors in of_motions)
    return tuple(trial_errors(ask.measured, motion, noise) for motion in motions)


class Resumed:
    """Simulates programs of one set point a cycle, each from the state before the first set point that is another than
    the last program's. first: the frame from which on the last answer was simulated anew."""

    def __init__(self, simulator: Any) -> None:
        self._simulator = simulator
        self._last: tuple[Case, Array] | None = None  # and its times
        self._states: list[Any] = []  # at the begin of each cycle, and at the end
        self._points: Points = np.zeros((0, 0, 3), np.float32)
        self.first = 0

    def motion(self, case: Case, times: Array) -> Points:
        """Return frames (T, 2 n, 3) m at `times` (T,) s after rest, the last at the program's end at most."""
        from sim.resume import at_rest, with_states

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


class SolverProcess:
    """One process that answers one ask at a time. It ends with its parent, or by `close`."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self.send = self._connection.send
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True, name="fabdesign studio")
        with uninterrupted():  # a process that is cut off at its start prints a traceback
            self._process.start()
        theirs.close()

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def receive(self) -> Answer | None:
        """Return the answer, if it is there."""
        with contextlib.suppress(EOFError, OSError):
            return self._connection.recv() if self._connection.poll() else None
        return None

    def close(self) -> None:
        self._connection.close()
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

"""The motion that is played: a rise, a table of pressures, a trial beside its prediction, or the program under edit
over a target that moves; and writing it."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, needs
from fabdesign.files.motion_file import Motion
from fabdesign.files.pressure_file import read_pressures, write_pressures
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import RISE, Case
from fabdesign.nouns.pressure import PressureProgram, require_pressures, rising_program
from fabdesign.output import new_files
from fabdesign.units import in_mm
from studies.follow import case_of
from studies.prediction.predict import frame_times
from studies.studio.document import Document
from studies.studio.drawings import TrialMotion
from studies.studio.layout import Layout
from studies.studio.opening import FRAME_RATE, MovingProgram
from studies.studio.shapes import Shapes
from studies.studio.solver import Answer, Ask, Kind
from studies.view import KINDS, Item, write_panels

WRITTEN = [kind for kind in KINDS if kind not in (".gif", ".mp4")]  # for these the page would stand still
UNKNOWN = (Errors(*[float("nan")] * 5),)
_PAUSE = 0.5  # s, before a motion begins again


class Playing:
    """Plays one motion at a time. motion: of the layout that is shown; None: its shape at rest is looked at. frame: the
    one that is shown. running: whether it plays on by itself. errors: how far the chosen model is from trials of a set,
    by their labels: of the simulated motion, and of the corrected one where a corrector acts."""

    def __init__(self, document: Document, shapes: Shapes) -> None:
        self._document, self._shapes = document, shapes
        self.errors: dict[str, tuple[Errors, ...]] = {}
        self._filling, self._choice = False, document.choice  # whether the errors of all trials are asked for
        self.motion: TrialMotion | None = None
        self.frame, self.running, self._time = 0, False, 0.0  # _time: s since the motion's first frame
        self._played: Ask | None = None  # what `motion` answers
        document.listeners.append(self._stop)

    def _stop(self) -> None:
        self.motion, self.running, self._filling = None, False, False
        if self._choice is not self._document.choice:  # the errors were of another model
            self._choice, self.errors = self._document.choice, {}

    def rise(self) -> None:
        """Play the motion to the pressures as they are: they rise within 1 s, and hold for 1 s."""
        self._play("rise", rising_program(np.array(self._document.layout.pressures), RISE, RISE + 1.0))

    def file(self, path: Path) -> None:
        self._play(path.name, read_pressures(path, self._document.layout.design))

    def opened(self, program: PressureProgram) -> None:
        """Play the pressures that were given on the command line."""
        require_pressures(program, self._document.layout.design, "pressures")
        self._play("pressures", program)

    def _play(self, name: str, program: PressureProgram) -> None:
        document = self._document
        if not document.layout.pressures:
            raise InputError("no muscles; expected some that move the cloth")
        times = frame_times(program, frame_rate=FRAME_RATE)
        document.history.end()
        self._ask(Ask("motion", Case(document.layout.design, program), document.choice.model, times), name)

    def trial(self, label: str) -> None:
        """Play a trial of the set, measured, and its prediction under the model that is chosen."""
        document = self._document
        trial = document.trials[label]
        ask = Ask.of_trial(trial, document.choice.model)
        if trial.design != document.layout.design:
            document.put(f"design of {trial.name}", Layout.of(trial.design))
        self._ask(ask, label)

    def all_errors(self) -> None:
        """Ask for the errors of every trial that has none, one after another, until something is edited or chosen."""
        document, choice = self._document, self._document.choice
        label = next((label for label in document.trials if label not in self.errors), None)
        self._filling = label is not None
        if label is None:
            document.tell(f"errors of all {len(self.errors)} trials")
            return

        def arrived(answer: Answer) -> None:
            if choice is document.choice:
                self.errors[label] = answer.errors or UNKNOWN
                document.show()
                if self._filling:
                    self.all_errors()

        self._shapes.also(Ask.of_trial(document.trials[label], choice.model), arrived)

    def show(self, motion: TrialMotion, ask: Ask) -> None:
        """Play a motion from its first frame; one with the same frames as the last goes on where that is."""
        last, self.motion, self._played = self.motion, motion, ask
        if last is None or not np.array_equal(last.times, motion.times):
            self.frame, self.running, self._time = 0, True, 0.0
        self._shapes.before = None
        self._document.show()

    def _ask(self, ask: Ask, name: str) -> None:
        """Have a motion computed, with its errors from what was measured, if anything, and play it."""
        times, document = ask.times, self._document
        assert times is not None

        def arrived(answer: Answer) -> None:
            if answer.points is None:
                raise InputError(answer.error)
            if ask.measured:
                self.errors[name] = answer.errors or UNKNOWN
            self.motion = None
            self.show(TrialMotion(name, times, answer.points, ask.measured or None, answer.correction), ask)
            document.tell(f"{name}: {len(times)} frames")

        document.tell(f"computing {len(times)} frames")
        self._shapes.also(ask, arrived)

    def advance(self, seconds: float) -> None:
        """Play on for so long."""
        if self.motion is None or not self.running:
            return
        at = self.motion.times - self.motion.times[0]
        self._time = self._time + seconds if self._time + seconds <= at[-1] + _PAUSE else 0.0
        frame = max(int((at <= self._time + 1e-9).sum()) - 1, 0)
        if frame != self.frame:
            self.frame = frame
            self._document.show()

    def toggle(self) -> None:
        self.running = not self.running
        self._document.show()

    def scrub(self, frame: float) -> None:
        """Stop at a frame."""
        if self.motion is not None:
            self.running, self.frame = False, min(int(frame), len(self.motion.times) - 1)
            self._time = float(self.motion.times[self.frame] - self.motion.times[0])
            self._document.show()

    def write(self, path: Path) -> None:
        """Write the motion that is played, for another program."""
        motion, ask, document = self.motion, self._played, self._document

        def arrived(answer: Answer) -> None:
            if answer.laced is None or motion is None:
                raise InputError(answer.error)
            _export(path, motion, answer.laced)
            document.tell(f"wrote {path}")

        if motion is None or ask is None:
            raise InputError("no motion; expected one that is played")
        if path.suffix.lower() not in WRITTEN:
            raise InputError(f"{path}: expected a name that ends in {', '.join(WRITTEN[:-1])} or {WRITTEN[-1]}")
        document.tell(f"writing {path}")
        self._shapes.also(replace(ask, kind="laced", measured=(), wanted=None), arrived)


def _export(path: Path, shown: TrialMotion, laced: Motion) -> None:
    """Write the motion that is shown, `laced` with its muscles. What was measured stands beside it, but not in a table
    of markers, which it has not. Raises InputError, also for a file that is there."""
    items = [Item.of_motion(shown.name, laced)]
    if shown.clouds is not None and path.suffix.lower() != ".csv":
        title = f"{shown.name}, {'measured' if shown.off is None else 'wanted'}"
        measured = Item(title, np.asarray(shown.times, np.float64), shown.clouds)
        items = [measured, Item.of_motion(f"{shown.name}, predicted", laced, measured.title)]
    try:
        with new_files(path) as unfinished:
            write_panels(items, unfinished)
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: {needs(error)}") from None


KNOTS = 0.1  # s between two, or a cycle where that is longer


class ProgramEdit:
    """A program under edit. pressures: (cycles, channels) Pa. channel, knot: which are edited; a knot is a set point,
    and those between it and its neighbours move with it. off: (T,) m of the motion that is shown; first: of the first
    one, under the program as it was opened."""

    def __init__(self, moving: MovingProgram, document: Document, shapes: Shapes, playing: Playing) -> None:
        self.moving, self.pressures = moving, moving.pressures
        self._document, self._shapes, self._playing = document, shapes, playing
        self.channel, self.knot = 0, 0
        self.off: Array | None = None
        self.first: Array | None = None

    @property
    def _each(self) -> int:
        """Return cycles from one knot to the next."""
        return max(1, round(KNOTS / self.moving.regulator.cycle))

    @property
    def knots(self) -> NDArray[np.intp]:
        """Return the cycles that knots begin."""
        return np.arange(0, len(self.pressures), self._each)

    @property
    def pressure(self) -> float:
        """Return Pa of the knot under edit."""
        return float(self.pressures[self.knots[self.knot], self.channel])

    def select(self, channel: int, knot: int) -> None:
        self.channel, self.knot = channel, min(knot, len(self.knots) - 1)
        self._document.show()

    def put(self, pressure: float) -> None:
        """Give the knot under edit a pressure [Pa], as far as the regulator goes with it, and simulate again."""
        row, rows = int(self.knots[self.knot]), self.pressures.copy()
        share = np.maximum(0.0, 1 - np.abs(np.arange(len(rows)) - row) / self._each)
        if row == self.knots[-1]:
            share[row:] = 1.0  # to the end
        rows[:, self.channel] += (pressure - rows[row, self.channel]) * share
        self.take(self.moving.regulator.kept(rows))

    def take(self, pressures: Array) -> None:
        """Take other set points (cycles, channels) Pa."""
        self.pressures = pressures
        self._document.show()
        self.play()

    def play(self, kind: Kind = "program") -> None:
        """Simulate the program, and play it over the target. kind: "motion" on the model's grid, with its corrector."""
        document, moving, design = self._document, self.moving, self._document.layout.design
        if design.channels != moving.regulator.channels:
            raise InputError(f"{design.name}: {design.channels} channels; the program has {moving.regulator.channels}")
        case = replace(case_of(moving.study, moving.regulator.program(self.pressures)), design=design)
        ask = Ask(kind, case, document.choice.model, moving.times, wanted=moving.wanted)
        self._shapes.also(ask, partial(self._arrived, ask))

    def _arrived(self, ask: Ask, answer: Answer) -> None:
        document = self._document
        if (ask.case.design, ask.model) != (document.layout.design, document.choice.model):
            return  # others by now, and the motion was stopped
        if answer.points is None or answer.off is None:
            raise InputError(answer.error)
        self.off = answer.off
        self.first = self.off if self.first is None else self.first
        name, times, clouds = f"{ask.points_per_side} points a side", self.moving.times, self.moving.clouds
        self._playing.show(TrialMotion(name, times, answer.points, clouds, answer.correction, answer.off), ask)
        mean = in_mm(float(np.nanmean(answer.off)))
        document.tell(f"{mean:.2f} mm from the target, {answer.seconds:.1f} s of computing")

    def save(self, path: Path, *, replace: bool = False) -> None:
        """Write the program, set points at the regulator's cycle."""
        with new_files(path, force=replace) as unfinished:
            write_pressures(self.moving.regulator.program(self.pressures), unfinished)
        self._document.tell(f"wrote {path}")

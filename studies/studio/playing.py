"""The motion that is played: a rise, a table of pressures, or a trial beside its prediction; and writing it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fabdesign.errors import InputError, needs
from fabdesign.forward import RISE
from fabdesign.motion_file import MotionData
from fabdesign.output import new_files
from fabdesign.pressure import PressureProgram, require_pressures, rising_program
from fabdesign.pressure_file import read_pressures
from studies.predict import frame_times
from studies.studio.layout import Layout
from studies.studio.measured import TrialMotion
from studies.studio.solver import Answer, Ask
from studies.studio.trial_errors import ask_of_trial
from studies.view.items import Item
from studies.view.write import KINDS, writer

if TYPE_CHECKING:
    from studies.studio.session import Session

FRAME_RATE = 30.0  # Hz, of a motion that is played
SLOW = (".gif", ".mp4")  # for which the page would stand still; `view` writes them


class Playing:
    """motion: of the layout that is shown; None: its shape at rest is looked at."""

    def __init__(self, session: "Session") -> None:
        self._session = session
        self.motion: TrialMotion | None = None
        self._played: Ask | None = None  # what `motion` answers

    def rise(self) -> None:
        """The motion to the pressures as they are: they rise within 1 s, and hold for 1 s."""
        self._play("rise", lambda: rising_program(np.array(self._session.layout.pressures), RISE, RISE + 1.0))

    def file(self, path: Path) -> None:
        self._play(path.name, lambda: read_pressures(path, self._session.layout.design))

    def opened(self) -> None:
        """The pressures that were given on the command line."""
        if (program := self._session.opened.program) is not None:

            def checked() -> PressureProgram:
                require_pressures(program, self._session.layout.design, "pressures")
                return program

            self._play("pressures", checked)

    def _play(self, name: str, read: Callable[[], PressureProgram]) -> None:
        session = self._session
        try:
            program = read()
            if not session.layout.pressures:
                raise InputError("no muscles; expected some that move the cloth")
        except InputError as error:
            session.view.tell(str(error), bad=True)
            return
        times = frame_times(program, frame_rate=FRAME_RATE)
        session.document.end()
        ask = Ask(0, "motion", session.layout.design, program, session.choice.model, times)
        self._ask(ask, lambda answer: TrialMotion(name, times, _points(answer), None, answer.correction))

    def trial(self, label: str) -> None:
        """A trial of the set, measured, and its prediction under the model that is chosen."""
        session = self._session
        try:
            trial, data, ask = ask_of_trial(session.trial(label), session.choice.model)
        except InputError as error:
            session.view.tell(str(error), bad=True)
            return
        if trial.design != session.layout.design:
            session.drawings.shown = None
            session.document.do(f"design of {trial.name}", Layout.of(trial.design))
            session.changed()

        def motion(answer: Answer) -> TrialMotion:
            session.trial_errors.add(label, answer)
            return TrialMotion(label, trial.times, _points(answer), data, answer.correction)

        self._ask(ask, motion)

    def _ask(self, ask: Ask, motion: Callable[[Answer], TrialMotion]) -> None:
        session = self._session

        def arrived(answer: Answer) -> None:
            if answer.points is None:
                session.view.tell(answer.error or "no motion", bad=True)
                return
            self.motion, self._played = motion(answer), ask
            session.view.show_motion()
            session.view.tell(f"{self.motion.name}: {len(self.motion.times)} frames")

        session.view.tell(f"computing {len(ask.times) if ask.times is not None else 0} frames")
        session.shapes.also(ask, arrived)

    def write(self, path: Path) -> None:
        """The motion that is played, for another program."""
        motion, ask, view = self.motion, self._played, self._session.view
        try:
            if motion is None or ask is None:
                raise InputError("no motion; expected one that is played")
            _require_kind(path)
        except InputError as error:
            view.tell(str(error), bad=True)
            return

        def arrived(answer: Answer) -> None:
            try:
                if answer.laced is None:
                    raise InputError(answer.error or "no motion")
                _export(path, motion, answer.laced)
            except InputError as error:
                view.tell(str(error), bad=True)
                return
            view.tell(f"wrote {path}")

        view.tell(f"writing {path}")
        self._session.shapes.also(replace(ask, kind="laced", measured=()), arrived)


def _points(answer: Answer) -> np.ndarray:
    assert answer.points is not None
    return answer.points


def _require_kind(path: Path) -> str:
    """The file's ending. Raises InputError."""
    kind, kinds = path.suffix.lower(), [kind for kind in KINDS if kind not in SLOW]
    if kind not in kinds:
        raise InputError(f"{path}: expected a name that ends in {', '.join(kinds[:-1])} or {kinds[-1]}")
    return kind


def _export(path: Path, shown: TrialMotion, laced: MotionData) -> None:
    """laced: the motion that is shown, with its muscles. What was measured stands beside it, but not in a table of
    markers, which it has not. Raises InputError, also for a file that is there."""
    kind = _require_kind(path)
    items = [Item.of_motion(shown.name, laced)]
    if shown.trial is not None and kind != ".csv":
        measured = Item(f"{shown.name}, measured", np.asarray(shown.times, np.float64), shown.trial.frames)
        items = [measured, Item.of_motion(f"{shown.name}, predicted", laced, measured.title)]
    try:
        with new_files(path) as unfinished:
            writer(kind)(items, unfinished)
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: {needs(error)}") from None

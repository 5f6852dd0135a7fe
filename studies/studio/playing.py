"""The motion that is played: a rise, a table of pressures, or a trial beside its prediction; and writing it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fabdesign.errors import InputError
from fabdesign.forward import RISE
from fabdesign.pressure import PressureProgram, require_pressures, rising_program
from fabdesign.pressure_file import read_pressures
from studies.predict import frame_times
from studies.studio.exporting import export_motion, require_kind
from studies.studio.layout import Layout
from studies.studio.measured import TrialMotion
from studies.studio.solver import Answer, Ask
from studies.studio.trial_errors import ask_of_trial

if TYPE_CHECKING:
    from studies.studio.session import Session

FRAME_RATE = 30.0  # Hz, of a motion that is played


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
            session.trial_errors.found(label, answer)
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
            require_kind(path)
        except InputError as error:
            view.tell(str(error), bad=True)
            return

        def arrived(answer: Answer) -> None:
            try:
                if answer.laced is None:
                    raise InputError(answer.error or "no motion")
                export_motion(path, motion, answer.laced)
            except InputError as error:
                view.tell(str(error), bad=True)
                return
            view.tell(f"wrote {path}")

        view.tell(f"writing {path}")
        self._session.shapes.also(replace(ask, kind="laced", measured=()), arrived)


def _points(answer: Answer) -> np.ndarray:
    assert answer.points is not None
    return answer.points

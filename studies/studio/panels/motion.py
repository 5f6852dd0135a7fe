"""Playing a pressure programme or a measured trial, and scrubbing through it."""

from pathlib import Path
from typing import Any

from studies.studio.measured import TrialMotion, errors_table
from studies.studio.panels.asking import Post, markdown, on_click, on_input, put
from studies.studio.panels.status import LEAST_SCALE, scale_bar
from studies.studio.session import Session


class MotionPanel:
    """Which frame of the session's motion is shown, and whether it plays. Its time runs in `advance`."""

    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._gui, self._session, self._post = gui, session, post
        self.frame, self.playing, self._time = 0, False, 0.0
        self._begun: TrialMotion | None = None
        self._rise = gui.add_button("Play the rise to these pressures")
        on_click(self._rise, post, session.playing.rise)
        if session.opened.program is not None:
            on_click(gui.add_button("Play the pressures of the command line"), post, session.playing.opened)
        self._file = gui.add_text("Pressures file", "")
        on_click(gui.add_button("Play the file"), post, lambda: session.playing.file(Path(self._file.value.strip())))
        if session.trials:
            self._trial = gui.add_dropdown("Trial", tuple(session.trials))
            on_click(
                gui.add_button("Show measured and predicted"), post, lambda: session.playing.trial(self._trial.value)
            )
            on_click(gui.add_button("Errors of all trials"), post, session.trial_errors.begin)
        self._pause = gui.add_button("Pause", disabled=True)
        on_click(self._pause, post, self._toggle)
        self._scrub = gui.add_slider("Frame", 0, 1, 1, 0, disabled=True)
        on_input(self._scrub, post, self._scrubbed)
        self._text = gui.add_markdown("")
        self._scale = gui.add_html("")
        with gui.add_folder("For other programs", expand_by_default=False):
            self._out = gui.add_text("File", "motion.glb", hint=".glb, .pvd, .rrd, .csv, .html or .png")
            on_click(
                gui.add_button("Write the motion"), post, lambda: session.playing.write(Path(self._out.value.strip()))
            )
        self._errors = gui.add_markdown("")

    def shows(self, motion: TrialMotion | None) -> bool:
        """Whether it is the one begun last, or with None whether there is none."""
        return self._begun is motion

    def begin(self) -> None:
        """A motion has come, or has gone."""
        self._begun = motion = self._session.playing.motion
        self._pause.disabled = self._scrub.disabled = motion is None
        self.playing, self.frame, self._time = motion is not None, 0, 0.0
        if motion is not None:
            self._scrub.max = max(1, len(motion.times) - 1)
        self._pause.label = "Pause"
        self._text.content = self._scale.content = ""
        if motion is not None and motion.largest is not None:
            self._scale.content = scale_bar(max(LEAST_SCALE, motion.largest), "measured point to the shown surface")

    def show_errors(self) -> None:
        self._errors.content = markdown(errors_table(self._session.trial_errors.by_label))

    def advance(self, seconds: float) -> bool:
        """Let it play for so long; whether another frame is due."""
        motion = self._session.playing.motion
        if motion is None or not self.playing:
            return False
        first, last = float(motion.times[0]), float(motion.times[-1])
        self._time = self._time + seconds if self._time + seconds <= last - first + 0.5 else 0.0
        frame = min(int((motion.times <= first + self._time + 1e-9).sum()) - 1, len(motion.times) - 1)
        moved, self.frame = frame != self.frame, max(frame, 0)
        return moved

    def show(self) -> None:
        motion = self._session.playing.motion
        if motion is not None:
            put(self._scrub, self.frame)
            beside = "" if motion.ghost(self.frame) is None else "; orange: without the corrector"
            self._text.content = markdown(motion.in_words(self.frame) + beside)

    def _toggle(self) -> None:
        self.playing = not self.playing
        self._pause.label = "Pause" if self.playing else "Play"

    def _scrubbed(self, frame: float) -> None:
        motion = self._session.playing.motion
        if motion is not None:
            self.playing, self._pause.label = False, "Play"
            self.frame = min(int(frame), len(motion.times) - 1)
            self._time = float(motion.times[self.frame] - motion.times[0])
            self._session.view.show_motion()

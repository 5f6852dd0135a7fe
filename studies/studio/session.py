"""One sitting: the layout under edit and what follows from it. One thread owns it, the page asks through a queue."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from fabdesign.errors import InputError
from fabdesign.forward import RISE
from fabdesign.mark import read_mark
from fabdesign.pressure import PressureProgram, require_pressures, rising_program
from fabdesign.pressure_file import read_pressures
from studies.predict import frame_times
from studies.studio.autosave import Autosave, Watched
from studies.studio.document import Document
from studies.studio.layout import Layout, Point, move_corner, move_muscle
from studies.studio.limits import Broken, broken_limits
from studies.studio.live import Live, LiveShape, Solves
from studies.studio.measured import TrialMotion, labels
from studies.studio.model_choice import ModelChoice
from studies.studio.opening import Opened, search_limits
from studies.studio.saving import Saved, Saving
from studies.studio.searching import Search, Vary, next_folder, require_searchable
from studies.studio.snapping import row_distance, snapped
from studies.studio.solver import Answer, Ask
from studies.studio.target import Comparison, ShownTarget, compare

CALM = 0.35  # s without a further value, after which a slider counts as let go
AUTOSAVE = 1.0  # s between autosaves at least
FRAME_RATE = 30.0  # Hz, of a motion that is played


class SessionView(Protocol):
    """What shows a session. Called on the session's thread."""

    def show_layout(self) -> None: ...

    def show_shape(self, shape: LiveShape) -> None: ...

    def show_comparison(self) -> None: ...

    def show_motion(self) -> None: ...

    def show_search(self, message: str, *, running: bool) -> None: ...

    def tell(self, text: str, *, bad: bool = False) -> None: ...


class Session:
    """The layout, its model, target, search and motion. Every change goes through a method here."""

    def __init__(self, opened: Opened, solver: Solves, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.opened, self._clock = opened, clock
        self.document = Document(opened.layout)
        self.choice = ModelChoice.of(opened.model)
        self.limits, self.target = opened.limits, opened.target
        self.snap, self.rows = False, row_distance(opened.layout.design)
        self.selected: int | None = 0 if opened.layout.design.muscles else None
        self.shape: LiveShape | None = None
        self.comparison: Comparison | None = None
        self.motion: TrialMotion | None = None
        self.search: Search | None = None
        self.folder = _folder(opened)
        self.view: SessionView
        self._saving, self._autosave = Saving(), Autosave(opened.file)
        self._autosaves = True  # until one fails
        self._watched = Watched(opened.file)
        self._live = Live(solver, self._shown, self._failed)
        self._touched = self._autosaved = self._clock()
        self._dragged: Layout | None = None  # where a drag of a whole muscle began
        self._searched: Layout | None = None  # the last layout that a search moved in

    @property
    def layout(self) -> Layout:
        return self.document.layout

    @property
    def trials(self) -> list[str]:
        return list(labels(self.opened.measured.trials)) if self.opened.measured else []

    @property
    def _moving(self) -> bool:
        """Whether a hand is in the middle of a gesture; a search that moves its best in is none."""
        return self.document.in_gesture and not (self.searching and self._searched == self.layout)

    def broken(self) -> list[Broken]:
        return broken_limits(self.layout, self.limits)

    # a beginning, and what goes on meanwhile

    def begin(self, view: SessionView) -> None:
        """Restore what was left, and ask for the first shape."""
        self.view = view
        left = self._autosave.read(self.layout.design)
        if left is not None and left[0] != self.layout:
            layout, same_file = left
            if same_file:
                self.document.do("restored changes", layout)
                view.tell("Unsaved changes of the last time are restored; undo takes them away.")
            else:
                self.document.offer("restored changes", layout)
                view.tell("The file has changed since the last time; redo brings the unsaved changes back.", bad=True)
        self._changed()

    def tick(self) -> None:
        """Whatever is due: shapes, the end of a gesture, autosave, the file, a search."""
        now = self._clock()
        if self._moving and self._dragged is None and now - self._touched > CALM:
            self.document.end()
            self._changed()
        self._live.turn()
        if now - self._autosaved > AUTOSAVE:
            self._autosaved = now
            self._keep()
            self._follow_file()
            self._follow_search()

    def _keep(self) -> None:
        try:
            if self.document.changed and self._autosaves:
                self._autosave.write(self.layout)
            elif not self.document.changed:
                self._autosave.clear()
        except InputError as error:
            if self._autosaves:
                self.view.tell(f"no autosave: {error}", bad=True)
            self._autosaves = False

    def _follow_file(self) -> None:
        if not self._watched.changed():
            return
        if self.document.changed:
            self.view.tell(
                f"{self.opened.file.name} was changed by another program; 'Load from disk' takes it.", bad=True
            )
            return
        self.load_again()

    # changes of the layout

    def edit(self, what: str, change: Callable[[Layout], Layout]) -> None:
        """One step. What is refused is told."""
        try:
            self.document.do(what, change(self.layout))
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        self._changed()

    def drag(self, what: str, layout: Layout, *, last: bool = False) -> None:
        """A moment of a gesture."""
        self.document.shape(what, layout)
        self._touched = self._clock()
        if last:
            self.document.end()
        self._changed()

    def select(self, index: int) -> None:
        self.selected = index
        self.view.show_layout()

    def drag_corner(self, index: int, corner: int, to: Point, *, last: bool) -> None:
        if index >= len(self.layout.design.muscles) or corner >= len(self.layout.design.muscles[index].path):
            return  # gone meanwhile, in another tab
        self._dragged = None if last else self.layout
        layout = move_corner(self.layout, index, corner, self._snapped(to))
        self.drag(f"move a corner of muscle {index}", layout, last=last)

    def drag_muscle(self, index: int, by: Point, *, last: bool) -> None:
        if index >= len(self.layout.design.muscles):
            return
        start = self._dragged or self.layout
        if self.snap:
            by = (self.rows * round(by[0] / self.rows), self.rows * round(by[1] / self.rows))
        layout = move_muscle(start, index, by)
        self._dragged = None if last else start
        self.drag(f"move muscle {index}", layout, last=last)

    def _snapped(self, to: Point) -> Point:
        fabric = self.layout.design.fabric
        return snapped(to, (fabric.width, fabric.height), self.rows) if self.snap else to

    def press(self, channel: int, pressure: float) -> None:
        """A slider's value, Pa: a gesture until it is left alone."""
        if channel < len(self.layout.pressures):
            self.drag(f"pressure of channel {channel}", self.layout.with_pressure(channel, pressure))

    def undo(self) -> None:
        self._moved("undone", self.document.undo())

    def redo(self) -> None:
        self._moved("done again", self.document.redo())

    def _moved(self, how: str, what: str | None) -> None:
        if what is not None:
            self._dragged = None
            self._changed()
            self.view.tell(f"{how}: {what}")

    def _changed(self) -> None:
        count = len(self.layout.design.muscles)
        if self.selected is None or self.selected >= count:
            self.selected = count - 1 if count else None
        self.motion = None
        self._live.want(self.layout, self.choice.model, moving=self._moving)
        self.view.show_layout()

    # the shape

    def _shown(self, shape: LiveShape) -> None:
        self.shape = shape
        self.comparison = None
        if shape.exact and self.target is not None:
            self.comparison = compare(self.target, shape.points, shape.layout.design)
        self.view.show_shape(shape)
        self.view.show_comparison()

    def _failed(self, reason: str) -> None:
        self.view.tell(reason, bad=True)

    def choose(self, choice: ModelChoice) -> None:
        self.choice = choice
        self._changed()

    # target and search

    def set_target(self, read: Callable[[], ShownTarget | None]) -> None:
        try:
            self.target = read()
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        if self.shape is not None:
            self._shown(self.shape)

    @property
    def searching(self) -> bool:
        return self.search is not None

    def start_search(self, vary: Vary, seconds: float) -> None:
        """From here, in the background; its best so far moves in."""
        if self.search is not None or self.target is None:
            self.view.tell("a search is running" if self.search else "no target; expected one to search for", bad=True)
            return
        try:
            require_searchable(self.layout, vary)
            self.document.end()
            limits = self.limits if self.opened.target is not None else search_limits(self.layout.design)
            model = self.opened.model_file if self.choice.fitted else None
            self.search = Search(
                next_folder(self.folder), self.layout, self.target, limits, vary=vary, seconds=seconds, model=model
            )
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        self._searched = self.layout
        self.view.show_search(f"searching in {self.search.folder.name}, the first evaluations", running=True)

    def stop_search(self) -> None:
        if self.search is not None:
            self.search.stop()
            self.view.show_search("stopping, with the best so far", running=True)

    def _follow_search(self) -> None:
        if self.search is None:
            return
        running = self.search.running  # before the result is read: what it wrote last is not missed
        found = self.search.best()
        if found is not None:
            message = f"{1e3 * found.objective:.2f} mm after {found.evaluations} evaluations"
            if self._searched == self.layout:
                self.document.shape("search", found.layout)
                self._searched = found.layout
                self._changed()
            else:
                message += "; edited meanwhile, so the best does not move in: open it from its folder"
            self.view.show_search(f"{message}; {found.stop_reason}", running=running)
        if not running:
            problem, folder = self.search.problem, self.search.result
            self.search.close()
            self.search = None
            if self._searched == self.layout:
                self.document.end()
                self._changed()
            self.view.show_search(problem or f"kept in {folder}", running=False)
            if problem:
                self.view.tell(problem, bad=True)

    # motions

    def play_rise(self) -> None:
        """The motion to the pressures as they are: they rise within 1 s, and hold for 1 s."""
        self._play("rise", rising_program(np.array(self.layout.pressures), RISE, RISE + 1.0))

    def play_file(self, path: Path) -> None:
        try:
            self._play(path.name, read_pressures(path, self.layout.design))
        except InputError as error:
            self.view.tell(str(error), bad=True)

    def play_opened(self) -> None:
        """The pressures that were given on the command line."""
        if (program := self.opened.program) is not None:
            try:
                require_pressures(program, self.layout.design, "pressures")
                self._play("pressures", program)
            except InputError as error:
                self.view.tell(str(error), bad=True)

    def _play(self, name: str, program: PressureProgram) -> None:
        if not self.layout.pressures:
            self.view.tell("no muscles; expected some that move the cloth", bad=True)
            return
        times = frame_times(program, frame_rate=FRAME_RATE)
        self.document.end()
        ask = Ask(0, "motion", self.layout.design, program, self.choice.model, times)
        self._ask_motion(ask, lambda answer: TrialMotion(name, times, _points(answer)))

    def show_trial(self, label: str) -> None:
        """A trial of the set, measured, and its prediction under the model that is chosen."""
        assert self.opened.measured is not None
        trial = labels(self.opened.measured.trials)[label]
        try:
            data = trial.load()
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        if trial.design != self.layout.design:
            self.document.do(f"design of {trial.name}", Layout.of(trial.design))
            self._changed()
        program = trial.program
        ask = Ask(0, "motion", trial.design, program, self.choice.model, trial.times, trial.order, sensing=True)
        self._ask_motion(ask, lambda answer: TrialMotion(label, trial.times, _points(answer), data))

    def _ask_motion(self, ask: Ask, motion: Callable[[Answer], TrialMotion]) -> None:
        def arrived(answer: Answer) -> None:
            if answer.points is None:
                self._failed(answer.error or "no motion")
                return
            self.motion = motion(answer)
            self.view.show_motion()

        self.view.tell(f"computing {len(ask.times) if ask.times is not None else 0} frames")
        self._live.also(ask, arrived)

    # files

    def save(self, folder: Path, *, replace: bool = False) -> Saved | None:
        """What was written; None where it was not, and was told."""
        self.document.end()
        model = self.opened.model_file if self.choice.fitted else None
        self._autosave.clear()  # it may lie in the folder, where no other files may be
        try:
            saved = self._saving.save(
                self.layout, folder, target=self.target, limits=self.limits, model=model, replace=replace
            )
        except InputError as error:
            self._keep()
            self.view.tell(str(error), bad=True)
            return None
        self.folder = folder
        self.document.keep()
        if (folder / "design.toml").resolve() == self.opened.file.resolve():
            self._watched.seen()
        message = f"saved {len(saved.files)} files in {folder}"
        self.view.tell("; ".join([message, *saved.left_out]))
        self.view.show_layout()
        return saved

    def would_replace(self, folder: Path) -> str | None:
        return self._saving.replaces(folder)

    def load_again(self) -> None:
        """Take the design as it is on disk now; undo brings back what was here."""
        try:
            design = self._watched.read()
        except InputError as error:
            self.view.tell(f"changed on disk, and not taken: {error}", bad=True)
            return
        self.document.do("load from disk", Layout.of(design, self.layout.pressures))
        self.document.keep()
        self._changed()
        self.view.tell(f"{self.opened.file.name} was taken from disk; undo brings back what was here.")

    def end(self) -> None:
        """Leave: unsaved changes stay in the autosave, a search ends with its best."""
        self.document.end()
        self._keep()
        if self.search is not None:
            self.search.close()


def _points(answer: Answer) -> np.ndarray:
    assert answer.points is not None
    return answer.points


def _folder(opened: Opened) -> Path:
    """Where it is saved unless another place is typed: the folder of a design that was saved like that, else a new one
    beside the file."""
    mark = read_mark(opened.file.parent)
    if opened.file.name == "design.toml" and mark is not None and mark.made_by == "studio":
        return opened.file.parent
    return opened.file.with_name(f"{opened.file.stem}_studio")

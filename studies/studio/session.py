"""One sitting: the layout under edit and what follows from it. One thread owns it, the page asks through a queue."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.forward import RISE
from fabdesign.output import read_mark
from fabdesign.pressure import PressureProgram, require_pressures, rising_program
from fabdesign.pressure_file import read_pressures
from fabdesign.trial import Trial
from studies.predict import frame_times
from studies.studio.autosave import Autosave, Watched
from studies.studio.band import Band
from studies.studio.document import Document
from studies.studio.exporting import export_motion, require_kind
from studies.studio.layout import Layout, Point, move_corner, move_muscle
from studies.studio.limits import Broken, broken_limits
from studies.studio.live import Live, LiveShape, Solves
from studies.studio.measured import TrialMotion, labels
from studies.studio.model_choice import ModelChoice
from studies.studio.opening import Opened, search_limits
from studies.studio.results import Result, Row, Seen
from studies.studio.saving import Saved, Saving
from studies.studio.searching import Search, Vary, next_folder, require_searchable
from studies.studio.snapping import row_distance, snapped
from studies.studio.solver import Answer, Ask
from studies.studio.target import Comparison, ShownTarget, compare
from studies.studio.trial_errors import TrialErrors, ask_of_trial

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

    def show_results(self) -> None: ...

    def show_band(self) -> None: ...

    def show_trial_errors(self) -> None: ...

    def tell(self, text: str, *, bad: bool = False) -> None: ...


class Session:
    """The layout, its model, target, search and motion. Every change goes through a method here."""

    def __init__(self, opened: Opened, solver: Solves, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.opened, self._clock = opened, clock
        self.document = Document(opened.layout)
        self.choice = ModelChoice.of(opened.model)
        self.limits, self.targets, self.pose = opened.limits, list(opened.targets), 0
        self._pose_pressures: dict[int, tuple[float, ...]] = {}  # of the poses that are not shown
        self.snap, self.row_distance = False, row_distance(opened.layout.design)
        self.selected: int | None = 0 if opened.layout.design.muscles else None
        self.shape: LiveShape | None = None
        self.own = Seen()  # of the own drawing
        self.results: list[Result] = []
        self.result: Result | None = None  # that is shown; None: the own drawing
        self.beside = True  # whether another drawing is shown beside
        self.band: Band | None = None
        self._around: list[NDArray[np.float32]] = []  # shapes of which a band is made
        self._asked = 0  # counts what is asked for bands
        self.motion: TrialMotion | None = None
        self._played: Ask | None = None  # what `motion` answers
        self.search: Search | None = None
        self._searched: Result | None = None  # what the search finds
        self.folder = _folder(opened)
        self.view: SessionView
        self._saving, self._autosave = Saving(), Autosave(opened.file)
        self._autosaves = True  # until one fails
        self._watched = Watched(opened.file)
        self._live = Live(solver, self._shown, self._failed)
        self.trial_errors = TrialErrors(self, self._live)
        self._touched = self._autosaved = self._clock()
        self._dragged: Layout | None = None  # where a drag of a whole muscle began
        self._broken: tuple[Layout, list[Broken]] | None = None

    @property
    def layout(self) -> Layout:
        """What is shown: the own drawing, or a search's result."""
        return self.document.layout if self.result is None else self.result.layout(self.pose)

    @property
    def target(self) -> ShownTarget | None:
        """Of the pose that is shown."""
        return self.targets[self.pose] if self.targets else None

    @property
    def seen(self) -> Seen:
        return self.own if self.result is None else self.result

    @property
    def comparison(self) -> Comparison | None:
        return self.seen.comparison

    @property
    def trials(self) -> list[str]:
        return list(labels(self.opened.measured.trials)) if self.opened.measured else []

    @property
    def _moving(self) -> bool:
        """Whether a hand is in the middle of a gesture."""
        return self.document.in_gesture and self.result is None

    def broken(self) -> list[Broken]:
        """Worked out once for each layout."""
        if self._broken is None or self._broken[0] is not self.layout:
            self._broken = self.layout, broken_limits(self.layout, self.limits)
        return self._broken[1]

    @property
    def waiting(self) -> bool:
        """Whether the simulator computes, or is to."""
        return not self._live.at_rest

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
                self._autosave.write(self.document.layout)
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
        self.take()
        try:
            self.document.do(what, change(self.layout))
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        self._changed()

    def drag(self, what: str, layout: Layout, *, last: bool = False) -> None:
        """A moment of a gesture."""
        self.take()
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
            rows = self.row_distance
            by = (rows * round(by[0] / rows), rows * round(by[1] / rows))
        layout = move_muscle(start, index, by)
        self._dragged = None if last else start
        self.drag(f"move muscle {index}", layout, last=last)

    def _snapped(self, to: Point) -> Point:
        fabric = self.layout.design.fabric
        return snapped(to, (fabric.width, fabric.height), self.row_distance) if self.snap else to

    def press(self, channel: int, pressure: float) -> None:
        """A slider's value, Pa: a gesture until it is left alone."""
        if channel < len(self.layout.pressures):
            self.drag(f"pressure of channel {channel}", self.layout.with_pressure(channel, pressure))

    def undo(self) -> None:
        self.result = None
        self._moved("undone", self.document.undo())

    def redo(self) -> None:
        self.result = None
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
        self.motion = self.band = None
        self.trial_errors.stop()
        self._asked += 1
        self._live.drop(self._band_arrived)
        time = None if self.target is None else self.target.loaded.time
        self._live.want(self.layout, self.choice.model, moving=self._moving, time=time)
        self._live.turn()  # so that the simulator computes while the page is drawn
        self.view.show_layout()

    # the shape

    def _shown(self, shape: LiveShape) -> None:
        self.shape = shape
        if shape.layout == self.layout:
            self.seen.forget()
            if shape.exact:
                self._keep_exact(shape)
        self.view.show_shape(shape)
        self.view.show_comparison()

    def _keep_exact(self, shape: LiveShape) -> None:
        self.seen.shape = shape
        if self.target is not None:
            self.seen.comparison = compare(self.target, shape.points, shape.layout.design)
            self.view.show_results()
        if self.bands:
            self._around = []
            for one in self.choice.around:
                ask = Ask.at_rest(self._asked, "nearby", shape.layout.design, shape.layout.pressures, one)
                self._live.also(ask, self._band_arrived)

    def _band_arrived(self, answer: Answer) -> None:
        """One more of the shapes around the one that is shown; with the last there is a band."""
        if answer.number != self._asked or answer.points is None:
            return
        self._around.append(answer.points)
        if len(self._around) == len(self.choice.around):
            self.band = Band.of(self._around)
            self.view.show_band()

    def _failed(self, reason: str) -> None:
        self.view.tell(reason, bad=True)

    def choose(self, choice: ModelChoice) -> None:
        self.choice = choice
        self.trial_errors.clear()
        for seen in (self.own, *self.results):
            seen.forget()
        self._changed()

    # target and search

    def set_target(self, read: Callable[[], ShownTarget | None]) -> None:
        """In the place of the pose that is shown."""
        try:
            target = read()
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        self.targets[self.pose : self.pose + 1] = [] if target is None else [target]
        self.pose = min(self.pose, max(len(self.targets) - 1, 0))
        self._compare_again()

    def show_pose(self, pose: int) -> None:
        """Another of the study's targets, with its own pressures of the same layout."""
        if pose == self.pose or not 0 <= pose < len(self.targets):
            return
        self.document.end()
        self._pose_pressures[self.pose] = self.document.layout.pressures
        self.pose = pose
        design = self.document.layout.design
        pressures = self._pose_pressures.pop(pose, self.document.layout.pressures)
        self.document.do(f"pose {pose}", Layout.of(design, pressures))
        self._compare_again()

    def _compare_again(self) -> None:
        """The target is another one; a shape that is there is not computed again."""
        for seen in (self.own, *self.results):
            seen.forget()
        self._changed()
        if self.shape is not None and self.shape.layout == self.layout and self._live.at_rest:
            self._shown(self.shape)

    @property
    def pose_pressures(self) -> list[tuple[float, ...]]:
        """Pa, of every pose, for the layout that is shown."""
        if self.result is not None:
            return [layout.pressures for layout in self.result.layouts]
        layout = self.document.layout
        own = {**self._pose_pressures, self.pose: layout.pressures}
        return [
            Layout.of(layout.design, own.get(pose, layout.pressures)).pressures
            for pose in range(max(len(self.targets), 1))
        ]

    @property
    def searching(self) -> bool:
        return self.search is not None

    def start_search(self, vary: Vary, seconds: float) -> None:
        """From here, in the background; what it finds is a drawing of its own, in which the best so far moves in."""
        if self.search is not None or not self.targets:
            self.view.tell("a search is running" if self.search else "no target; expected one to search for", bad=True)
            return
        try:
            require_searchable(self.layout, vary)
            self.document.end()
            limits = self.limits if self.opened.targets else search_limits(self.layout.design)
            model = self.opened.model_file if self.choice.fitted else None
            self.search = Search(
                next_folder(self.folder), self.layout, self.targets, limits, vary=vary, seconds=seconds, model=model
            )
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        number = self.search.folder.name.rpartition("_")[2]
        begun = tuple(Layout.of(self.layout.design, pressures) for pressures in self.pose_pressures)
        result = Result(name=f"search {number}: {vary}", begun=begun[0], layouts=begun, state="searching")
        self.results.append(result)
        self._searched = result
        self.show_result(result)
        self.view.show_search(f"searching in {self.search.folder.name}, the first evaluations", running=True)

    def stop_search(self) -> None:
        if self.search is not None:
            self.search.stop()
            self.view.show_search("stopping, with the best so far", running=True)

    def _follow_search(self) -> None:
        if self.search is None or self._searched is None:
            return
        result = self._searched
        running = self.search.running  # before the result is read: what it wrote last is not missed
        found = self.search.best()
        if found is not None:
            result.found(found.layouts, found.objective)
            of = "" if len(self.targets) == 1 else f", mean of {len(self.targets)} poses,"
            figure = f"{1e3 * found.objective:.2f} mm{of} after {found.evaluations} evaluations"
            result.state = f"{figure}; {found.stop_reason}"
            self.view.show_search(result.state, running=running)
            self._result_changed(result)
        if not running:
            problem, folder = self.search.problem, self.search.result
            self.search.close()
            self.search = self._searched = None
            self.view.show_search(problem or f"kept in {folder}", running=False)
            if problem:
                result.state = problem
                self.view.tell(problem, bad=True)
            self.view.show_results()

    # results beside the own drawing

    def _result_changed(self, result: Result) -> None:
        if self.result is result:
            self._changed()
        self.view.show_results()

    def show_result(self, result: Result | None) -> None:
        """In place of what is shown; None: the own drawing."""
        self.document.end()
        self.result = result if result in self.results else None
        self._changed()
        self.view.show_results()

    def take(self) -> None:
        """The result that is shown becomes the own drawing, as a step that can be undone; an edit does so too."""
        if self.result is None:
            return
        result, self.result = self.result, None
        self.document.do(f"take {result.name}", result.layout(self.pose))
        for pose, layout in enumerate(result.layouts):
            if pose != self.pose:
                self._pose_pressures[pose] = layout.pressures
        self.own.shape, self.own.comparison = result.shape, result.comparison
        self._changed()
        self.view.show_results()

    @property
    def bands(self) -> bool:
        """Whether the model's intervals make a band around exact shapes at rest."""
        return bool(self.choice.around) and (self.target is None or self.target.loaded.time is None)

    def other(self) -> tuple[Layout, Seen] | None:
        """The drawing that is shown beside: the own one beside a result, the last result beside the own one."""
        if not self.beside:
            return None
        if self.result is not None:
            return self.document.layout, self.own
        return (self.results[-1].layout(self.pose), self.results[-1]) if self.results else None

    def set_beside(self, on: bool) -> None:
        self.beside = on
        self.view.show_layout()
        self.view.show_comparison()

    def rows(self) -> list[Row]:
        """Of the table that compares the own drawing with the results."""
        own = Row.of("own drawing", self.document.layout, self.own, shown=self.result is None)
        alone = len(self.targets) == 1  # else a search's objective is a mean over poses
        return [own] + [
            Row.of(r.name, r.layout(self.pose), r, shown=self.result is r, objective=r.objective if alone else None)
            for r in self.results
        ]

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
        self._ask_motion(ask, lambda answer: TrialMotion(name, times, _points(answer), None, answer.correction))

    def show_trial(self, label: str) -> None:
        """A trial of the set, measured, and its prediction under the model that is chosen."""
        try:
            trial, data, ask = ask_of_trial(self.trial(label), self.choice.model)
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        if trial.design != self.layout.design:
            self.result = None
            self.document.do(f"design of {trial.name}", Layout.of(trial.design))
            self._changed()

        def motion(answer: Answer) -> TrialMotion:
            self.trial_errors.found(label, answer)
            return TrialMotion(label, trial.times, _points(answer), data, answer.correction)

        self._ask_motion(ask, motion)

    def trial(self, label: str) -> Trial:
        assert self.opened.measured is not None
        return labels(self.opened.measured.trials)[label]

    def _ask_motion(self, ask: Ask, motion: Callable[[Answer], TrialMotion]) -> None:
        def arrived(answer: Answer) -> None:
            if answer.points is None:
                self._failed(answer.error or "no motion")
                return
            self.motion, self._played = motion(answer), ask
            self.view.show_motion()

        self.view.tell(f"computing {len(ask.times) if ask.times is not None else 0} frames")
        self._live.also(ask, arrived)

    def write_motion(self, path: Path) -> None:
        """The motion that is played, for another program."""
        motion, ask = self.motion, self._played
        if motion is None or ask is None:
            self.view.tell("no motion; expected one that is played", bad=True)
            return

        def arrived(answer: Answer) -> None:
            try:
                if answer.laced is None:
                    raise InputError(answer.error or "no motion")
                export_motion(path, motion, answer.laced)
            except InputError as error:
                self.view.tell(str(error), bad=True)
                return
            self.view.tell(f"wrote {path}")

        try:
            require_kind(path)
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        self.view.tell(f"writing {path}")
        self._live.also(replace(ask, kind="laced", measured=()), arrived)

    # files

    def save(self, folder: Path, *, replace: bool = False) -> Saved | None:
        """What was written; None where it was not, and was told."""
        self.document.end()
        model = self.opened.model_file if self.choice.fitted else None
        self._autosave.clear()  # it may lie in the folder, where no other files may be
        try:
            saved = self._saving.save(
                self.layout, folder, targets=self.targets, poses=self.pose_pressures, limits=self.limits, model=model,
                replace=replace,
            )  # fmt: skip
        except InputError as error:
            self._keep()
            self.view.tell(str(error), bad=True)
            return None
        self.folder = folder
        if self.result is None:
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
        self.result = None
        self.document.do("load from disk", Layout.of(design, self.document.layout.pressures))
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

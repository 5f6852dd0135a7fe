"""The document of a sitting: the drawing under edit, its targets, results of searches, the model, what is selected."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from fabdesign.nouns.trial import Trial
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.units import in_mm
from studies.layout_search.target import LoadedTarget, load_target
from studies.studio import layout as edits
from studies.studio.drawings import DrawingHistory, Result
from studies.studio.layout import Broken, Layout, Point
from studies.studio.model_choice import ModelChoice
from studies.studio.opening import Opened


class Document:
    """The design that a person edits, and what of it is shown. One thread owns it; the page asks through a queue.

    history: the own drawing. targets: one for each pose; none where nothing is aimed at. shown: a result of a search;
    None: the own drawing. broken: the limits that what is shown breaks. beside: whether another drawing is shown
    beside. gizmo: whether the target has one. message: what was told last, and whether it is bad news. listeners:
    called when what is shown, its model or its target is another one. show: draws the page."""

    def __init__(self, opened: Opened, clock: Callable[[], float]) -> None:
        self.opened, self.limits, self._clock = opened, opened.limits, clock
        self.history, self.choice = DrawingHistory(opened.layout), ModelChoice.of(opened.model)
        self.targets, self.results = list(opened.targets), list[Result]()
        self.shown: Result | None = None
        self.broken: list[Broken] = []
        self.beside, self.gizmo = True, False
        self.snap, self.row_distance = False, edits.row_distance(opened.layout.design)
        self.selected: int | None = 0 if opened.layout.design.muscles else None
        self.message = "", False
        self.listeners: list[Callable[[], None]] = []
        self.show: Callable[[], None] = lambda: None
        self._touched = clock()
        self._dragged: Layout | None = None  # where a drag of a whole muscle began

    # what is shown

    @property
    def seen(self) -> DrawingHistory | Result:
        """Return the drawing that is shown."""
        return self.shown or self.history

    @property
    def pose(self) -> int:
        return self.history.layout.pose

    @property
    def layout(self) -> Layout:
        return self.seen.at(self.pose)

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """Return one layout for each pose."""
        return tuple(self.seen.at(pose) for pose in range(max(len(self.targets), 1)))

    @property
    def target(self) -> LoadedTarget | None:
        """Return the target of the pose that is shown."""
        return self.targets[self.pose] if self.targets else None

    @property
    def model_file(self) -> Path | None:
        """Return the model's file where it is the one that holds."""
        return self.opened.model_file if self.choice.fitted else None

    @property
    def trials(self) -> dict[str, Trial]:
        """Return the trials of the set that was opened, by a name for each."""
        trials = self.opened.measured.trials if self.opened.measured else ()
        return {f"{trial.name} ({trial.design_name}, {trial.role})": trial for trial in trials}

    @property
    def other(self) -> DrawingHistory | Result | None:
        """Return the drawing that is shown beside: the own one beside a result, the last result beside the own one."""
        if not self.beside:
            return None
        return self.history if self.shown is not None else next(reversed(self.results), None)

    def errors_of(self, drawing: DrawingHistory | Result) -> tuple[float | None, float | None]:
        """Return Chamfer and surface RMS [m] of the own drawing or a result; None: not known yet. Until a shape was
        seen, Chamfer is what the search says; over several poses that is a mean, and not said."""
        if (comparison := drawing.comparison) is not None:
            return comparison.errors.chamfer, comparison.errors.surface_rms
        return drawing.objective if len(self.targets) == 1 else None, None

    def one_more_buys(self, result: Result) -> str | None:
        """Return in words what one more muscle buys, against the best with the muscles that the search began with,
        searched or, where it is measured as a search does, drawn; None where the result has no more of them, or nothing
        is there to compare it with."""
        drawn, count = self.history, len(result.begun.design.muscles) if result.begun else result.muscles
        rivals = [(other.objective, other.muscles, other.name) for other in self.results if other is not result]
        if len(self.targets) == 1:
            rivals.append((self.errors_of(drawn)[0], len(drawn.layout.design.muscles), drawn.name))
        known = [(objective, name) for objective, muscles, name in rivals if objective is not None and muscles == count]
        if result.objective is None or result.muscles <= count or not known:
            return None
        before, name = min(known)
        less = in_mm(before - result.objective)
        change = f"{less:.2f} mm less" if less >= 0 else f"{-less:.2f} mm more"
        searched = "; for a fair comparison search from here without one more as well" if name == drawn.name else ""
        return (
            f"One more muscle: Chamfer {in_mm(result.objective):.2f} mm with {result.muscles} muscles, {change} than "
            f"{in_mm(before):.2f} mm with {count} ({name}){searched}."
        )

    # what is told

    def tell(self, text: str, *, bad: bool = False) -> None:
        self.message = text, bad
        self.show()

    def changed(self) -> None:
        """Say that what is shown, its model or its target is another one."""
        count = len(self.layout.design.muscles)
        if self.selected is None or self.selected >= count:
            self.selected = count - 1 if count else None
        self.broken = edits.broken_limits(self.layout, self.limits)
        for listener in reversed(self.listeners):  # the simulator was there first, and is asked last
            listener()
        self.show()

    # changes of the layout

    def put(self, what: str, layout: Layout) -> None:
        """Take another own drawing, in one step, whatever was shown."""
        self.shown = None
        self.history.do(what, layout)
        self.changed()

    def edit(self, what: str, change: Callable[[Layout], Layout]) -> None:
        """Take one step. Raises InputError where `change` does."""
        self.take()
        self.put(what, change(self.layout))

    def edit_muscle(self, what: str, change: Callable[..., Layout], *arguments: object) -> None:
        """Change the muscle that is selected: `change(layout, muscle, *arguments)`."""
        if (i := self.selected) is not None:
            self.edit(f"{what} of muscle {i}", lambda layout: change(layout, i, *arguments))

    def drag(self, what: str, layout: Layout, *, last: bool = False) -> None:
        """Go through a moment of a gesture."""
        self.take()
        self.history.shape(what, layout)
        self._touched = self._clock()
        if last:
            self.history.end()
        self.changed()

    def end_gesture(self, calm: float) -> None:
        """End a gesture without an end of its own, as of a slider, once nothing came for `calm` s."""
        if self.history.gesture and self._dragged is None and self._clock() - self._touched > calm:
            self.history.end()
            self.changed()

    def select(self, index: int) -> None:
        self.selected = index if index < len(self.layout.design.muscles) else None
        self.show()

    def set_option(self, name: Literal["snap", "row_distance", "beside", "gizmo"], value: float | bool) -> None:
        """Set how the layout is edited and shown."""
        setattr(self, name, value)
        self.show()

    def drag_corner(self, index: int, corner: int, to: Point, *, last: bool) -> None:
        design = self.layout.design
        if index >= len(design.muscles) or corner >= len(design.muscles[index].path):
            return  # removed meanwhile, in another tab
        self._dragged = None if last else self.layout
        if self.snap:
            to = edits.snapped(to, (design.fabric.width, design.fabric.height), self.row_distance)
        what = f"move {edits.point_name(design.muscles[index], corner)} {corner} of muscle {index}"
        self.drag(what, edits.move_corner(self.layout, index, corner, to), last=last)

    def drag_muscle(self, index: int, by: Point, *, last: bool) -> None:
        """Move a whole muscle `by` m since the drag began."""
        if index >= len(self.layout.design.muscles):
            return
        start, rows = self._dragged or self.layout, self.row_distance
        if self.snap:
            by = (rows * round(by[0] / rows), rows * round(by[1] / rows))
        self._dragged = None if last else start
        self.drag(f"move muscle {index}", edits.move_muscle(start, index, by), last=last)

    def press(self, channel: int, pressure: float) -> None:
        """Take a slider's value, Pa: a gesture until it is left alone."""
        if channel < len(self.layout.pressures):
            self.drag(f"pressure of channel {channel}", self.layout.with_pressure(channel, pressure))

    def step(self, by: int) -> None:
        """Undo (-1) or redo (1) one step."""
        if self.shown is not None:
            self.show_result(None)
        pose, what = self.pose, self.history.move(by)
        if what is None:
            return
        self._dragged = None
        (self.changed if self.pose == pose else self._forget)()
        self.tell(f"{'undone' if by < 0 else 'done again'}: {what}")

    # another drawing, model or target

    def show_result(self, result: Result | None) -> None:
        """Show a result in place of what is shown; None: the own drawing."""
        self.history.end()
        self.shown = result if result in self.results else None
        self.changed()

    def take(self) -> None:
        """Make the result that is shown the own drawing, as a step that can be undone; an edit does so too."""
        if (result := self.shown) is not None:
            self.shown = None
            self.history.do(f"take {result.name}", result.at(self.pose))
            self.history.live, self.history.comparison = result.live, result.comparison
            self.changed()

    def choose(self, choice: ModelChoice) -> None:
        """Take another model, or other effects."""
        self.choice = choice
        self._forget()

    def show_pose(self, pose: int) -> None:
        """Show another of the study's targets, with its own pressures of the same layout: one step."""
        if pose != self.pose and 0 <= pose < len(self.targets):
            self.history.do(f"pose {pose}", self.history.at(pose))
            self._forget()

    def open_target(self, file: TargetFile | None) -> None:
        """Put a target in the place of the pose that is shown; None takes it away, and the pose where there are
        others. Raises InputError."""
        target = None if file is None else load_target(file, self.layout.design)
        pose = self.pose
        self.targets[pose : pose + 1] = [] if target is None else [target]
        if target is None and self.targets:
            self.history.remove_pose(pose)
        self._forget()

    def place_target(self, rotation: tuple[float, ...], translation: tuple[float, ...]) -> None:
        """Place the target by hand. rotation: degrees about the fixed axes x, y, z in this order; translation: m."""
        if self.target is not None:
            a, b, c = (round(float(x), 3) for x in rotation)
            x, y, z = (round(float(x), 6) for x in translation)
            turned = (a, b, c) if any((a, b, c)) else None
            self.open_target(replace(self.target.file, rotation=turned, translation=(x, y, z), place="given"))

    def _forget(self) -> None:
        """Drop what was seen: it was under another model, or beside another target."""
        for seen in (self.history, *self.results):
            seen.forget()
        self.changed()

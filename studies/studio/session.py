"""One sitting: the layout under edit and what follows from it. One thread owns it, the page asks through a queue."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from fabdesign.errors import InputError
from fabdesign.trial import Trial
from studies.studio.background import BackgroundSearch
from studies.studio.document import Document
from studies.studio.drawings import Drawings
from studies.studio.keeping import Keeping
from studies.studio.layout import Layout, Point, move_corner, move_muscle, point_name
from studies.studio.limits import Broken, broken_limits
from studies.studio.live import LiveShape, Solves
from studies.studio.measured import labels
from studies.studio.model_choice import ModelChoice
from studies.studio.opening import Opened
from studies.studio.playing import Playing
from studies.studio.shapes import Shapes
from studies.studio.snapping import row_distance, snapped
from studies.studio.targets import Targets
from studies.studio.trial_errors import TrialErrors

CALM = 0.35  # s without a further value, after which a slider counts as let go
DUE = 1.0  # s between autosaves, and looks at the file and the search


class SessionView(Protocol):
    """What a session asks of the page that shows it, on the session's thread."""

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
    """The layout under edit, its model and limits. Beside it: `targets`, `drawings` (results of searches), `shapes`
    (from the simulator), `playing` (motions), `trial_errors`, `search`, `files`."""

    view: SessionView

    def __init__(self, opened: Opened, solver: Solves, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.opened, self._clock = opened, clock
        self.document = Document(opened.layout)
        self.choice = ModelChoice.of(opened.model)
        self.limits = opened.limits
        self.snap, self.row_distance = False, row_distance(opened.layout.design)
        self.selected: int | None = 0 if opened.layout.design.muscles else None
        self.targets = Targets(self, opened.targets)
        self.drawings = Drawings(self)
        self.shapes = Shapes(self, solver)
        self.playing = Playing(self)
        self.trial_errors = TrialErrors(self, self.shapes.also)
        self.search = BackgroundSearch(self)
        self.files = Keeping(self)
        self._touched = self._looked = self._clock()
        self._dragged: Layout | None = None  # where a drag of a whole muscle began
        self._broken: tuple[Layout, list[Broken]] | None = None

    @property
    def layout(self) -> Layout:
        """What is shown: the own drawing, or a search's result."""
        shown = self.drawings.shown
        return self.document.layout if shown is None else shown.layout(self.targets.pose)

    @property
    def model_file(self) -> Path | None:
        """Where it is the one that holds."""
        return self.opened.model_file if self.choice.fitted else None

    @property
    def trials(self) -> list[str]:
        return list(labels(self.opened.measured.trials)) if self.opened.measured else []

    def trial(self, label: str) -> Trial:
        assert self.opened.measured is not None
        return labels(self.opened.measured.trials)[label]

    @property
    def moving(self) -> bool:
        """Whether a hand is in the middle of a gesture."""
        return self.document.in_gesture and self.drawings.shown is None

    def broken(self) -> list[Broken]:
        """Worked out once for each layout."""
        if self._broken is None or self._broken[0] is not self.layout:
            self._broken = self.layout, broken_limits(self.layout, self.limits)
        return self._broken[1]

    # a beginning, and what goes on meanwhile

    def begin(self, view: SessionView) -> None:
        """Restore what was left, and ask for the first shape."""
        self.view = view
        self.files.restore()
        self.changed()

    def tick(self) -> None:
        """Whatever is due: shapes, the end of a gesture, autosave, the file, a search."""
        now = self._clock()
        if self.moving and self._dragged is None and now - self._touched > CALM:
            self.document.end()
            self.changed()
        self.shapes.turn()
        if now - self._looked > DUE:
            self._looked = now
            self.files.keep()
            self.files.follow_file()
            self.search.follow()

    def end(self) -> None:
        """Leave: unsaved changes stay in the autosave, a search ends with its best."""
        self.document.end()
        self.files.keep()
        self.search.close()

    # changes of the layout

    def edit(self, what: str, change: Callable[[Layout], Layout]) -> None:
        """One step. What is refused is told."""
        self.drawings.take()
        try:
            self.document.do(what, change(self.layout))
        except InputError as error:
            self.view.tell(str(error), bad=True)
            return
        self.changed()

    def drag(self, what: str, layout: Layout, *, last: bool = False) -> None:
        """A moment of a gesture."""
        self.drawings.take()
        self.document.shape(what, layout)
        self._touched = self._clock()
        if last:
            self.document.end()
        self.changed()

    def select(self, index: int) -> None:
        self.selected = index
        self.view.show_layout()

    def drag_corner(self, index: int, corner: int, to: Point, *, last: bool) -> None:
        if index >= len(self.layout.design.muscles) or corner >= len(self.layout.design.muscles[index].path):
            return  # gone meanwhile, in another tab
        self._dragged = None if last else self.layout
        layout = move_corner(self.layout, index, corner, self._snapped(to))
        name = point_name(layout.design.muscles[index], corner)
        self.drag(f"move {name} {corner} of muscle {index}", layout, last=last)

    def drag_muscle(self, index: int, by: Point, *, last: bool) -> None:
        """by: since the drag began."""
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
        self._move("undone", self.document.undo)

    def redo(self) -> None:
        self._move("done again", self.document.redo)

    def _move(self, how: str, move: Callable[[], str | None]) -> None:
        if self.drawings.shown is not None:
            self.drawings.show(None)
        pose, what = self.document.pose, move()
        if what is None:
            return
        self._dragged = None
        if self.document.pose == pose:
            self.changed()
        else:
            self.targets.compare_again()
        self.view.tell(f"{how}: {what}")

    def choose(self, choice: ModelChoice) -> None:
        """Another model, or other effects."""
        self.choice = choice
        self.trial_errors.clear()
        self.drawings.forget()
        self.changed()

    def changed(self) -> None:
        """What is shown, its model or its target is another one."""
        count = len(self.layout.design.muscles)
        if self.selected is None or self.selected >= count:
            self.selected = count - 1 if count else None
        self.playing.motion = None
        self.trial_errors.stop()
        self.shapes.follow()
        self.view.show_layout()

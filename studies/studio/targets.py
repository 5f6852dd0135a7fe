"""The targets of a sitting: one, or several poses of one layout, each with its own pressures."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from fabdesign.errors import InputError
from studies.studio.layout import Layout
from studies.studio.target import ShownTarget

if TYPE_CHECKING:
    from studies.studio.session import Session


class Targets:
    """all: one for each pose; none where the layout is drawn for its own sake."""

    def __init__(self, session: "Session", given: Sequence[ShownTarget]) -> None:
        self._session = session
        self.all = list(given)

    @property
    def pose(self) -> int:
        return self._session.document.pose

    @property
    def shown(self) -> ShownTarget | None:
        """Of the pose that is shown."""
        return self.all[self.pose] if self.all else None

    @property
    def pressures(self) -> list[tuple[float, ...]]:
        """Pa, of every pose, for the drawing that is shown."""
        session = self._session
        if session.drawings.shown is not None:
            return [layout.pressures for layout in session.drawings.shown.layouts]
        return [session.document.drawing.pressures(pose) for pose in range(max(len(self.all), 1))]

    def layouts(self) -> tuple[Layout, ...]:
        """One for each pose, of the drawing that is shown."""
        design = self._session.layout.design
        return tuple(Layout.of(design, pressures) for pressures in self.pressures)

    def open(self, read: Callable[[], ShownTarget | None]) -> None:
        """In the place of the pose that is shown; None takes it away, and the pose with it where there are others."""
        try:
            target = read()
        except InputError as error:
            self._session.view.tell(str(error), bad=True)
            return
        pose = self.pose
        self.all[pose : pose + 1] = [] if target is None else [target]
        if target is None and self.all:
            self._session.document.remove_pose(pose)
        self.compare_again()

    def show_pose(self, pose: int) -> None:
        """Another of the study's targets, with its own pressures of the same layout: one step."""
        if pose != self.pose and 0 <= pose < len(self.all):
            self._session.document.show_pose(pose)
            self.compare_again()

    def compare_again(self) -> None:
        """The target is another one."""
        self._session.drawings.forget()
        self._session.changed()
        self._session.shapes.show_again()

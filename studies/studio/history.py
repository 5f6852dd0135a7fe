"""The history of a drawing: what was before and after it, for undo and redo."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from studies.studio.layout import Layout

STEPS = 500  # that can be undone


@dataclass(frozen=True)
class DrawnLayout:
    """A layout with the pressures of the pose that is shown. others: (channels,) Pa of the poses that were shown
    before, by their numbers."""

    layout: Layout
    pose: int = 0
    others: tuple[tuple[int, tuple[float, ...]], ...] = ()

    def pressures(self, pose: int) -> tuple[float, ...]:
        """Return the pressures (channels,) Pa of a pose; of one that was never shown those of the one that is."""
        given = self.layout.pressures if pose == self.pose else dict(self.others).get(pose, self.layout.pressures)
        return Layout.of(self.layout.design, given).pressures

    def at(self, pose: int) -> "DrawnLayout":
        """Return the drawing with another pose shown."""
        others = {**dict(self.others), self.pose: self.layout.pressures}
        others.pop(pose, None)
        return DrawnLayout(Layout.of(self.layout.design, self.pressures(pose)), pose, tuple(sorted(others.items())))

    def without(self, pose: int) -> "DrawnLayout":
        """Return the drawing without a pose: those after it move up, and a neighbour is shown in place of it."""
        kept = self.at(pose - 1 if pose else 1) if pose == self.pose else self
        others = tuple((k - (k > pose), p) for k, p in kept.others if k != pose)
        return replace(kept, pose=kept.pose - (kept.pose > pose), others=others)

    def same_content(self, other: "DrawnLayout") -> bool:
        """Return whether design and pressures of every pose are the same, whichever pose is shown."""
        poses = {self.pose, other.pose, *dict(self.others), *dict(other.others)}
        return self.layout.design == other.layout.design and all(
            self.pressures(pose) == other.pressures(pose) for pose in poses
        )


class DrawingHistory:
    """A drawing under edit, with undo and redo. A gesture (a drag, one move of a slider) is one step, however many
    layouts it passes through."""

    def __init__(self, layout: Layout) -> None:
        self._past: list[tuple[str, DrawnLayout]] = []  # what was done, and the drawing before it
        self._future: list[tuple[str, DrawnLayout]] = []
        self._gesture: tuple[str, DrawnLayout] | None = None  # what is under way, and where it began
        self.drawing = DrawnLayout(layout)
        self._kept = self.drawing

    @property
    def layout(self) -> Layout:
        return self.drawing.layout

    @property
    def pose(self) -> int:
        return self.drawing.pose

    @property
    def changed(self) -> bool:
        """Return whether design or pressures are others than those last saved or opened."""
        return not self.drawing.same_content(self._kept)

    @property
    def in_gesture(self) -> bool:
        return self._gesture is not None

    def do(self, what: str, layout: Layout) -> None:
        """Take one step."""
        self.end()
        self._step(what, self.drawing, replace(self.drawing, layout=layout))

    def show_pose(self, pose: int) -> None:
        """Take one step to another pose of the same design."""
        self.end()
        self._step(f"pose {pose}", self.drawing, self.drawing.at(pose))

    def take(self, what: str, layouts: Sequence[Layout]) -> None:
        """Take one step to the layouts of another drawing, one for each pose."""
        self.end()
        others = tuple((k, layout.pressures) for k, layout in enumerate(layouts) if k != self.pose)
        shown = layouts[min(self.pose, len(layouts) - 1)]
        self._step(what, self.drawing, DrawnLayout(shown, self.pose, others))

    def remove_pose(self, pose: int) -> None:
        """Take a pose out of the drawing and of every step."""
        self.end()
        self.drawing, self._kept = self.drawing.without(pose), self._kept.without(pose)
        for steps in (self._past, self._future):
            steps[:] = [(what, drawing.without(pose)) for what, drawing in steps]

    def shape(self, what: str, layout: Layout) -> None:
        """Go through a moment of a gesture; another gesture ends where this one begins."""
        if self._gesture is None or self._gesture[0] != what:
            self.end()
            self._gesture = what, self.drawing
        self.drawing = replace(self.drawing, layout=layout)

    def end(self) -> None:
        """Make the gesture under way, if any, one step."""
        if self._gesture is not None:
            (what, before), self._gesture = self._gesture, None
            self._step(what, before, self.drawing)

    def _step(self, what: str, before: DrawnLayout, after: DrawnLayout) -> None:
        self.drawing = after
        if before != after:
            self._past = [*self._past[-STEPS + 1 :], (what, before)]
            self._future = []

    def undo(self) -> str | None:
        """Undo one step. Return its name, or None where there was none."""
        self.end()
        return self._move(self._past, self._future)

    def redo(self) -> str | None:
        """Redo one step. Return its name, or None where there was none."""
        self.end()
        return self._move(self._future, self._past)

    def _move(self, source: list[tuple[str, DrawnLayout]], goal: list[tuple[str, DrawnLayout]]) -> str | None:
        if not source:
            return None
        what, drawing = source.pop()
        goal.append((what, self.drawing))
        self.drawing = drawing
        return what

    @property
    def next_undo(self) -> str | None:
        return self._past[-1][0] if self._past else None

    def offer(self, what: str, layout: Layout) -> None:
        """Put a layout where redo finds it, before all else."""
        self._future.append((what, replace(self.drawing, layout=layout)))

    def keep(self) -> None:
        """Take the drawing as it is now for saved."""
        self.end()
        self._kept = self.drawing

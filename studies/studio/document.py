"""The layout that is edited, with what was before and after it."""

from studies.studio.layout import Layout

MOST = 500  # steps back


class Document:
    """A layout under edit, with undo and redo. A gesture (a drag, a slider's way) is one step, however many layouts it
    passes through."""

    def __init__(self, layout: Layout) -> None:
        self._past: list[tuple[str, Layout]] = []  # what was done, and the layout before it
        self._future: list[tuple[str, Layout]] = []
        self._gesture: tuple[str, Layout] | None = None  # what is under way, and where it began
        self.layout = layout
        self._kept = layout

    @property
    def changed(self) -> bool:
        """Whether the layout is another than the one last saved or opened."""
        return self.layout != self._kept

    @property
    def in_gesture(self) -> bool:
        return self._gesture is not None

    def do(self, what: str, layout: Layout) -> None:
        """One step."""
        self.end()
        self._step(what, self.layout, layout)

    def shape(self, what: str, layout: Layout) -> None:
        """A moment of a gesture; another one's end is the beginning of this."""
        if self._gesture is None or self._gesture[0] != what:
            self.end()
            self._gesture = what, self.layout
        self.layout = layout

    def end(self) -> None:
        """Let go: the gesture under way, if any, becomes one step."""
        if self._gesture is not None:
            (what, before), self._gesture = self._gesture, None
            self._step(what, before, self.layout)

    def _step(self, what: str, before: Layout, after: Layout) -> None:
        self.layout = after
        if before != after:
            self._past = [*self._past[-MOST + 1 :], (what, before)]
            self._future = []

    def undo(self) -> str | None:
        """What was undone, if anything was there."""
        self.end()
        return self._move(self._past, self._future)

    def redo(self) -> str | None:
        self.end()
        return self._move(self._future, self._past)

    def _move(self, source: list[tuple[str, Layout]], goal: list[tuple[str, Layout]]) -> str | None:
        if not source:
            return None
        what, layout = source.pop()
        goal.append((what, self.layout))
        self.layout = layout
        return what

    @property
    def next_undo(self) -> str | None:
        return self._past[-1][0] if self._past else None

    def offer(self, what: str, layout: Layout) -> None:
        """Put a layout where redo finds it, before all else."""
        self._future.append((what, layout))

    def keep(self) -> None:
        """The layout as it is now has been saved."""
        self.end()
        self._kept = self.layout

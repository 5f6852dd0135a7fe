"""The target: opened, placed by fit or by hand, compared, and searched for from here."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fabdesign.placement import UNITS
from fabdesign.target_file import AsTarget
from fabdesign.units import from_mm, in_mm
from studies.studio.panels.asking import Post, markdown, on_click, on_input, put
from studies.studio.searching import VARIES
from studies.studio.session import Session
from studies.studio.target import ShownTarget, placed_by_hand


class TargetPanel:
    """show_gizmo: puts a gizmo on the target, or takes it away."""

    def __init__(self, gui: Any, session: Session, post: Post, show_gizmo: Callable[[bool], None]) -> None:
        self._session = session
        given = session.targets.shown
        self._pose: Any = None
        if len(session.targets.all) > 1:
            self._pose = gui.add_dropdown("Pose", _poses(session))
            on_input(self._pose, post, lambda name: session.targets.show_pose(int(name.partition(":")[0])))
        self._file = gui.add_text("File", "" if given is None else str(given.file.file))
        self._unit = gui.add_dropdown("Unit", tuple(UNITS), initial_value="m" if given is None else given.file.unit)
        self._open = gui.add_button_group("Open", ("as given", "fit"))
        self._open.on_click(lambda _: post(partial(self._read, self._open.value)))
        with gui.add_folder("Placed by hand", expand_by_default=False):
            self._by_hand = gui.add_checkbox("Gizmo", False, hint="Drag it by arrows and rings in the scene")
            on_input(self._by_hand, post, show_gizmo)
            self._shift = gui.add_vector3("Shift, mm", (0.0, 0.0, 0.0), step=0.5)
            self._turn = gui.add_vector3("Turn, degrees", (0.0, 0.0, 0.0), step=1.0)
            for field in (self._shift, self._turn):
                on_input(field, post, lambda _: self._typed())
        with gui.add_folder("Search from here"):
            self._vary = gui.add_dropdown("May change", VARIES)
            self._seconds = gui.add_number("Seconds", 120.0, min=1.0, max=86400.0, step=10.0)
            self._start = gui.add_button("Search from here")
            on_click(self._start, post, lambda: session.search.start(self._vary.value, self._seconds.value))
            self._stop = gui.add_button("Stop, keep the best", disabled=True)
            on_click(self._stop, post, session.search.stop)
            self._text = gui.add_markdown("")
        self.show()

    def show(self) -> None:
        target = self._session.targets.shown
        if target is None:
            return
        if self._pose is not None:
            names = _poses(self._session)
            if self._pose.options != names:
                self._pose.options = names
            put(self._pose, names[min(self._session.targets.pose, len(names) - 1)])
            put(self._file, str(target.file.file))
        put(self._unit, target.file.unit)
        put(self._shift, tuple(round(in_mm(x), 3) for x in target.file.translation))
        put(self._turn, target.file.rotation or (0.0, 0.0, 0.0))

    def show_search(self, message: str, *, running: bool) -> None:
        self._text.content = markdown(message)
        self._start.disabled, self._stop.disabled = running, not running

    def _read(self, place: str) -> None:
        name, design = self._file.value.strip(), self._session.layout.design
        how = AsTarget(self._unit.value, "fit" if place == "fit" else "given")
        self._session.targets.open(lambda: ShownTarget.read(how.target(Path(name)), design) if name else None)
        self.show()

    def _typed(self) -> None:
        self.place(tuple(self._turn.value), tuple(from_mm(x) for x in self._shift.value))

    def place(self, rotation: tuple[float, ...], translation: tuple[float, ...]) -> None:
        """By hand: rotation in degrees about the fixed axes, translation in m."""
        target = self._session.targets.shown
        if target is None:
            return
        file = placed_by_hand(target.file, (*rotation,), (*translation,))  # type: ignore[arg-type]
        self._session.targets.open(lambda: ShownTarget.read(file, self._session.layout.design))
        self.show()


def _poses(session: Session) -> tuple[str, ...]:
    return tuple(f"{number}: {target.file.file.name}" for number, target in enumerate(session.targets.all)) or ("none",)

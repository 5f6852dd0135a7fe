"""The muscle that is selected: its ends and corners in numbers, type, channel, face; and adding, removing, undoing."""

from functools import partial
from typing import Any

from fabdesign.muscle import Muscle
from fabdesign.units import from_mm, in_mm
from studies.studio.layout import (
    Layout,
    add_corner,
    add_muscle,
    flip,
    move_corner,
    point_name,
    remove_corner,
    remove_muscle,
    set_channel,
    set_type,
)
from studies.studio.panels.asking import Post, on_input, put
from studies.studio.session import Session
from studies.studio.snapping import LEAST_SPACING

_NONE = "none"


class MusclePanel:
    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._gui, self._session, self._post = gui, session, post
        self._history = gui.add_button_group("History", ("undo", "redo"))
        self._history.on_click(lambda _: post(session.undo if self._history.value == "undo" else session.redo))
        self._which = gui.add_dropdown("Muscle", (_NONE,))
        on_input(self._which, post, self._select)
        self._actions = gui.add_button_group("Layout", ("add", "remove", "flip"))
        self._actions.on_click(lambda _: post(partial(self._act, self._actions.value)))
        self._face = gui.add_text("Face", "", disabled=True)
        self._type = gui.add_dropdown("Type", tuple(session.layout.design.muscle_types) or (_NONE,))
        on_input(self._type, post, lambda name: self._edit("type", lambda at, i: set_type(at, i, name)))
        self._channel = gui.add_number("Channel", 0, min=0, step=1)
        on_input(self._channel, post, lambda to: self._edit("channel", lambda at, i: set_channel(at, i, int(to))))
        self._corner_actions = gui.add_button_group("Corners", ("add corner", "remove corner"))
        self._corner_actions.on_click(lambda _: post(partial(self._act, self._corner_actions.value)))
        self._folder = gui.add_folder("Ends and corners, mm from the upper left")
        self._points: list[Any] = []
        with gui.add_folder("Lacing rows", expand_by_default=False):
            self._snap = gui.add_checkbox("Snap to rows", session.snap)
            on_input(self._snap, post, self._set_snap)
            self._rows = gui.add_number(
                "Rows, mm", in_mm(session.row_distance), min=in_mm(LEAST_SPACING), max=100.0, step=0.5
            )
            on_input(self._rows, post, self._set_rows)

    def show(self) -> None:
        design, chosen = self._session.layout.design, self._session.selected
        names = tuple(f"{i}: {m.side}, channel {m.channel}" for i, m in enumerate(design.muscles)) or (_NONE,)
        if self._which.options != names:
            self._which.options = names
        put(self._which, names[chosen or 0])
        muscle = None if chosen is None else design.muscles[chosen]
        if muscle is not None:
            put(self._face, muscle.side)
            put(self._type, muscle.type)
            put(self._channel, muscle.channel)
        self._show_points(muscle)

    def _show_points(self, muscle: Muscle | None) -> None:
        path = () if muscle is None else muscle.path
        while len(self._points) > len(path):
            self._points.pop().remove()
        with self._folder:
            while len(self._points) < len(path):
                field = self._gui.add_vector2("", (0.0, 0.0), step=0.1)
                on_input(field, self._post, partial(self._typed, len(self._points)))
                self._points.append(field)
        if muscle is None:
            return
        for k, (field, (u, v)) in enumerate(zip(self._points, path, strict=True)):
            label = f"{point_name(muscle, k).capitalize()} {k}"
            if field.label != label:
                field.label = label
            put(field, (round(in_mm(u), 3), round(in_mm(v), 3)))

    def _typed(self, point: int, at: tuple[float, float]) -> None:
        to = (from_mm(at[0]), from_mm(at[1]))
        self._edit(f"point {point} typed", lambda layout, i: move_corner(layout, i, point, to))

    def _select(self, name: str) -> None:
        if name != _NONE:
            self._session.select(int(name.partition(":")[0]))

    def _edit(self, what: str, change: Any) -> None:
        """A change of the muscle that is selected, as one step."""
        if (i := self._session.selected) is not None:
            self._session.edit(f"{what} of muscle {i}", lambda layout: change(layout, i))

    def _act(self, action: str) -> None:
        session = self._session
        if action == "add":
            session.edit("add a muscle", lambda layout: add_muscle(layout, session.selected))
            session.select(len(session.layout.design.muscles) - 1)
        elif action == "remove":
            self._edit("remove", remove_muscle)
        elif action == "flip":
            self._edit("flip", flip)
        elif action == "add corner":
            self._edit("add a corner", add_corner)
        elif action == "remove corner":
            self._edit("remove a corner", _without_inner_corner)

    def _set_snap(self, on: bool) -> None:
        self._session.snap = on
        self._session.view.show_layout()

    def _set_rows(self, millimetres: float) -> None:
        self._session.row_distance = max(from_mm(millimetres), LEAST_SPACING)
        self._session.view.show_layout()


def _without_inner_corner(layout: Layout, index: int) -> Layout:
    """The last corner between the ends goes, if there is one."""
    return remove_corner(layout, index, max(1, len(layout.design.muscles[index].path) - 2))

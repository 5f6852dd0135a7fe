"""The page as it is declared: viser's widgets and nodes are made, changed and removed until they are what was said.

What to show is said anew whenever something has changed, by functions of the session's state; what differs from
before goes to the browser. A person's input goes to the session's thread, the program's own does not.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.units import from_kpa, from_mm, in_kpa, in_mm

Post = Callable[[Callable[[], None]], None]
LIFT = 0.0015  # m, of the plane on which things of the flat scene are dragged


@dataclass(frozen=True)
class ShownUnit:
    """How a value is shown, or each of several, and what is typed is read."""

    shown: Callable[[Any], Any]
    read: Callable[[Any], Any]

    def show(self, value: Any) -> Any:
        return tuple(map(self.shown, value)) if isinstance(value, tuple) else self.shown(value)

    def take(self, value: Any) -> Any:
        return tuple(map(self.read, value)) if isinstance(value, list | tuple) else self.read(value)


MM = ShownUnit(lambda metres: round(in_mm(metres), 3), from_mm)
KPA = ShownUnit(lambda pascals: round(in_kpa(pascals), 1), from_kpa)
PATH = ShownUnit(str, lambda text: Path(text.strip()))


@dataclass(frozen=True, eq=False)
class Widget:
    """An input, a text or what holds others. kind: what follows `add_` in viser. name: its label, or what it is looked
    up by. value: what an input holds. then: takes what a person has put in, after what stands in the inputs beside it
    that `takes` names, in their order; without it what is typed stays until `value` is another, for it counts only once
    a button takes it. given: viser's other arguments."""

    kind: str
    name: str = ""
    value: Any = None
    then: Callable[..., None] | None = None
    inside: Sequence["Widget"] = ()
    given: Mapping[str, Any] = field(default_factory=dict)
    unit: ShownUnit | None = None
    takes: Sequence[str] = ()


def entry(
    kind: str,
    label: str,
    value: Any,
    then: Callable[..., None] | None = None,
    unit: ShownUnit | None = None,
    takes: Sequence[str] = (),
    **given: Any,
) -> Widget:
    """Return an input with a label. unit: value and limits are in SI, and what is typed comes in SI."""
    if unit is not None:
        value = unit.show(value)
        given |= {end: unit.show(given[end]) for end in ("min", "max") if end in given}
    return Widget(kind, label, value, then, given={"label": label, **given}, unit=unit, takes=takes)


def choice(label: str, options: Sequence[str], value: str, then: Callable[[str], None] | None = None) -> Widget:
    """Return a list that drops down."""
    return entry("dropdown", label, value, then, options=tuple(options))


def button(label: str, then: Callable[..., None], *takes: str, disabled: bool = False) -> Widget:
    return entry("button", label, None, lambda *given: then(*given[:-1]), takes=takes, disabled=disabled)


def buttons(label: str, actions: Mapping[str, Callable[..., None]], *takes: str) -> Widget:
    """Return buttons side by side, each with what it does."""
    return entry("button_group", label, None, lambda *x: actions[x[-1]](*x[:-1]), None, takes, options=[*actions])


def folder(label: str, *inside: Widget, closed: bool = False) -> Widget:
    return Widget("folder", label, inside=inside, given={"label": label, "expand_by_default": not closed})


def html(name: str, content: str) -> Widget:
    return Widget("html", name, given={"content": content})


def markdown(text: str) -> str:
    """Return Markdown without HTML, which viser would run: names of files and designs stand in it."""
    return text.replace("<", "&lt;")


def words(name: str, text: str) -> Widget:
    return Widget("markdown", name, given={"content": markdown(text)})


@dataclass(eq=False)
class _Made:
    """A widget or a node, and viser's handle of it."""

    part: Any
    handle: Any
    inside: list["_Made"] = field(default_factory=list)

    @property
    def value(self) -> Any:
        """Return what stands in an input, in SI where it has a unit."""
        return self.handle.value if self.part.unit is None else self.part.unit.take(self.handle.value)

    def become(self, part: Any) -> bool:
        """Change viser's arguments. Return whether that was enough, or it must be made anew."""
        before, self.part = self.part, part
        for name, value in part.given.items() if before is not part else ():
            old = before.given[name]
            arrays = isinstance(old, np.ndarray) or isinstance(value, np.ndarray)
            if old is value or (np.array_equal(old, value) if arrays else old == value):
                continue
            if not hasattr(self.handle, name) or (arrays and np.shape(old) != np.shape(value)):
                return False
            setattr(self.handle, name, value)
        return True


class Widgets:
    """The panel beside the scene. made: what stands there. post: runs a function on the session's thread."""

    def __init__(self, gui: Any, post: Post) -> None:
        self._gui, self._post = gui, post
        self.made: list[_Made] = []

    def show(self, widgets: Sequence[Widget]) -> None:
        self._match(self.made, widgets, self._gui)

    def unless_lost(self, reason: str | None, write: Callable[..., Any]) -> None:
        """Call `write(replace=...)`, after asking where something would be lost by it."""
        if reason is None:
            write(replace=False)
            return
        dialog = self._gui.add_modal("Replace what is there?")
        with dialog:
            self._gui.add_markdown(markdown(f"{reason}."))
            yes, no = self._gui.add_button("Replace it"), self._gui.add_button("Leave it")

        def replace() -> None:
            dialog.close()
            write(replace=True)

        yes.on_click(lambda _: self._post(replace))
        no.on_click(lambda _: self._post(dialog.close))

    def _match(self, made: list[_Made], widgets: Sequence[Widget], parent: Any) -> None:
        """Keep widgets in their places: a list grows and shrinks at its end."""
        while len(made) > len(widgets):
            made.pop().handle.remove()
        for k, widget in enumerate(widgets):
            if k == len(made):
                made.append(self._make(widget, parent, made))
            else:
                old, handle = made[k].part, made[k].handle
                made[k].become(widget)
                if widget.value is not None and widget.value != (handle.value if widget.then else old.value):
                    handle.value = widget.value
            self._match(made[k].inside, widget.inside, made[k].handle)

    def _make(self, widget: Widget, parent: Any, beside: Sequence[_Made]) -> _Made:
        if widget.kind == "tab":
            return _Made(widget, parent.add_tab(widget.name))
        value = {} if widget.value is None else {"initial_value": widget.value}
        with nullcontext() if parent is self._gui else parent:
            made = _Made(widget, getattr(self._gui, f"add_{widget.kind}")(**widget.given, **value))

        def put_in(event: Any) -> None:
            if event.client is not None and made.part.then is not None:  # else the program set it, or nobody asks yet
                given = [*(one.value for one in beside if one.part.name in made.part.takes), made.value]
                self._post(lambda: made.part.then(*given))

        listen = getattr(made.handle, "on_click", None) or getattr(made.handle, "on_update", None)
        if listen is not None:
            listen(put_in)
        return made


@dataclass(frozen=True, eq=False)
class Node:
    """A thing in the scene. given: viser's arguments; one that is no property of a handle makes it anew when it
    changes. drag: takes where a pointer began and where it is, (3,) m on the plane that lies LIFT above the flat cloth,
    and whether it was let go. moved: takes turn (w, x, y, z) and place [m] of a gizmo that was let go."""

    kind: str
    given: Mapping[str, Any]
    click: Callable[[], None] | None = None
    drag: Callable[[Array, Array, bool], None] | None = None
    moved: Callable[[tuple[float, ...], tuple[float, ...]], None] | None = None


class SceneNodes:
    """The nodes of a scene by their names. post: runs a function on the session's thread."""

    def __init__(self, scene: Any, post: Post) -> None:
        self._scene, self._post = scene, post
        self._made: dict[str, _Made] = {}
        self._grabbed = np.zeros(3)

    def show(self, nodes: Mapping[str, Node]) -> None:
        for name in [name for name in self._made if name not in nodes]:
            self._made.pop(name).handle.remove()
        for name, node in nodes.items():
            if name not in self._made or not self._made[name].become(node):
                self._made[name] = self._make(name, node)

    def _make(self, name: str, node: Node) -> _Made:
        made = _Made(node, getattr(self._scene, f"add_{node.kind}")(name, **node.given))
        if node.click is not None:
            made.handle.on_click(lambda _: self._post(lambda: made.part.click()))
        if node.drag is not None:
            made.handle.on_drag("left")(partial(self.drag, name))
        if node.moved is not None:
            made.handle.on_update(partial(self._move, made))
        return made

    def drag(self, name: str, event: Any) -> None:
        """Hand on a moment of a drag, on a thread of viser's; its begin is a click too."""
        eye, made = np.asarray(event.client.camera.position, dtype=float), self._made.get(name)
        at = on_plane(eye, np.asarray(event.end_position, dtype=float), LIFT)
        if at is None or made is None:  # removed meanwhile, in another tab
            return
        if event.phase == "start":
            self._grabbed = at
            self._post(made.part.click)
        begin, last = self._grabbed, event.phase == "end"
        self._post(lambda: made.part.drag(begin, at, last))

    def _move(self, made: _Made, event: Any) -> None:
        if event.phase == "end":
            turn, place = (tuple(map(float, values)) for values in (event.target.wxyz, event.target.position))
            self._post(lambda: made.part.moved(turn, place))


def on_plane(eye: Array, through: Array, z: float) -> Array | None:
    """Return (3,) m where the ray from `eye` through another point meets the plane z; None where it does not."""
    direction = through - eye
    if abs(direction[2]) < 1e-9 or (t := (z - eye[2]) / direction[2]) <= 0:
        return None
    return np.asarray(eye + t * direction)

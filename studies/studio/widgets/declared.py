"""The page as it is declared: viser's widgets and nodes are made, changed and removed until they are what was said.

What to show is said anew whenever something has changed, by functions of the session's state; what differs from
before goes to the browser. A person's input goes to the session's thread, the program's own does not.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fabdesign.units import from_kpa, from_mm, in_kpa, in_mm

Post = Callable[[Callable[[], None]], None]


@dataclass(frozen=True)
class ShownUnit:
    """How a quantity in SI is shown, and what is typed is read. digits: after the point."""

    shown: Callable[[float], float]
    read: Callable[[float], float]
    digits: int

    def show(self, value: Any) -> Any:
        return tuple(map(self.show, value)) if isinstance(value, tuple) else round(self.shown(value), self.digits)

    def take(self, value: Any) -> Any:
        return tuple(map(self.take, value)) if isinstance(value, list | tuple) else self.read(value)


MM, KPA = ShownUnit(in_mm, from_mm, 3), ShownUnit(in_kpa, from_kpa, 1)


@dataclass(frozen=True, eq=False)
class Widget:
    """An input, a text or what holds others. kind: what follows `add_` in viser. name: its label, or what it is looked
    up by. value: what an input holds. then: takes what a person has put in. given: viser's other arguments. typed: what
    is typed stays until `value` is another, for it counts only once a button is pressed."""

    kind: str
    name: str = ""
    value: Any = None
    then: Callable[[Any], None] = lambda _: None
    inside: Sequence["Widget"] = ()
    given: Mapping[str, Any] = field(default_factory=dict)
    typed: bool = False
    unit: ShownUnit | None = None


def entry(
    kind: str,
    label: str,
    value: Any,
    then: Callable[[Any], None] | None = None,
    unit: ShownUnit | None = None,
    **given: Any,
) -> Widget:
    """Return an input with a label; without `then` what is typed stays until it is asked for. unit: value and limits
    are in SI, and what is typed comes in SI."""
    if unit is not None:
        value = unit.show(value)
        given |= {end: unit.show(given[end]) for end in ("min", "max") if end in given}
    return Widget(kind, label, value, then or (lambda _: None), (), {"label": label, **given}, then is None, unit)


def choice(label: str, options: Sequence[str], value: str, then: Callable[[str], None] | None = None) -> Widget:
    """Return a list that drops down."""
    return entry("dropdown", label, value, then, options=tuple(options))


def button(label: str, then: Callable[[], None], *, disabled: bool = False) -> Widget:
    return Widget("button", label, None, lambda _: then(), (), {"label": label, "disabled": disabled})


def buttons(label: str, actions: Mapping[str, Callable[[], None]]) -> Widget:
    """Return buttons side by side, each with what it does."""
    return Widget(
        "button_group", label, None, lambda name: actions[name](), (), {"label": label, "options": [*actions]}
    )


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
        value = self.handle.value
        return value if self.part.unit is None else self.part.unit.take(value)


class Widgets:
    """The panel beside the scene. post: runs a function on the session's thread."""

    def __init__(self, gui: Any, post: Post) -> None:
        self._gui, self._post = gui, post
        self._made: list[_Made] = []

    def show(self, widgets: Sequence[Widget]) -> None:
        self._match(self._made, widgets, self._gui)

    def handle(self, *names: str) -> Any:
        """Return viser's handle of a widget, by its name and those of what it lies in, the outermost first."""
        return self._find(names).handle

    def labels(self, *names: str) -> list[str]:
        """Return the names of the widgets inside one."""
        return [made.part.name for made in self._find(names).inside]

    def typed(self, *names: str) -> Any:
        """Return what stands in an input, by its name and those of what it lies in."""
        return self._find(names).value

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

    def press(self, *names: str) -> None:
        """Press a button, as a person does."""
        self._find(names).part.then(True)

    def _find(self, names: Sequence[str]) -> _Made:
        made = self._made
        for name in names:
            one = next(
                m for m in [*made, *(i for m in made if not m.part.name for i in m.inside)] if m.part.name == name
            )
            made = one.inside
        return one

    def _match(self, made: list[_Made], widgets: Sequence[Widget], parent: Any) -> None:
        """Widgets keep their places: a list grows and shrinks at its end."""
        while len(made) > len(widgets):
            made.pop().handle.remove()
        for k, widget in enumerate(widgets):
            if k == len(made):
                made.append(self._make(widget, parent))
            else:
                _change(made[k], widget)
            self._match(made[k].inside, widget.inside, made[k].handle)

    def _make(self, widget: Widget, parent: Any) -> _Made:
        if widget.kind == "tab":
            return _Made(widget, parent.add_tab(widget.name))
        value = {} if widget.value is None else {"initial_value": widget.value}
        with nullcontext() if parent is self._gui else parent:
            made = _Made(widget, getattr(self._gui, f"add_{widget.kind}")(**widget.given, **value))

        def put_in(event: Any) -> None:
            if event.client is not None:  # else the program set it
                value = made.value
                self._post(lambda: made.part.then(value))

        if hasattr(made.handle, "on_click"):
            made.handle.on_click(put_in)
        elif hasattr(made.handle, "on_update"):
            made.handle.on_update(put_in)
        return made


def _change(made: _Made, widget: Widget) -> None:
    before, made.part = made.part, widget
    for name, value in widget.given.items():
        if value != before.given[name]:
            setattr(made.handle, name, value)
    if widget.value is not None and widget.value != (before.value if widget.typed else made.handle.value):
        made.handle.value = widget.value


@dataclass(frozen=True, eq=False)
class Node:
    """A thing in the scene. given: viser's arguments; one that is no property of a handle makes it anew when it
    changes. click, drag, moved: take viser's event, on a thread of viser's."""

    kind: str
    given: Mapping[str, Any]
    click: Callable[[Any], None] | None = None
    drag: Callable[[Any], None] | None = None
    moved: Callable[[Any], None] | None = None


def _fits(made: _Made, node: Node) -> bool:
    """Change a node. Return whether that was enough, or it must be made anew."""
    before, made.part = made.part, node
    for name, value in node.given.items() if before is not node else ():
        old = before.given[name]
        if old is value or (not hasattr(value, "vertices") and np.array_equal(old, value)):
            continue
        if not hasattr(made.handle, name) or np.shape(old) != np.shape(value):
            return False
        setattr(made.handle, name, value)
    return True


class SceneNodes:
    """The nodes of a scene by their names."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._made: dict[str, _Made] = {}

    def show(self, nodes: Mapping[str, Node]) -> None:
        for name in [name for name in self._made if name not in nodes]:
            self._made.pop(name).handle.remove()
        for name, node in nodes.items():
            if name not in self._made or not _fits(self._made[name], node):
                self._made[name] = self._make(name, node)

    def _make(self, name: str, node: Node) -> _Made:
        made = _Made(node, getattr(self._scene, f"add_{node.kind}")(name, **node.given))
        if node.click is not None:
            made.handle.on_click(lambda event: made.part.click(event))
        if node.drag is not None:
            made.handle.on_drag("left")(lambda event: made.part.drag(event))
        if node.moved is not None:
            made.handle.on_update(lambda event: made.part.moved(event))
        return made

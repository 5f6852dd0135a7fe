"""The program under edit, below the cloth as it hangs: a line for each channel, and knots that are dragged."""

from functools import partial
from typing import Any

import numpy as np

from fabdesign.units import in_kpa
from studies.studio.program import ProgramEdit
from studies.studio.session import Session
from studies.studio.widgets.declared import Node, Post
from studies.studio.widgets.scene import LIFT, Array, Places, colour, on_plane

_KNOT = 0.0035  # m, radius
_DARK, _GREY = (20, 20, 20), (120, 130, 142)
_THIN = {"thickness": 1.0, "thickness_units": "screen"}


class ProgramView:
    """Draws the program in the scene, and hands on what a hand does to it. post: runs a function on the session's
    thread."""

    def __init__(self, session: Session, post: Post) -> None:
        self._session, self._post = session, post

    def nodes(self) -> dict[str, Node]:
        """Return the plot; nothing where no program is edited."""
        edit, motion = self._session.program, self._session.playing.motion
        if edit is None:
            return {}
        (x, y), (width, height) = self._box
        corners = np.array([(x, y + height), (x, y), (x + width, y)])
        segments = [_segments(corners)]
        if motion is not None and motion.off is not None:
            now = self._at(edit, np.full(2, motion.times[self._session.playing.frame]), np.array([0.0, self._most]))
            segments.append(_segments(now))
        nodes = {"/program/axes": _lines(np.concatenate(segments), _GREY)}
        for name, text, at, anchor in (
            ("most", f"{in_kpa(self._most):.0f} kPa", corners[0], "center-right"),
            ("end", f"{self._end(edit):.2f} s", corners[2], "top-center"),
            ("title", f"program, channel {edit.channel}", corners[0] + [width / 2, 0.0], "bottom-center"),
        ):
            nodes[f"/program/{name}"] = Node("label", {"text": text, "position": (*at, LIFT), "anchor": anchor})
        cycle = edit.moving.regulator.cycle
        for channel, rows in enumerate(edit.pressures.T):
            steps = self._at(edit, cycle * np.repeat(np.arange(len(rows) + 1), 2)[1:-1], np.repeat(rows, 2))
            nodes[f"/program/line_{channel}"] = _lines(_segments(steps), colour(channel), channel == edit.channel)
        places = self._at(edit, cycle * edit.knots, edit.pressures[edit.knots, edit.channel])
        for k, at in enumerate(places):
            chosen = k == edit.knot
            ball = {"radius": _KNOT * (1.3 if chosen else 1.0), "color": _DARK if chosen else colour(edit.channel)}
            ball |= {"position": (*at, LIFT + 0.001), "subdivisions": 2}
            nodes[f"/program/knot_{k}"] = Node("icosphere", ball, partial(self._select, k), partial(self.drag, k))
        return nodes

    def drag(self, knot: int, event: Any) -> None:
        """Give a knot the pressure under the pointer."""
        eye = np.asarray(event.client.camera.position, dtype=float)
        at, edit = on_plane(eye, np.asarray(event.end_position, dtype=float), LIFT), self._session.program
        if at is None or edit is None:
            return
        if event.phase == "start":
            self._select(knot, event)
        (_, y), (_, height) = self._box
        pressure = self._most * (float(at[1]) - y) / height
        self._post(lambda: edit.put(pressure))

    def _select(self, knot: int, _: Any) -> None:
        edit = self._session.program
        if edit is not None:
            self._post(lambda: edit.select(edit.channel, knot))

    @property
    def _box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return Places.of(self._session.document.layout.design.fabric).plot

    @property
    def _most(self) -> float:
        """Pa, at the plot's upper end."""
        assert self._session.program is not None
        return float(self._session.program.moving.regulator.highest.max())

    def _end(self, edit: ProgramEdit) -> float:
        return len(edit.pressures) * edit.moving.regulator.cycle

    def _at(self, edit: ProgramEdit, times: Array, pressures: Array) -> Array:
        """(n, 2) m of instants [s] and pressures [Pa]."""
        origin, size = map(np.array, self._box)
        return np.asarray(origin + size * np.stack([times / self._end(edit), pressures / self._most], axis=1))


def _segments(path: Array) -> Array:
    """(n - 1, 2, 3) m along a path (n, 2) m in the scene's plane."""
    raised = np.concatenate([path, np.full((len(path), 1), LIFT)], axis=1)
    return np.stack([raised[:-1], raised[1:]], axis=1)


def _lines(segments: Array, shade: tuple[int, int, int], thick: bool = False) -> Node:
    return Node("line_segments", {"points": segments, "colors": shade, **_THIN, "thickness": 3.0 if thick else 1.0})

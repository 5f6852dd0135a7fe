"""The program under edit, below the cloth as it hangs: a line for each channel, and knots that are dragged."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.units import in_kpa
from studies.studio.session import Session
from studies.studio.widgets.declared import KPA, Node, Post, Widget, Widgets, buttons, choice, entry, folder, html
from studies.studio.widgets.scene import LIFT, Places, colour, on_plane
from studies.studio.widgets.status import error_over_time

Floats = NDArray[np.floating[Any]]
_KNOT = 0.0035  # m, radius
_DARK, _GREY = (20, 20, 20), (120, 130, 142)


def program(session: Session, made: Widgets) -> list[Widget]:
    """Return what stands beside the plot; nothing where no program is edited."""
    if (edit := session.program) is None:
        return []
    regulator = edit.moving.regulator
    channels = tuple(map(str, range(regulator.channels)))
    knots = tuple(f"{regulator.cycle * cycle:.2f}" for cycle in edit.knots)

    def save() -> None:
        path = Path(made.typed("Motion", "Program", "File").strip())
        made.unless_lost(f"{path} is there" if path.exists() else None, partial(edit.save, path))

    inside = [
        choice("Channel", channels, channels[edit.channel], lambda name: edit.select(int(name), edit.knot)),
        choice("Knot, s", knots, knots[edit.knot], lambda name: edit.select(edit.channel, knots.index(name))),
        entry(
            "slider", "Pressure, kPa", edit.pressure, edit.put, KPA,
            min=0.0, max=float(regulator.highest[edit.channel]), step=0.1,
        ),
        buttons("Play it over the target", {"coarse": edit.play, "exact": partial(edit.play, exact=True)}),
        html("error", error_over_time(session)),
        entry("text", "File", f"{edit.moving.study.name}_pressures.csv"),
        buttons("Program", {"save": save, "as it was opened": partial(edit.take, edit.moving.pressures)}),
    ]  # fmt: skip
    return [folder("Program", *inside)]


class ProgramView:
    """Draws the program in the scene, and hands on what a hand does to it. post: runs a function on the session's
    thread."""

    def __init__(self, session: Session, post: Post) -> None:
        self._session, self._post = session, post

    def nodes(self) -> dict[str, Node]:
        """Return the plot; nothing where no program is edited."""
        edit, playing = self._session.program, self._session.playing
        if edit is None:
            return {}
        rows, cycle = edit.pressures, edit.moving.regulator.cycle
        most, end = float(edit.moving.regulator.highest.max()), len(rows) * cycle

        def line(times: Floats, pressures: Floats, shade: tuple[int, int, int], thickness: float = 1.0) -> Node:
            path = self._places(times / end, pressures / most)
            look = {"colors": shade, "thickness": thickness, "thickness_units": "screen"}
            return Node("line_segments", {"points": np.stack([path[:-1], path[1:]], axis=1), **look})

        def label(text: str, x: float, y: float, anchor: str) -> Node:
            at = tuple(self._places(np.array([x]), np.array([y]))[0])
            return Node("label", {"text": text, "position": at, "anchor": anchor})

        nodes = {
            "/program/axes": line(np.array([0.0, 0.0, end]), np.array([most, 0.0, 0.0]), _GREY),
            "/program/most": label(f"{in_kpa(most):.0f} kPa", 0.0, 1.0, "center-right"),
            "/program/end": label(f"{end:.2f} s", 1.0, 0.0, "top-center"),
            "/program/title": label(f"program, channel {edit.channel}", 0.5, 1.0, "bottom-center"),
        }
        if playing.motion is not None and playing.motion.off is not None:
            now = np.full(2, playing.motion.times[playing.frame])
            nodes["/program/now"] = line(now, np.array([0.0, most]), _GREY)
        held = cycle * np.repeat(np.arange(len(rows) + 1), 2)[1:-1]
        for channel, steps in enumerate(np.repeat(rows, 2, axis=0).T):
            thickness = 3.0 if channel == edit.channel else 1.0
            nodes[f"/program/line_{channel}"] = line(held, steps, colour(channel), thickness)
        for k, at in enumerate(self._places(cycle * edit.knots / end, rows[edit.knots, edit.channel] / most)):
            shade, larger = (_DARK, 1.3) if k == edit.knot else (colour(edit.channel), 1.0)
            ball = {"radius": larger * _KNOT, "color": shade, "position": tuple(at), "subdivisions": 2}
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
        pressure = float(edit.moving.regulator.highest.max()) * (float(at[1]) - y) / height
        self._post(lambda: edit.put(pressure))

    def _select(self, knot: int, _: Any) -> None:
        if (edit := self._session.program) is not None:
            self._post(lambda: edit.select(edit.channel, knot))

    @property
    def _box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return Places.of(self._session.document.layout.design.fabric).plot

    def _places(self, x: Floats, y: Floats) -> Floats:
        """Return (n, 3) m of shares (n,) of the plot."""
        origin, size = map(np.array, self._box)
        return np.concatenate([origin + size * np.stack([x, y], axis=1), np.full((len(x), 1), LIFT)], axis=1)

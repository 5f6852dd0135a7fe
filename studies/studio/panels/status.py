"""What the shape is, how it lies, and which limits are broken: the head of the panel."""

from html import escape
from typing import Any

import numpy as np

from fabdesign.units import in_mm
from studies.studio.live import LiveShape
from studies.studio.scene import heat
from studies.studio.session import Session
from studies.studio.solver import Correction

LEAST_SCALE = 0.002  # m, the least end of a scale of distances
_OF_CLOTH = "cloth to the target"
_PLAIN = "#eef2f6"
_LINE = 1.4  # em
_STYLE = f"font-size:0.86em; line-height:{_LINE}; padding:0.2em 0.9em"


class StatusPanel:
    """Each box has room for what it says most of the time, so that what stands below it stays under the hand."""

    def __init__(self, gui: Any, session: Session) -> None:
        self._session = session
        self._shape, self._scale = gui.add_html(""), gui.add_html("")
        self._limits = gui.add_html("")
        self._message = gui.add_html("")
        self.waiting("the simulator is starting; the first time it compiles for some 10 s")
        self.tell("", bad=False)

    def waiting(self, text: str) -> None:
        self._show([f"<b>No shape yet</b><br>{escape(text)}"])

    def show_shape(self) -> None:
        shape = self._session.shapes.shown
        if shape is None:
            return
        lines = [*_mark(shape), *_numbers(shape.points)]
        if shape.jump is not None:
            lines.append(
                f"<b>Jump to another stable shape</b>, {in_mm(shape.jump):.1f} mm RMS; the one before in orange"
            )
        if shape.correction is not None:
            lines.append(escape(_corrected(shape, shape.correction)))
        if (comparison := self._session.drawings.comparison) is not None:
            lines += [escape(line) for line in comparison.sentences]
        elif self._session.targets.shown is not None:
            lines.append("distances to the target come with the exact shape")
        self._show(lines, "#fdf0dc" if shape.jump else _PLAIN)
        self._scale.content = "" if self._session.targets.shown is None else scale_bar(None, _OF_CLOTH)

    def _show(self, lines: list[str], colour: str = _PLAIN) -> None:
        session = self._session
        room = 4 + 4 * (session.targets.shown is not None) + 3 * session.choice.has_corrector
        self._shape.content = _box("shape", "<br>".join(lines), colour, room=room)

    def show_scale(self, largest: float) -> None:
        """The colours of distances from 0 to `largest` [m], beside the figures."""
        self.show_shape()
        self._scale.content = scale_bar(largest, _OF_CLOTH)

    def show_limits(self) -> None:
        broken = self._session.broken()
        if not broken:
            self._limits.content = _box("limits", "<b>Limits:</b> all kept", "#e6f4ea", room=2)
            return
        lines = "<br>".join(escape(line.message) for line in broken)
        self._limits.content = _box("limits", f"<b>Limits broken:</b> {lines}", "#fbdcdc", room=2, most=6)

    def tell(self, text: str, *, bad: bool) -> None:
        self._message.content = _box("message", escape(text), "#fbe9d0" if bad else "#f4f4f4", room=2)


def scale_bar(largest: float | None, what: str) -> str:
    """The colours of distances from 0 to `largest` [m]; None: only the room for it."""
    stops = ", ".join(f"rgb{tuple(map(int, c))}" for c in heat(np.linspace(0, 1, 4), 1.0))
    bar = f'<div style="background:linear-gradient(90deg,{stops}); height:0.7em; border:1px solid #999"></div>'
    said = f"distance, {what}: 0 to {in_mm(largest or 0.0):.1f} mm; its end is the 98th percentile, "
    said += f"{in_mm(LEAST_SCALE):g} mm at least"
    shown = f"{bar}{said}" if largest is not None else f'<div style="visibility:hidden">{bar}{said}</div>'
    return _box("scale", shown, "#ffffff")


def _mark(shape: LiveShape) -> tuple[str, str]:
    """What the shape is marked as, and why."""
    how = f"{shape.points_per_side} points a side, {1e3 * shape.seconds:.0f} ms"
    if not shape.exact:
        return f"<b>Following</b>, {how}", "from the shape before"
    if shape.time is not None:
        return f"<b>Exact</b>, {how}", f"{shape.time:.3g} s after rest, as the target"
    return f"<b>Exact</b>, {how}", "where a rise within 1 s leads"


def _corrected(shape: LiveShape, correction: Correction) -> str:
    trust = correction.trust
    far = f"the layout is {trust.distance:.2f} from those it learned from, its limit is {trust.limit:.2f}"
    if not trust.applies:
        return f"Not corrected: {far}"
    if not correction.ordered:
        return f"Not shown: the corrector gives a cloud without a surface; {far}"
    if not shape.exact:
        return f"Corrected once it is exact: {far}"
    moved = correction.moved(shape.points)
    rms = in_mm(float(np.sqrt(np.square(moved).mean())))
    return f"Corrected by {rms:.2f} mm RMS, at most {in_mm(moved.max()):.2f} mm: {far}"


def _numbers(points: np.ndarray) -> tuple[str, str]:
    half = len(points) // 2
    side = round(half**0.5)
    middle = ((points[:half] + points[half:]) / 2).reshape(side, side, 3)
    edge = middle[-1]
    x, y, z = in_mm(edge[side // 2])
    return (
        f"lower edge, middle: x {x:.1f}, y {y:.1f}, z {z:.1f} mm;",
        f"its corners: z {in_mm(edge[0, 2]):.1f} and {in_mm(edge[-1, 2]):.1f} mm",
    )


def _box(name: str, content: str, colour: str, *, room: int = 1, most: int | None = None) -> str:
    """room: lines that it has at least; most: lines beyond which it scrolls."""
    style = f"{_STYLE}; background:{colour}; color:#1b2733; border-radius:4px; margin:0.15em 0.6em"
    style += f"; min-height:{_LINE * room:g}em"
    if most is not None:
        style += f"; max-height:{_LINE * most:g}em; overflow-y:auto"
    return f'<div id="studio-{name}" style="{style}">{content}</div>'

"""What the shape is, how it lies, and which limits are broken: the head of the panel."""

from html import escape
from typing import Any

import numpy as np

from studies.studio.live import LiveShape
from studies.studio.scene import heat
from studies.studio.session import Session
from studies.studio.solver import Correction

LEAST_SCALE = 0.002  # m, the least end of a scale of distances
_STYLE = "font-size:0.86em; line-height:1.4; padding:0.2em 0.9em"


class StatusPanel:
    def __init__(self, gui: Any, session: Session) -> None:
        self._session = session
        self._shape = gui.add_html("")
        self._limits = gui.add_html("")
        self._message = gui.add_html("")
        self.waiting("the simulator is starting; the first time it compiles for some 10 s")

    def waiting(self, text: str) -> None:
        self._shape.content = _box("shape", f"<b>No shape yet</b><br>{escape(text)}", "#eef2f6")

    def show_shape(self) -> None:
        shape = self._session.shapes.shown
        if shape is None:
            return
        rise = (
            "where a rise within 1 s leads" if shape.time is None else f"{shape.time:.3g} s after rest, as the target"
        )
        mark = f"<b>Exact</b>, {rise}" if shape.exact else "<b>Following</b>, from the shape before"
        lines = [f"{mark}; {shape.points_per_side} points, {1e3 * shape.seconds:.0f} ms", _numbers(shape.points)]
        if shape.jump is not None:
            lines.append(
                f"<b>Jump to another stable shape</b>, {1e3 * shape.jump:.1f} mm RMS; the one before in orange"
            )
        if shape.correction is not None:
            lines.append(escape(_corrected(shape, shape.correction)))
        if (comparison := self._session.drawings.comparison) is not None:
            lines += [escape(line) for line in comparison.sentences]
        self._shape.content = _box("shape", "<br>".join(lines), "#fdf0dc" if shape.jump else "#eef2f6")

    def show_scale(self, largest: float) -> None:
        """The colours of distances from 0 to `largest` [m], beside the figures."""
        self.show_shape()
        self._shape.content += scale_bar(largest, "cloth to the target")

    def show_limits(self) -> None:
        broken = self._session.broken()
        if not broken:
            self._limits.content = _box("limits", "<b>Limits:</b> all kept", "#e6f4ea")
            return
        lines = [escape(line.message) for line in broken[:6]]
        if len(broken) > 6:
            lines.append(f"and {len(broken) - 6} more")
        self._limits.content = _box("limits", "<b>Limits broken</b><br>" + "<br>".join(lines), "#fbdcdc")

    def tell(self, text: str, *, bad: bool) -> None:
        self._message.content = _box("message", escape(text), "#fbe9d0" if bad else "#f4f4f4")


def scale_bar(largest: float, what: str) -> str:
    """The colours of distances from 0 to `largest` [m]."""
    stops = ", ".join(f"rgb{tuple(map(int, c))}" for c in heat(np.linspace(0, 1, 4), 1.0))
    bar = f'<div style="background:linear-gradient(90deg,{stops}); height:0.7em; border:1px solid #999"></div>'
    said = f"distance, {what}: 0 to {1e3 * largest:.1f} mm; its end is the 98th percentile, "
    said += f"{1e3 * LEAST_SCALE:g} mm at least"
    return _box("scale", f"{bar}{said}", "#ffffff")


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
    rms = 1e3 * float(np.sqrt(np.square(moved).mean()))
    return f"Corrected by {rms:.2f} mm RMS, at most {1e3 * moved.max():.2f} mm: {far}"


def _numbers(points: np.ndarray) -> str:
    half = len(points) // 2
    side = round(half**0.5)
    middle = ((points[:half] + points[half:]) / 2).reshape(side, side, 3)
    edge = middle[-1]
    x, y, z = 1e3 * edge[side // 2]
    return (
        f"lower edge, middle: x {x:.1f}, y {y:.1f}, z {z:.1f} mm; "
        f"corners z {1e3 * edge[0, 2]:.1f} and {1e3 * edge[-1, 2]:.1f} mm"
    )


def _box(name: str, content: str, colour: str) -> str:
    style = f"{_STYLE}; background:{colour}; color:#1b2733; border-radius:4px; margin:0.15em 0.6em"
    return f'<div id="studio-{name}" style="{style}">{content}</div>'

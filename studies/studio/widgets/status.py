"""The head of the panel: what the shape is, how it lies, which limits are broken; and the profile of the lower edge."""

from html import escape
from typing import Any

import numpy as np

from fabdesign.units import in_kpa, in_mm
from studies.studio.drawings import LiveShape, Row
from studies.studio.model_choice import lower_edge
from studies.studio.session import Session
from studies.studio.solver import Correction
from studies.studio.widgets.declared import Widget, html
from studies.studio.widgets.flat_view import heat
from studies.studio.widgets.hung_view import LEAST_SCALE, largest_distance

_LINE = 1.4  # em
_STYLE = f"font-size:0.86em; line-height:{_LINE}; padding:0.2em 0.9em"
_SIZE, _LEFT, _BELOW = (340, 150), 38, 26  # pixels, of the plot
_LEAST = 0.005  # m, the least height of the plot


def status(session: Session) -> list[Widget]:
    """Return boxes with room for what they say most of the time: what stands below them stays under the hand."""
    document, broken = session.document, session.document.broken()
    limits = "<b>Limits:</b> all kept", "#e6f4ea"
    if broken:
        lines = "<br>".join(escape(line.message) for line in broken)
        limits = f"<b>Limits broken:</b> {lines}", "#fbdcdc"
    text, bad = document.message
    scale = scale_bar(largest_distance(session), "cloth to the target") if document.target is not None else ""
    return [
        _shape(session),
        html("scale", scale),
        html("limits", _box("limits", *limits, room=2, most=6 if broken else None)),
        html("message", _box("message", escape(text), "#fbe9d0" if bad else "#f4f4f4", room=2)),
    ]


def _shape(session: Session) -> Widget:
    document, shape = session.document, session.shapes.shown
    room = 4 + 4 * (document.target is not None) + 3 * document.choice.has_corrector
    if shape is None:
        starting = "the simulator is starting; the first time it compiles for some 10 s"
        return html("shape", _box("shape", f"<b>No shape yet</b><br>{starting}", "#eef2f6", room=room))
    lines = [*_mark(shape), *_numbers(shape.points)]
    if shape.jump is not None:
        lines.append(f"<b>Jump to another stable shape</b>, {in_mm(shape.jump):.1f} mm RMS; the one before in orange")
    if shape.correction is not None:
        lines.append(escape(_corrected(shape, shape.correction)))
    if document.comparison is not None:
        lines += [escape(line) for line in document.comparison.sentences]
    elif document.target is not None:
        lines.append("distances to the target come with the exact shape")
    return html("shape", _box("shape", "<br>".join(lines), "#fdf0dc" if shape.jump else "#eef2f6", room=room))


def scale_bar(largest: float | None, what: str) -> str:
    """Return the colours of distances from 0 to `largest` m; None: only the room for it."""
    stops = ", ".join(f"rgb{tuple(map(int, c))}" for c in heat(np.linspace(0, 1, 4), 1.0))
    bar = f'<div style="background:linear-gradient(90deg,{stops}); height:0.7em; border:1px solid #999"></div>'
    bar += f"distance, {what}: 0 to {in_mm(largest or 0.0):.1f} mm; its end is the 98th percentile, "
    bar += f"{in_mm(LEAST_SCALE):g} mm at least"
    return _box("scale", bar if largest is not None else f'<div style="visibility:hidden">{bar}</div>', "#ffffff")


def _mark(shape: LiveShape) -> tuple[str, str]:
    """Return what the shape is marked as, and why."""
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
    edge = in_mm(lower_edge(points))
    x, y, z = edge[len(edge) // 2]
    corners = f"its corners: z {edge[0, 2]:.1f} and {edge[-1, 2]:.1f} mm"
    return f"lower edge, middle: x {x:.1f}, y {y:.1f}, z {z:.1f} mm;", corners


def _box(name: str, content: str, colour: str, *, room: int = 1, most: int | None = None) -> str:
    """Return a box. room: lines that it has at least; most: lines beyond which it scrolls."""
    style = f"{_STYLE}; background:{colour}; color:#1b2733; border-radius:4px; margin:0.15em 0.6em"
    style += f"; min-height:{_LINE * room:g}em"
    if most is not None:
        style += f"; max-height:{_LINE * most:g}em; overflow-y:auto"
    return f'<div id="studio-{name}" style="{style}">{content}</div>'


def results_table(rows: list[Row]) -> str:
    """Return the table that compares the own drawing with results."""
    head = "<tr><th></th><th>muscles</th><th>Chamfer, mm</th><th>surface RMS, mm</th><th>highest, kPa</th></tr>"
    lines = []
    for row in rows:
        distances = ["" if value is None else f"{in_mm(value):.2f}" for value in (row.chamfer, row.surface_rms)]
        cells = [escape(row.name), f"{row.muscles}", *distances, f"{in_kpa(row.highest):.0f}"]
        weight = "bold" if row.shown else "normal"
        lines.append(f"<tr style='font-weight:{weight}'>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    style = "font-size:0.82em; margin:0.4em 0.9em; text-align:right; border-spacing:0.7em 0.2em"
    return f'<table id="studio-results" style="{style}">{head}{"".join(lines)}</table>'


def profile(session: Session) -> str:
    """Return the lower edge from below, z over u, with the model's intervals as a band; empty without a shape."""
    shape, band = session.shapes.shown, session.shapes.band
    if shape is None:
        return ""
    z = lower_edge(shape.points)[:, 2]
    half = np.zeros_like(z) if band is None else band.half[:, 2]
    u = np.linspace(0.0, shape.layout.design.fabric.width, len(z))
    curves = [z - half, z + half]
    correction = shape.correction if shape.exact else None
    corrected = correction is not None and correction.moved(shape.points).any()
    if corrected and correction is not None:
        curves.append(lower_edge(correction.simulated)[:, 2])
    low, high = float(np.min(curves)), float(np.max(curves))
    spare = max(_LEAST - (high - low), 0.1 * (high - low)) / 2
    plot = _Plot(in_mm(u), low - spare, high + spare)
    parts = [plot.axes(0)]
    message = "no intervals: the model has no joint covariance"
    if band is not None:
        parts.append(plot.band(z - half, z + half))
        message = f"band: 90 % intervals of the model, at most ±{in_mm(half.max()):.2f} mm"
    elif session.shapes.bands:
        message = "intervals follow the exact shape"
    if corrected:
        parts.append(plot.line(curves[-1], "#e08a2b", dashed=True))
        message += "; orange: without the corrector"
    parts.append(plot.line(z, "#1b4f8a"))
    return _plotted("profile", "Lower edge, z in mm over u in mm", parts, message)


def error_over_time(session: Session) -> str:
    """Return the error of the program's motion over time, with that of the program as it was opened; empty before the
    first motion."""
    edit, playing = session.program, session.playing
    if edit is None or edit.off is None or edit.first is None:
        return ""
    at = np.isfinite(edit.off)
    times, off, first = edit.moving.times[at], edit.off[at], edit.first[at]
    high = max(_LEAST, 1.1 * float(np.max([off, first])))
    plot = _Plot(np.concatenate([[0.0], times]), 0.0, high)
    parts = [plot.axes(1), plot.line(first, "#8a94a0", dashed=True), plot.line(off, "#1b4f8a")]
    if playing.motion is not None and playing.motion.off is not None:
        parts.append(plot.cursor(float(playing.motion.times[playing.frame])))
    means = f"mean {in_mm(float(off.mean())):.2f} mm; dashed: as opened, mean {in_mm(float(first.mean())):.2f} mm"
    return _plotted("error", "Surface RMS, mm over s", parts, means)


def _plotted(name: str, title: str, parts: list[str], below: str) -> str:
    size = f'style="display:block" width="{_SIZE[0]}" height="{_SIZE[1]}"'
    svg = f'<svg id="studio-{name}" {size}>{"".join(parts)}</svg>'
    return f'<div style="font-size:0.8em; margin:0.2em 0.9em">{title}{svg}{below}</div>'


class _Plot:
    """Values between two ends [m] over rising places, in pixels; of fewer values the last places."""

    def __init__(self, places: Any, low: float, high: float) -> None:
        self._places, self._low, self._high = places, low, high
        self._x = self._across(places)

    def _across(self, place: Any) -> Any:
        return np.interp(place, self._places[[0, -1]], [_LEFT, _SIZE[0] - 8])

    def _y(self, values: Any) -> Any:
        return 6 + (_SIZE[1] - _BELOW - 6) * (self._high - values) / (self._high - self._low)

    def _points(self, values: Any) -> list[str]:
        return [f"{x:.1f},{y:.1f}" for x, y in zip(self._x[-len(values) :], self._y(values), strict=True)]

    def cursor(self, place: float) -> str:
        x = self._across(place)
        return f'<path d="M{x:.1f} 6V{_SIZE[1] - _BELOW}" stroke="#e08a2b"/>'

    def line(self, values: Any, colour: str, *, dashed: bool = False) -> str:
        dash = ' stroke-dasharray="5 3"' if dashed else ""
        stroke = f'stroke="{colour}"{dash} stroke-width="1.6"'
        return f'<polyline points="{" ".join(self._points(values))}" fill="none" {stroke}/>'

    def band(self, low: Any, high: Any) -> str:
        outline = " ".join([*self._points(low), *reversed(self._points(high))])
        return f'<polygon points="{outline}" fill="#1b4f8a" fill-opacity="0.22"/>'

    def axes(self, digits: int) -> str:
        """Return axes. digits: of the places, after the point."""
        left, right, bottom = self._x[0], self._x[-1], _SIZE[1] - _BELOW
        text = 'font-size="11" fill="#3b4654"'
        lines = f'<path d="M{left} 6V{bottom}H{right}" stroke="#8a94a0" fill="none"/>'
        for v in (self._low, (self._low + self._high) / 2, self._high):
            at = f'x="{left - 4}" y="{self._y(v) + 4:.0f}" text-anchor="end"'
            lines += f"<text {at} {text}>{in_mm(v):.1f}</text>"
        first, last = float(self._places[0]), float(self._places[-1])
        for x, place in ((left, first), ((left + right) / 2, (first + last) / 2), (right - 6, last)):
            lines += f'<text x="{x:.0f}" y="{bottom + 15}" text-anchor="middle" {text}>{place:.{digits}f}</text>'
        return lines

"""The head of the panel: what the shape is, how it lies, which limits are broken; and the profile of the lower edge."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.array import Array
from fabdesign.units import in_kpa, in_mm
from studies.studio.document import Document
from studies.studio.drawings import DrawingHistory, LiveShape, Result
from studies.studio.model_choice import lower_edge
from studies.studio.opening import LEAST_SCALE
from studies.studio.session import Session
from studies.studio.solver import Correction
from studies.studio.widgets.declared import Widget, html
from studies.studio.widgets.flat_view import heat

_LINE = 1.4  # em
_STYLE = f"font-size:0.86em; line-height:{_LINE}; padding:0.2em 0.9em"
_SIZE, _MARGIN, _BELOW = (340, 150), 38, 26  # pixels, of the plot
_LEAST = 0.005  # m, the least height of the plot


def status(session: Session) -> list[Widget]:
    """Return boxes with room for what they say most of the time: what stands below them stays under the hand."""
    document, broken = session.document, session.document.broken
    limits = "<b>Limits:</b> all kept", "#e6f4ea"
    if broken:
        lines = "<br>".join(escape(line.message) for line in broken)
        limits = f"<b>Limits broken:</b> {lines}", "#fbdcdc"
    text, bad = document.message
    comparison = document.seen.comparison
    largest = None if comparison is None else comparison.largest
    scale = scale_bar(largest, "cloth to the target") if document.target is not None else ""
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
    mark, why = ("Exact", "where a rise within 1 s leads") if shape.exact else ("Following", "from the shape before")
    if shape.exact and shape.time is not None:
        why = f"{shape.time:.3g} s after rest, as the target"
    edge = in_mm(lower_edge(shape.points))
    x, y, z = edge[len(edge) // 2]
    lines = [
        f"<b>{mark}</b>, {shape.points_per_side} points a side, {1e3 * shape.seconds:.0f} ms",
        why,
        f"lower edge, middle: x {x:.1f}, y {y:.1f}, z {z:.1f} mm;",
        f"its corners: z {edge[0, 2]:.1f} and {edge[-1, 2]:.1f} mm",
    ]
    if shape.jump is not None:
        lines.append(f"<b>Jump to another stable shape</b>, {in_mm(shape.jump):.1f} mm RMS; the one before in orange")
    if shape.correction is not None:
        lines.append(escape(_corrected(shape, shape.correction)))
    if (comparison := document.seen.comparison) is not None:
        lines += [escape(line) for line in comparison.sentences]
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


def _box(name: str, content: str, colour: str, *, room: int = 1, most: int | None = None) -> str:
    """Return a box. room: lines that it has at least; most: lines beyond which it scrolls."""
    style = f"{_STYLE}; background:{colour}; color:#1b2733; border-radius:4px; margin:0.15em 0.6em"
    style += f"; min-height:{_LINE * room:g}em"
    if most is not None:
        style += f"; max-height:{_LINE * most:g}em; overflow-y:auto"
    return f'<div id="studio-{name}" style="{style}">{content}</div>'


def results_table(document: Document) -> str:
    """Return the table that compares the own drawing with results."""
    head = "<tr><th></th><th>muscles</th><th>Chamfer, mm</th><th>surface RMS, mm</th><th>highest, kPa</th></tr>"
    lines = []
    drawings: list[DrawingHistory | Result] = [document.history, *document.results]
    for drawing in drawings:
        layout = drawing.at(document.pose)
        distances = ["" if value is None else f"{in_mm(value):.2f}" for value in document.errors_of(drawing)]
        highest = in_kpa(max(layout.pressures, default=0.0))
        cells = [escape(drawing.name), f"{len(layout.design.muscles)}", *distances, f"{highest:.0f}"]
        weight = "bold" if drawing is document.seen else "normal"
        lines.append(f"<tr style='font-weight:{weight}'>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    style = "font-size:0.82em; margin:0.4em 0.9em; text-align:right; border-spacing:0.7em 0.2em"
    return f'<table id="studio-results" style="{style}">{head}{"".join(lines)}</table>'


def errors_table(by_trial: Mapping[str, tuple[Errors, ...]]) -> str:
    """Return in Markdown a row for each trial, surface RMS in mm, without and with the corrector where one acts, and
    the noise floor; and the means."""
    if not by_trial:
        return ""
    corrected = any(len(errors) > 1 for errors in by_trial.values())
    rows = {
        name: [e.surface_rms for e in (errors[0], errors[-1])[: 1 + corrected]] + [errors[-1].surface_floor]
        for name, errors in by_trial.items()
    }
    if len(rows) > 1:
        rows[f"**mean of {len(rows)}**"] = np.mean([*rows.values()], axis=0).tolist()
    head = ["trial", "predicted", *(["corrected"] if corrected else []), "noise floor"]
    lines = [head, ["---"] * len(head)]
    for name, values in rows.items():
        lines.append([name, *(f"{in_mm(x):.2f}" if np.isfinite(x) else "not known" for x in values)])
    return "Surface RMS, mm, mean of all frames\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)


def profile(session: Session) -> str:
    """Return the lower edge from below, z over u, with the model's intervals as a band; empty without a shape."""
    shape, band = session.shapes.shown, session.shapes.band
    if shape is None:
        return ""
    z = lower_edge(shape.points)[:, 2]
    curves = [(z, "#1b4f8a", False)]
    between, message = (z, z), "no intervals: the model has no joint covariance"
    if band is not None:
        between = z - band[:, 2], z + band[:, 2]
        message = f"band: 90 % intervals of the model, at most ±{in_mm(band[:, 2].max()):.2f} mm"
    elif session.shapes.bands:
        message = "intervals follow the exact shape"
    correction = shape.correction if shape.exact else None
    if correction is not None and correction.moved(shape.points).any():
        curves.insert(0, (lower_edge(correction.simulated)[:, 2], "#e08a2b", True))
        message += "; orange: without the corrector"
    every = [*between, *(values for values, *_ in curves)]
    low, high = float(np.min(every)), float(np.max(every))
    spare = max(_LEAST - (high - low), 0.1 * (high - low)) / 2
    u = in_mm(np.linspace(0.0, shape.layout.design.fabric.width, len(z)))
    plot = _plot("profile", u, (low - spare, high + spare), curves, band=None if band is None else between)
    return _plotted("Lower edge, z in mm over u in mm", plot, message)


def error_over_time(session: Session) -> str:
    """Return the error of the program's motion over time, with that of the program as it was opened; empty before the
    first motion."""
    edit, playing = session.program, session.playing
    if edit is None or edit.off is None or edit.first is None:
        return ""
    at = np.isfinite(edit.off)
    off, first, times = edit.off[at], edit.first[at], np.concatenate([[0.0], edit.moving.times[at]])
    running = playing.motion is not None and playing.motion.off is not None
    cursor = float(playing.motion.times[playing.frame]) if running and playing.motion is not None else None
    high, curves = max(_LEAST, 1.1 * float(np.max([off, first]))), [(first, "#8a94a0", True), (off, "#1b4f8a", False)]
    means = f"mean {in_mm(float(off.mean())):.2f} mm; dashed: as opened, mean {in_mm(float(first.mean())):.2f} mm"
    return _plotted(
        "Surface RMS, mm over s", _plot("error", times, (0.0, high), curves, digits=1, cursor=cursor), means
    )


def _plotted(title: str, plot: str, below: str) -> str:
    return f'<div style="font-size:0.8em; margin:0.2em 0.9em">{title}{plot}{below}</div>'


def _plot(
    name: str,
    places: Array,
    ends: tuple[float, float],
    curves: Sequence[tuple[Array, str, bool]],
    *,
    band: tuple[Array, Array] | None = None,
    cursor: float | None = None,
    digits: int = 0,
) -> str:
    """Return curves (values [m], colour, whether dashed) between two ends [m] over rising places; fewer values lie over
    the last places. band: what lies between two curves. cursor: a place. digits: of the places, after the point."""
    left, right, top, bottom = _MARGIN, _SIZE[0] - 8, 6, _SIZE[1] - _BELOW

    def across(place: Any) -> Any:
        return np.interp(place, places[[0, -1]], [left, right])

    def height(values: Any) -> Any:
        return top + (bottom - top) * (ends[1] - values) / (ends[1] - ends[0])

    def points(values: Array) -> list[str]:
        at = zip(across(places[-len(values) :]), height(values), strict=True)
        return [f"{x:.1f},{y:.1f}" for x, y in at]

    parts = [f'<path d="M{left} {top}V{bottom}H{right}" stroke="#8a94a0" fill="none"/>']
    at = zip((left, (left + right) / 2, right - 6), np.linspace(places[0], places[-1], 3), strict=True)
    beside = [(left - 4, height(value) + 4, "end", f"{in_mm(value):.1f}") for value in np.linspace(*ends, 3)]
    below = [(x, bottom + 15, "middle", f"{place:.{digits}f}") for x, place in at]
    for x, y, anchor, label in (*beside, *below):
        place = f'x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}"'
        parts.append(f'<text {place} font-size="11" fill="#3b4654">{label}</text>')
    if band is not None:
        outline = " ".join([*points(band[0]), *reversed(points(band[1]))])
        parts.append(f'<polygon points="{outline}" fill="#1b4f8a" fill-opacity="0.22"/>')
    for values, colour, dashed in curves:
        dash = ' stroke-dasharray="5 3"' if dashed else ""
        stroke = f'stroke="{colour}"{dash} stroke-width="1.6"'
        parts.append(f'<polyline points="{" ".join(points(values))}" fill="none" {stroke}/>')
    if cursor is not None:
        parts.append(f'<path d="M{across(cursor):.1f} {top}V{bottom}" stroke="#e08a2b"/>')
    size = f'style="display:block" width="{_SIZE[0]}" height="{_SIZE[1]}"'
    return f'<svg id="studio-{name}" {size}>{"".join(parts)}</svg>'

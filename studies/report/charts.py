"""Charts of a page as Plotly's figures: axes with titles that have room, a legend above the axes, rows with names."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.report.page import PlotlyFigure, Trace

BLUE, RED, GREY, DARK = "#2f6db3", "#c23b3b", "#9aa5b1", "#1c2430"
LEGEND = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "font": {"size": 12}}  # above the axes
_FONT = {"family": "system-ui, sans-serif", "size": 13}
_ROW, _FRAME = 26, 90  # px: a row of bars, and what axis and title take
_REACH = 1.5  # of a scene's box corner to corner, in Plotly's units: it stays in view however it is turned
Box = dict[str, tuple[float, float]]  # lowest and highest, by axis


@dataclass(frozen=True)
class Gain:
    """Return what a candidate gains, with its 90 % interval, in the chart's unit."""

    name: str
    value: float
    interval90: tuple[float, float]
    chosen: bool


def chart(data: Sequence[Trace], *, x: str, y: str = "", height: int = 340, **layout: Any) -> PlotlyFigure:
    """Return traces over axes with these titles. height: px. layout: more of Plotly's, `xaxis` and `yaxis` merged."""
    axes = {
        name: {"automargin": True, "title": {"text": title, "standoff": 8}} | layout.pop(name, {})
        for name, title in (("xaxis", x), ("yaxis", y))
    }
    frame = {"margin": {"l": 10, "r": 20, "t": 20, "b": 10}, "font": _FONT, "legend": LEGEND, "height": height}
    return {"data": data, "layout": {**frame, **axes, **layout}}


def line(name: str, x: Sequence[Any], y: Sequence[Any], colour: str | None = None, **more: Any) -> Trace:
    """Return a curve with its name; without a colour one of Plotly's. more: of Plotly's, `line` merged."""
    style = {**({"color": colour} if colour else {}), **more.pop("line", {})}
    return {"type": "scatter", "mode": "lines", "name": name, "x": [*x], "y": [*y], "line": style, **more}


def bars_chart(rows: Sequence[tuple[str, float, str]], unit: str, x: str) -> PlotlyFigure:
    """Return a bar for each (name, value, colour), the first at the bottom, with its value beside it."""
    bar = {
        "type": "bar",
        "orientation": "h",
        "y": [name for name, *_ in rows],
        "x": [value for _, value, _ in rows],
        "marker": {"color": [colour for *_, colour in rows]},
        "text": [f"{value:.3g} {unit}" for _, value, _ in rows],
        "textposition": "auto",
    }
    return chart([bar], x=f"{x}, {unit}", xaxis={"rangemode": "tozero"}, yaxis=_ROWS, height=_height(len(rows)))


def gains_chart(gains: Sequence[Gain], unit: str, x: str, tolerance: float) -> PlotlyFigure:
    """Return a mark for each gain, the first on top and those chosen in bold; below 0 there is none to show."""
    rows = [*reversed(gains)]
    value, low, high = (np.maximum(v, 0.0) for v in np.array([(g.value, *g.interval90) for g in rows]).reshape(-1, 3).T)
    marks = {
        "type": "scatter",
        "mode": "markers",
        "y": [f"<b>{g.name}</b>" if g.chosen else g.name for g in rows],
        "x": value.tolist(),
        "marker": {"size": 9, "color": [BLUE if g.chosen else GREY for g in rows]},
        "error_x": {
            "type": "data",
            "symmetric": False,
            "thickness": 1.5,
            "array": np.maximum(high - value, 0).tolist(),
            "arrayminus": np.maximum(value - low, 0).tolist(),
        },
    }
    dotted = {"dash": "dot", "color": RED}
    limit = {"type": "line", "x0": tolerance, "x1": tolerance, "y0": 0, "y1": 1, "yref": "paper", "line": dotted}
    title = f"{x}, {unit} (90 %); dotted: the tolerance"
    return chart([marks], x=title, shapes=[limit], yaxis=_ROWS, height=_height(len(rows)))


def gain_in_words(value: float, interval90: Sequence[float], unit: str, number: str = ".2f") -> str:
    """Return "1.20 mm (90 % 0.80 to 1.60)", or "none" where there is no gain. number: how values are formatted."""
    if value <= 0:
        return "none"
    low, high = (f"{max(end, 0.0):{number}}" for end in interval90)
    return f"{f'{value:{number}} {unit}'.rstrip()} (90 % {low} to {high})"


def scene_layout(traces: Sequence[Trace]) -> dict[str, Any]:
    """Return the layout of a scene in metres, y upwards, that holds traces of any proportions."""
    box = _box(traces)
    extents = {axis: high - low for axis, (low, high) in box.items()}
    corners = float(np.linalg.norm([*extents.values()]))
    grid = {"showbackground": False, "gridcolor": "#e3e7ec", "tickformat": ".2f", "nticks": 6}
    scene = {
        "aspectmode": "manual",
        "aspectratio": {axis: _REACH * extent / corners for axis, extent in extents.items()},
        **{
            f"{axis}axis": {**grid, "title": {"text": f"{axis}, m"}, "range": [*box[axis]], "nticks": _ticks(share)}
            for axis, share in ((axis, extent / corners) for axis, extent in extents.items())
        },
        "camera": {"up": {"x": 0, "y": 1, "z": 0}, "eye": {"x": 1.2, "y": 0.36, "z": 1.32}},
    }
    margin = {"l": 25, "r": 10, "t": 10, "b": 10}
    return {"scene": scene, "margin": margin, "height": 600, "legend": LEGEND | {"font": {"size": 11}}}


def _ticks(share: float) -> int:
    """Return how many numbers an axis has room for that takes a share of the box's diagonal."""
    return 6 if share > 0.45 else 4 if share > 0.2 else 2


def _box(traces: Sequence[Trace]) -> Box:
    """Return what holds all traces, with some room around."""
    values = {axis: [v for t in traces for v in t.get(axis, ()) if v is not None] for axis in "xyz"}
    box = {axis: (min(own), max(own)) for axis, own in values.items()}
    room = 0.02 * max(high - low for low, high in box.values())
    return {axis: (low - room, high + room) for axis, (low, high) in box.items()}


def _height(rows: int) -> int:
    return _FRAME + _ROW * max(rows, 2)


_ROWS: Mapping[str, Any] = {"type": "category", "dtick": 1}  # every row has its name

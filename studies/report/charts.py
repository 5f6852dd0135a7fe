"""Charts of a page, drawn by Plotly: axes with titles that have room, a legend above the axes, rows with names; and
scenes that a person turns: clouds, cloths and lines in space."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plotly import graph_objects as go

from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import face_triangles
from fabdesign.units import in_mm
from studies.report.page import Chart

BLUE, RED, GREY, DARK = "#2f6db3", "#c23b3b", "#9aa5b1", "#1c2430"
LEGEND = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "font": {"size": 12}}  # above the axes
_FONT = {"family": "system-ui, sans-serif", "size": 13}
_ROW, _FRAME = 26, 90  # px: a row of bars, and what axis and title take
_NAMED = {"type": "category", "dtick": 1}  # an axis of which every row has its name
Points = NDArray[np.floating[Any]]  # (n, 3) m
Gain = tuple[str, float, Sequence[float], bool]
SHOWN = 700  # target points drawn: few enough that the result is seen between them
TARGET = "#222222"
_REACH = 1.5  # of a scene's box corner to corner, in Plotly's units: it stays in view however it is turned


def chart(name: str, traces: Sequence[Any], *, x: str, y: str = "", height: int = 340, **layout: Any) -> Chart:
    """Return Plotly's traces over axes with these titles. height: px. layout: more of Plotly's, `xaxis` and `yaxis`
    merged."""
    figure = bare(traces)
    for axis, title in (("xaxis", x), ("yaxis", y)):
        figure.layout[axis].update(automargin=True, title={"text": title, "standoff": 8})
    figure.update_layout(margin={"l": 10, "r": 20, "t": 20, "b": 10}, font=_FONT, legend=LEGEND, height=height)
    return Chart(name, figure.update_layout(layout))


def bare(traces: Sequence[Any]) -> go.Figure:
    """Return traces without the coloured background that Plotly gives a figure."""
    figure = go.Figure([*traces])
    figure.layout.template = None
    return figure


def curve(name: str, x: Any, y: Any, colour: str | None = None, **style: Any) -> go.Scatter:
    """Return a line with its name; without a colour one of Plotly's. style: more of Plotly's, such as `line_dash`."""
    return go.Scatter({"name": name, "x": x, "y": y, "mode": "lines", "line": {"color": colour}}, **style)


def bars(name: str, rows: Sequence[tuple[str, float, str]], unit: str, x: str) -> Chart:
    """Return a bar for each (name, value, colour), the first at the bottom, with its value beside it."""
    names, values, colours = zip(*rows, strict=True)
    text = [f"{value:.3g} {unit}" for value in values]
    drawn = go.Bar(orientation="h", y=names, x=values, marker_color=colours, text=text, textposition="auto")
    axis = {"rangemode": "tozero"}
    return chart(name, [drawn], x=f"{x}, {unit}", height=_height(rows), xaxis=axis, yaxis=_NAMED)


def error_bars(errors: Sequence[float], noise: str, unit: str, x: str, scale: float = 1.0) -> Chart:
    """Return the errors of a trace: the floor, called `noise`, the baseline's, after and before."""
    rows = zip((noise, "flexible baseline", "after", "before"), errors, (GREY, GREY, BLUE, RED), strict=True)
    return bars("bars", [(name, scale * value, colour) for name, value, colour in rows], unit, x)


def gains(name: str, rows: Sequence[Gain], unit: str, x: str, tolerance: float, *, scale: float = 1.0) -> Chart:
    """Return a mark for each (name, gain, 90 % interval, whether it is chosen), the first on top and those chosen in
    bold; below 0 there is no gain to show. scale: of `unit`, that a one of the gains is."""
    rows = [*reversed(rows)]
    value, low, high = np.maximum(scale * np.array([(gain, *ends) for _, gain, ends, _ in rows]).reshape(-1, 3).T, 0.0)
    marks = go.Scatter(
        mode="markers",
        y=[f"<b>{candidate}</b>" if chosen else candidate for candidate, *_, chosen in rows],
        x=value,
        marker={"size": 9, "color": [BLUE if chosen else GREY for *_, chosen in rows]},
        error_x={"symmetric": False, "thickness": 1.5, "array": high - value, "arrayminus": value - low},
    )
    title = f"{x}, {unit} (90 %); dotted: the tolerance"
    drawn = chart(name, [marks], x=title, yaxis=_NAMED, height=_height(rows))
    drawn.figure.add_vline(scale * tolerance, line={"dash": "dot", "color": RED})
    return drawn


def cloth(name: str, title: str, cells: NDArray[np.float64], size: tuple[float, float], most: float) -> Chart:
    """Return root mean squares on the cloth's places, as colours. cells (n, n) m, NaN where there is none; size:
    (width, height) m; most: m, of the strongest colour."""
    middles = (np.arange(len(cells)) + 0.5) / len(cells)
    scale = {"colorscale": "Viridis", "zmin": 0, "zmax": in_mm(most)}
    colours = go.Heatmap(x=in_mm(size[0]) * middles, y=in_mm(size[1]) * middles, z=in_mm(cells), **scale)
    colours.colorbar = {"title": {"text": "RMS, mm"}, "thickness": 12}
    down = {"autorange": "reversed", "scaleanchor": "x", "constrain": "domain"}
    above = {"text": title, "x": 0.5, "y": 0.98, "yanchor": "top"}
    margin = {"l": 10, "r": 10, "t": 45, "b": 10}
    axes: dict[str, Any] = {"xaxis": {"constrain": "domain"}, "yaxis": down}
    return chart(name, [colours], x="u, mm", y="v, mm", height=400, title=above, margin=margin, **axes)


def _height(rows: Sequence[Any]) -> int:
    return _FRAME + _ROW * max(len(rows), 2)


def cloud(name: str, points: Points, colour: str, size: float = 1.6) -> go.Scatter3d:
    """Return the points of a cloud. size: px."""
    marker = {"size": size, "color": colour}
    return go.Scatter3d(name=name, mode="markers", marker=marker, hoverinfo="skip", **_axes(points))


def target_cloud(points: Points) -> go.Scatter3d:
    """Return some points of a target."""
    return cloud("target", points[:: max(1, len(points) // SHOWN)], TARGET)


def cloth_mesh(name: str, points: Points, **style: Any) -> go.Mesh3d:
    """Return both faces (2 n n, 3) m of a cloth. style: more of Plotly's `Mesh3d`."""
    side = Shape(points).side
    corners = dict(zip("ijk", face_triangles(side, side).T.astype(np.int32), strict=True))
    return go.Mesh3d(name=name, showlegend=True, flatshading=False, **_axes(points), **corners, **style)


def path(name: str, points: Points, colour: str, width: float, hover: str = "name") -> go.Scatter3d:
    """Return a line through points, interrupted where one is NaN. width: px."""
    line = {"width": width, "color": colour}
    return go.Scatter3d(name=name, mode="lines", line=line, hoverinfo=hover, **_axes(points))


def scene(name: str, traces: Sequence[Any]) -> Chart:
    """Return what is drawn in metres, y upwards, of any proportions, true to scale."""
    figure = bare(traces)
    low, high = _box(traces)
    corners = float(np.linalg.norm(high - low))
    figure.layout.scene.update(
        aspectmode="manual",
        aspectratio=dict(zip("xyz", _REACH * (high - low) / corners, strict=True)),
        camera={"up": {"x": 0, "y": 1, "z": 0}, "eye": {"x": 1.2, "y": 0.36, "z": 1.32}},
    )
    grid = {"showbackground": False, "gridcolor": "#e3e7ec", "tickformat": ".2f"}
    for axis, *ends in zip("xyz", low.tolist(), high.tolist(), strict=True):
        share = (ends[1] - ends[0]) / corners  # of the box's diagonal: numbers that the axis has room for
        ticks = 6 if share > 0.45 else 4 if share > 0.2 else 2
        figure.layout.scene[f"{axis}axis"].update(grid, title={"text": f"{axis}, m"}, range=ends, nticks=ticks)
    legend = LEGEND | {"font": {"size": 11}}
    return Chart(name, figure.update_layout(margin={"l": 25, "r": 10, "t": 10, "b": 10}, height=600, legend=legend))


def _axes(points: Points) -> dict[str, NDArray[np.float32]]:
    return dict(zip("xyz", np.asarray(points, np.float32).T, strict=True))


def _box(traces: Sequence[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner (3,) m of what holds all traces, with some room around."""
    every = np.concatenate([np.stack([trace[axis] for axis in "xyz"], axis=1) for trace in traces]).astype(float)
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = 0.02 * (high - low).max()
    return low - room, high + room

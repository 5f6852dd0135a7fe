"""A scene of a page that a person turns: clouds, cloths and lines in space, drawn by Plotly."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plotly import graph_objects as go

from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import face_triangles
from studies.report.charts import LEGEND, bare
from studies.report.page import Chart

Points = NDArray[np.floating[Any]]  # (n, 3) m
SHOWN = 700  # target points drawn: few enough that the result is seen between them
TARGET = "#222222"
_REACH = 1.5  # of a scene's box corner to corner, in Plotly's units: it stays in view however it is turned


def cloud(name: str, points: Points, colour: str, size: float = 1.6) -> go.Scatter3d:
    """Return the points of a cloud. size: px."""
    marker = {"size": size, "color": colour}
    return go.Scatter3d(name=name, mode="markers", marker=marker, hoverinfo="skip", **_axes(points))


def target_cloud(points: Points) -> go.Scatter3d:
    """Return some points of a target."""
    return cloud("target", points[:: max(1, len(points) // SHOWN)], TARGET)


def cloth(name: str, points: Points, **style: Any) -> go.Mesh3d:
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
        ticks = _ticks((ends[1] - ends[0]) / corners)
        figure.layout.scene[f"{axis}axis"].update(grid, title={"text": f"{axis}, m"}, range=ends, nticks=ticks)
    legend = LEGEND | {"font": {"size": 11}}
    return Chart(name, figure.update_layout(margin={"l": 25, "r": 10, "t": 10, "b": 10}, height=600, legend=legend))


def _axes(points: Points) -> dict[str, NDArray[np.float32]]:
    return dict(zip("xyz", np.asarray(points, np.float32).T, strict=True))


def _ticks(share: float) -> int:
    """Return how many numbers an axis has room for that takes a share of the box's diagonal."""
    return 6 if share > 0.45 else 4 if share > 0.2 else 2


def _box(traces: Sequence[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner (3,) m of what holds all traces, with some room around."""
    every = np.concatenate([np.stack([trace[axis] for axis in "xyz"], axis=1) for trace in traces]).astype(float)
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = 0.02 * (high - low).max()
    return low - room, high + room

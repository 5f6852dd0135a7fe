"""Figures of a study's result as plotly's JSON: the overlay in 3D and the convergence curve."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.distances import nearest_distances
from fabdesign.mid_surface import at_places, two_faces
from fabdesign.muscle import Muscle
from fabdesign.surface import face_triangles
from fabdesign.units import in_kpa, in_mm
from studies.layouts.result import StudyResult
from studies.report import PlotlyFigure, Trace, chart, scene_layout

SHOWN = 2000  # target points drawn: enough to see the shape through
SAMPLED = 2.4  # mm from the nearest point of a dense cloud, that sampling alone makes: one colour up to there
NEAR, MIDDLE, FAR = "#dbe7f3", "#fdae61", "#b40426"
TICKS = [1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000]  # mm
FRONT, BACK, TARGET = "#b2182b", "#2166ac", "#222222"


def scene_figure(result: StudyResult, pose: int) -> PlotlyFigure:
    """Target cloud over the result's faces, coloured by their distance to the cloud, with the muscles on them."""
    points, target = result.points[pose], result.targets[pose].points
    far = in_mm(nearest_distances(points, target))
    top = max(float(np.ceil(10 * far.max()) / 10), 0.1)
    traces = [
        points_trace(target[:: max(1, len(target) // SHOWN)], "target", TARGET),
        {
            **faces_trace(points),
            "name": "result",
            "intensity": _rounded(far, 2),
            "colorscale": colour_scale(top),
            "cmin": 0,
            "cmax": top,
            "opacity": 0.85,
            "colorbar": {
                "title": {"text": f"mm to the nearest<br>target point,<br>largest {far.max():.1f}"},
                "thickness": 12,
                "len": 0.5,
                "x": 1.0,
            },
            "hovertemplate": "%{intensity:.1f} mm<extra>result</extra>",
        },
        {
            **faces_trace(result.rest),
            "name": "cloth at rest",
            "color": "#b8c2cc",
            "opacity": 0.35,
            "visible": "legendonly",
        },
    ]
    for number, muscle in enumerate(result.design.muscles):
        pressure = in_kpa(result.pressures[pose][muscle.channel])
        traces.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "name": f"muscle {number}, {muscle.side}, channel {muscle.channel}: {pressure:.0f} kPa",
                "line": {"width": 7, "color": FRONT if muscle.side == "front" else BACK},
                "hoverinfo": "name",
                **_axes(_on_cloth(muscle, points, result)),
            }
        )
    return {"data": traces, "layout": scene_layout(traces)}


def colour_scale(top: float) -> list[list[float | str]]:
    """Plotly's, from 0 to `top` mm."""
    begin = SAMPLED / top
    if begin >= 1:
        return [[0.0, NEAR], [1.0, NEAR]]
    return [[0.0, NEAR], [begin, NEAR], [begin + 0.43 * (1 - begin), MIDDLE], [1.0, FAR]]


def convergence_figure(result: StudyResult) -> PlotlyFigure:
    """Every evaluation and the best so far, by stage, with the floor."""
    entries = result.history
    if not entries:
        return chart([], x="evaluation")
    values = in_mm(np.array([entry.objective for entry in entries]))
    numbers = np.arange(1, len(entries) + 1)
    shown = np.array([not entry.diverged for entry in entries])
    stages = list(dict.fromkeys(entry.stage for entry in entries))
    traces: list[Trace] = [
        {
            "mode": "markers",
            "name": "evaluations",
            "marker": {"size": 3, "color": "#9aa5b1"},
            "x": numbers[shown].tolist(),
            "y": _rounded(values[shown], 3),
        }
    ]
    for stage in stages:
        own = np.array([entry.stage == stage for entry in entries])
        best = np.minimum.accumulate(values[own])
        traces.append({"mode": "lines", "name": stage, "x": numbers[own].tolist(), "y": _rounded(best, 3)})
    chamfer = result.study.objective == "chamfer"
    floor = in_mm(result.errors.chamfer_floor if chamfer else result.errors.surface_floor)
    traces.append(
        {
            "mode": "lines",
            "name": "noise floor",
            "line": {"dash": "dash", "color": "#1c2430"},
            "x": [1, len(entries)],
            "y": [floor, floor],
        }
    )
    title = f"{'Chamfer' if chamfer else 'surface RMS'}, mm"
    return chart(traces, x="evaluation", y=title, yaxis={"type": "log", "tickvals": TICKS})


def points_trace(points: NDArray[np.float64], name: str, color: str) -> Trace:
    """Of a cloud (n, 3) m."""
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": name,
        "marker": {"size": 1.6, "color": color},
        "hoverinfo": "skip",
        **_axes(points),
    }


def faces_trace(points: NDArray[np.float64]) -> Trace:
    """Of both faces (2 n n, 3) m."""
    side = round(np.sqrt(len(points) / 2))
    corners = face_triangles(side, side)
    ends = {name: corners[:, k].tolist() for k, name in enumerate("ijk")}
    return {"type": "mesh3d", **_axes(points), **ends, "showlegend": True, "flatshading": False}


def _axes(points: NDArray[np.float64]) -> dict[str, list[float]]:
    return {axis: _rounded(points[:, k], 5) for k, axis in enumerate("xyz")}


def _rounded(values: NDArray[np.float64], digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]


def _on_cloth(muscle: Muscle, points: NDArray[np.float64], result: StudyResult) -> NDArray[np.float64]:
    """(n, 3) m: the muscle's fixed points on its face of the deformed cloth, by bilinear interpolation."""
    fabric, faces = result.design.fabric, two_faces(points)
    places = muscle.fixed_points() / [fabric.width, fabric.height]
    lifted, middle = at_places(faces[0 if muscle.side == "front" else 1], places), at_places(faces.mean(axis=0), places)
    return np.asarray(lifted + 0.6 * (lifted - middle))  # off the face, where the eye sees it

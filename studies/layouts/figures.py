"""Figures of a study's result as plotly's JSON: the overlay in 3D and the convergence curve."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.distances import nearest_distances
from fabdesign.mid_surface import at_places, two_faces
from fabdesign.muscle import Muscle
from fabdesign.surface import face_triangles
from fabdesign.units import in_kpa, in_mm
from fabdesign.wishes import Landmarks
from studies.layouts.result import StudyResult
from studies.layouts.wished import measure_of, reached_and_asked
from studies.report import DARK, GREY, PlotlyFigure, Trace, chart, line, scene_layout

SHOWN = 700  # target points drawn: few enough that the result is seen between them
SAMPLED = 2.4  # mm from the nearest point of a dense cloud, that sampling alone makes: one colour up to there
NEAR, MIDDLE, FAR = "#dbe7f3", "#fdae61", "#b40426"
TICKS = [1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000]  # mm
FRONT, BACK, TARGET = "#b2182b", "#2166ac", "#222222"


def scene_figure(result: StudyResult, pose: int) -> PlotlyFigure:
    """Target cloud over the result's faces, coloured by their distance to the cloud, with the muscles on them."""
    points, target = result.points[pose], result.targets[pose]
    asked = target.landmarks is not None
    traces = [
        *(_wished(target.landmarks, points) if target.landmarks is not None else [_target(target.points)]),
        {
            **faces_trace(points),
            "name": "result",
            **({"color": NEAR} if asked else _by_distance(points, target.points)),
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


def _target(points: NDArray[np.float64]) -> Trace:
    return points_trace(points[:: max(1, len(points) // SHOWN)], "target", TARGET)


def _by_distance(points: NDArray[np.float64], target: NDArray[np.float64]) -> Trace:
    """Of faces: coloured by their distance to a target."""
    far = in_mm(nearest_distances(points, target))
    top = max(float(np.ceil(10 * far.max()) / 10), 0.1)
    title = {"text": f"mm to the nearest<br>target point,<br>largest {far.max():.1f}"}
    return {
        "intensity": _rounded(far, 2),
        "colorscale": colour_scale(top),
        "cmin": 0,
        "cmax": top,
        "opacity": 0.85,
        "colorbar": {"title": title, "thickness": 12, "len": 0.5, "x": 1.0},
        "hovertemplate": "%{intensity:.1f} mm<extra>result</extra>",
    }


def _wished(landmarks: Landmarks, points: NDArray[np.float64]) -> list[Trace]:
    """The places that wishes name, where each was to come, and a line between."""
    reached, asked = reached_and_asked(landmarks, points)
    between = np.stack([reached, asked, np.full_like(asked, np.nan)], axis=1).reshape(-1, 3)
    between_them = {axis: [None if v != v else v for v in values] for axis, values in _axes(between).items()}
    return [
        points_trace(asked, "asked for", TARGET, size=4.5),
        points_trace(reached, "reached", FAR, size=3.5),
        {"type": "scatter3d", "mode": "lines", "name": "from one to the other", "line": {"width": 4, "color": FAR},
         "hoverinfo": "skip", **between_them},
    ]  # fmt: skip


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
            "marker": {"size": 3, "color": GREY},
            "x": numbers[shown].tolist(),
            "y": _rounded(values[shown], 3),
        }
    ]
    for stage in stages:
        own = np.array([entry.stage == stage for entry in entries])
        best = np.minimum.accumulate(values[own])
        traces.append(line(stage, numbers[own].tolist(), _rounded(best, 3)))
    chamfer = result.study.objective == "chamfer"
    floor = in_mm(result.errors.chamfer_floor if chamfer else result.errors.surface_floor)
    if floor > 0:  # of a mesh under surface RMS, and of wishes, there is none
        traces.append(line("noise floor", [1, len(entries)], [floor, floor], DARK, line={"dash": "dash"}))
    sound = [*values[shown], *([floor] if floor > 0 else [])]
    wide = bool(len(sound)) and max(sound) > 2 * min(sound)  # else a logarithmic axis may have no number
    axis = {"type": "log", "tickvals": TICKS} if wide else {}
    return chart(traces, x="evaluation", y=f"{measure_of(result.study)}, mm", yaxis=axis)


def points_trace(points: NDArray[np.float64], name: str, color: str, *, size: float = 1.6) -> Trace:
    """Of a cloud (n, 3) m. size: px."""
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": name,
        "marker": {"size": size, "color": color},
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

"""Charts of a study's result: the overlay in 3D and the convergence curve."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.distances import nearest_distances
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.muscle import Muscle
from fabdesign.units import in_mm
from studies.layout_search.wish_errors import measure_of, reached_and_asked
from studies.layouts.result import StudyResult
from studies.report.charts import DARK, GREY, chart, curve
from studies.report.page import Chart, kpa
from studies.report.scene import cloth, cloud, path, scene, target_cloud

SAMPLED = 2.4  # mm from the nearest point of a dense cloud, that sampling alone makes: one colour up to there
NEAR, MIDDLE, FAR = "#dbe7f3", "#fdae61", "#b40426"
TICKS = [1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000]  # mm
FRONT, BACK, ASKED = "#b2182b", "#2166ac", "#222222"


def overlay(name: str, result: StudyResult, pose: int) -> Chart:
    """Return the target cloud over the result's faces, coloured by their distance to the cloud, with the muscles on
    them."""
    points, target = result.points[pose], result.targets[pose]
    asked = target.landmarks
    colours = _by_distance(points, target.points) if asked is None else {"color": NEAR}
    traces = [
        *([target_cloud(target.points)] if asked is None else _wished(asked, points)),
        cloth("result", points, **colours),
        cloth("cloth at rest", result.rest, color="#b8c2cc", opacity=0.35, visible="legendonly"),
    ]
    for number, muscle in enumerate(result.design.muscles):
        pressure = kpa(result.pressures[pose][muscle.channel])
        words = f"muscle {number}, {muscle.side}, channel {muscle.channel}: {pressure} kPa"
        colour = FRONT if muscle.side == "front" else BACK
        traces.append(path(words, _on_cloth(muscle, points, result), colour, 7))
    return scene(name, traces)


def _by_distance(points: NDArray[np.float64], target: NDArray[np.float64]) -> dict[str, Any]:
    """Return how faces are coloured by their distance to a target."""
    far = in_mm(nearest_distances(points, target))
    top = max(float(np.ceil(10 * far.max()) / 10), 0.1)
    title = {"text": f"mm to the nearest<br>target point,<br>largest {far.max():.1f}"}
    return {
        "intensity": far.astype(np.float32),
        "colorscale": colour_scale(top),
        "cmin": 0,
        "cmax": top,
        "opacity": 0.85,
        "colorbar": {"title": title, "thickness": 12, "len": 0.5, "x": 1.0},
        "hovertemplate": "%{intensity:.1f} mm<extra>result</extra>",
    }


def _wished(landmarks: Landmarks, points: NDArray[np.float64]) -> list[Any]:
    """Return the places that wishes name, where each was to come, and a line between."""
    reached, asked = reached_and_asked(landmarks, points)
    between = np.stack([reached, asked, np.full_like(asked, np.nan)], axis=1).reshape(-1, 3)
    return [
        cloud("asked for", asked, ASKED, 4.5),
        cloud("reached", reached, FAR, 3.5),
        path("from one to the other", between, FAR, 4, hover="skip"),
    ]


def colour_scale(top: float) -> list[list[float | str]]:
    """Return Plotly's, from 0 to `top` mm."""
    begin = SAMPLED / top
    if begin >= 1:
        return [[0.0, NEAR], [1.0, NEAR]]
    return [[0.0, NEAR], [begin, NEAR], [begin + 0.43 * (1 - begin), MIDDLE], [1.0, FAR]]


def convergence(name: str, result: StudyResult) -> Chart:
    """Return every evaluation and the best so far, by stage, with the floor."""
    entries = result.history
    values = in_mm(np.array([entry.objective for entry in entries]))
    numbers = np.arange(1, len(entries) + 1)
    shown = np.array([not entry.diverged for entry in entries], dtype=bool)
    dots = {"size": 3, "color": GREY}
    curves = [curve("evaluations", numbers[shown].tolist(), values[shown], mode="markers", marker=dots)]
    for stage in dict.fromkeys(entry.stage for entry in entries):
        in_stage = np.array([entry.stage == stage for entry in entries])
        curves.append(curve(stage, numbers[in_stage], np.minimum.accumulate(values[in_stage])))
    floor, sound = in_mm(result.floor), values[shown]
    if floor > 0 and entries:  # of a mesh under surface RMS, and of wishes, there is none
        curves.append(curve("noise floor", [1, len(entries)], [floor, floor], DARK, line_dash="dash"))
        sound = np.append(sound, floor)
    wide = len(sound) and max(sound) > 2 * min(sound)  # else a logarithmic axis may have no number
    axis = {"type": "log", "tickvals": TICKS} if wide else {}
    return chart(name, curves, x="evaluation", y=f"{measure_of(result.study)}, mm", yaxis=axis)


def _on_cloth(muscle: Muscle, points: NDArray[np.float64], result: StudyResult) -> NDArray[np.float64]:
    """Return (n, 3) m: the muscle's fixed points on its face of the deformed cloth, by bilinear interpolation."""
    fabric, faces = result.design.fabric, Shape.of(points).faces
    places = muscle.fixed_points() / [fabric.width, fabric.height]
    lifted, middle = at_places(faces[0 if muscle.side == "front" else 1], places), at_places(faces.mean(axis=0), places)
    return np.asarray(lifted + 0.6 * (lifted - middle))  # off the face, where the eye sees it

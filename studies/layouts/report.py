"""The page that shows the result of a study: self-contained, for any browser, without a network."""

import platform
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from fabdesign.drawings.oblique import shape_png
from fabdesign.geometry.distances import nearest_distances
from fabdesign.geometry.metrics import MANY_BEYOND, Errors, beyond_in_words
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import Model
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.pressure import poses_in_words
from fabdesign.units import in_mm
from studies.layout_search.target import LoadedTarget, is_wished, measure_of
from studies.layouts.result import StudyResult
from studies.report import page
from studies.report.charts import DARK, GREY, chart, cloth_mesh, cloud, curve, path, scene, target_cloud
from studies.report.page import Chart, kpa

SAMPLED = 2.4  # mm from the nearest point of a dense cloud, that sampling alone makes: one colour up to there
CLOSE_COLOUR, MIDDLE_COLOUR, FAR_COLOUR = "#dbe7f3", "#fdae61", "#b40426"
TICKS = [1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000]  # mm
FRONT, BACK, ASKED = "#b2182b", "#2166ac", "#222222"


def overlay(name: str, result: StudyResult, pose: int) -> Chart:
    """Return the target cloud over the result's faces, coloured by their distance to the cloud, with the muscles on
    them."""
    points, target = result.points[pose], result.targets[pose]
    asked = target.landmarks
    colours = _by_distance(points, target.points) if asked is None else {"color": CLOSE_COLOUR}
    traces = [
        *([target_cloud(target.points)] if asked is None else _wished(asked, points)),
        cloth_mesh("result", points, **colours),
        cloth_mesh("cloth at rest", result.rest, color="#b8c2cc", opacity=0.35, visible="legendonly"),
    ]
    for number, muscle in enumerate(result.design.muscles):
        pressure = kpa(result.pressure[pose][muscle.channel])
        words = f"muscle {number}, {muscle.side}, channel {muscle.channel}: {pressure} kPa"
        colour = FRONT if muscle.side == "front" else BACK
        traces.append(path(words, _on_cloth(muscle, points, result), colour, 7))
    return scene(name, traces)


def _by_distance(points: Array, target: Array) -> dict[str, Any]:
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


def _wished(landmarks: Landmarks, points: Array) -> list[Any]:
    """Return the places that wishes name, where each was to come, and a line between."""
    reached = np.asarray(at_places(Shape.of(points).middle, landmarks.shares))
    asked = np.where(landmarks.given, landmarks.goals, reached)  # a coordinate that no wish gives is the shape's
    between = np.stack([reached, asked, np.full_like(asked, np.nan)], axis=1).reshape(-1, 3)
    return [
        cloud("asked for", asked, ASKED, 4.5),
        cloud("reached", reached, FAR_COLOUR, 3.5),
        path("from one to the other", between, FAR_COLOUR, 4, hover="skip"),
    ]


def colour_scale(top: float) -> list[list[float | str]]:
    """Return Plotly's, from 0 to `top` mm."""
    begin = SAMPLED / top
    if begin >= 1:
        return [[0.0, CLOSE_COLOUR], [1.0, CLOSE_COLOUR]]
    return [[0.0, CLOSE_COLOUR], [begin, CLOSE_COLOUR], [begin + 0.43 * (1 - begin), MIDDLE_COLOUR], [1.0, FAR_COLOUR]]


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


def _on_cloth(muscle: Muscle, points: Array, result: StudyResult) -> Array:
    """Return (n, 3) m: the muscle's fixed points on its face of the deformed cloth, by bilinear interpolation."""
    fabric, faces = result.design.fabric, Shape.of(points).faces
    places = muscle.fixed_points() / [fabric.width, fabric.height]
    lifted, middle = at_places(faces[0 if muscle.side == "front" else 1], places), at_places(faces.mean(axis=0), places)
    return np.asarray(lifted + 0.6 * (lifted - middle))  # off the face, where the eye sees it


PACKAGES = ("taichi", "nlopt", "numpy", "scipy")
ERRORS = ("Chamfer\nmm", "noise floor\nmm", "surface RMS\nmm", "noise floor\nmm")
WISHED = ("mean distance from\nwhat was asked for, mm", "root mean\nsquare, mm")
_RIG = Markup("""The target is from a <b>synthetic rig</b>: an independent simulation with a model of depth sensors, not
hardware.""")
_WISHES = """Distance of the places that the wishes name from where they were to come, in the coordinates that they
give; the mean is by their weights. There is no cloud, and so no noise floor."""
_ERRORS = """Chamfer: mean nearest distance, unsquared, both directions summed. Its noise floor is the Chamfer distance
of two samples of one surface. Surface RMS: distance of every {} point to the model's faces, capped at 10 mm. Its noise
floor is {}."""


def render_report(title: str, results: Mapping[str, StudyResult], *, more: Sequence[page.Block] = ()) -> str:
    """Return the HTML of one or several studies of the same targets, by their titles: errors, 3D overlay, layout,
    convergence, provenance; `more` comes before the last."""
    studies = [block for number, (name, one) in enumerate(results.items()) for block in _study(number, name, one)]
    first = next(iter(results.values()))
    last = page.Title("Provenance"), page.TableBlock((), [*_provenance(first).items()], left_aligned=(1,))
    return page.html_of(title, [*_head(title, results, first), *studies, *more, *last])


def target_texts(targets: Sequence[LoadedTarget]) -> list[page.Text]:
    """Return what is aimed at."""
    asked = [f"{'Asked for' if target.landmarks else 'Target'}: {target.description}." for target in targets]
    return page.texts("", asked) + page.texts("note", [_RIG] if any(target.synthetic for target in targets) else [])


def error_cells(errors: Errors, *, wished: bool) -> list[float]:
    """Return the cells below ERRORS or WISHED."""
    return [*errors.millimetres().values()][:: 2 if wished else 1]


def _head(title: str, results: Mapping[str, StudyResult], first: StudyResult) -> Iterator[page.Block]:
    """Yield what all studies of a page came to."""
    wished = is_wished(first.study.targets)
    yield page.Title(title, 1)
    poses = [(name, page.sentence(line)) for name, one in results.items() for line in poses_in_words([*one.pressure])]
    line = Markup("<b>{}</b>: {}<br>" if len(results) > 1 else "{1}<br>")
    yield page.Text(Markup("").join(line.format(*pose) for pose in poses), "verdict")
    yield from target_texts(first.targets)
    head = WISHED if wished else (*ERRORS, "points\nbeyond 10 mm")

    def cells(errors: Errors) -> list[object]:
        return [*error_cells(errors, wished=wished), *([] if wished else [f"{errors.beyond:.1%}"])]

    rest = ["cloth at rest, no pressure", *cells(first.rest_errors), "", "", ""]
    if not wished:
        rest[2] = rest[4] = ""  # floors of a single draw
    rows = [
        [
            *(Markup("<b>{}</b>").format(name), *cells(one.errors)),
            *(len(one.design.muscles), len(one.history), f"{one.wall_s:.0f}"),
        ]
        for name, one in results.items()
    ]
    yield page.TableBlock(("", *head, "muscles", "evaluations", "seconds"), [rest, *rows])
    capped = [(name, one.errors.beyond) for name, one in results.items() if one.errors.beyond >= MANY_BEYOND]
    yield from page.texts("note", [page.sentence(f"{name}: {beyond_in_words(share)}") for name, share in capped])
    measured = any(target.measured for target in first.targets)
    noise = "the sensor's noise" if measured else "zero, because the target has no noise"
    how = _WISHES if wished else _ERRORS.format("measured" if measured else "target", noise)
    side = (first.study.model or Model()).points_per_side
    yield page.Text(f"{how} All values are of the full model, with {side} points a side.", "quiet")


def _study(number: int, title: str, result: StudyResult) -> Iterator[page.Block]:
    """Yield what one search came to."""
    reach, loading, robust = result.reach, result.loading_path, result.robust
    failed = sum(entry.diverged for entry in result.history)
    short = " The search had not converged." if reach.lacking and not reach.beyond_noise else ""
    lost = f" {failed} evaluations diverged." if failed else ""
    ended = f"{page.sentence(result.stop_reason)}{short} Seed {result.study.seed}.{lost}"
    tenth = result.after_a_tenth
    yield page.Title(title)
    yield page.Text(ended, "note" if reach.lacking else "quiet")
    early = f"After a tenth of the time the best was at {page.mm(tenth)} mm." if tenth else None
    yield from page.texts("quiet", [early, result.fewer_in_words])
    yield from page.texts("", [result.within_in_words])
    yield from page.texts("note", reach.sentences)
    if loading:
        yield from page.texts("note" if loading.sensitive else "quiet", loading.sentences)
    for pose in range(len(result.targets)):
        yield from _pose(number, result, pose)
    if result.outputs:
        yield page.Title("Outputs", 3)
        yield page.TableBlock((), [(name, *values) for name, values in result.outputs.items()])
    if robust:
        yield page.Title("Manufacturing tolerances: simulated copies", 3)
        yield from page.texts("note" if robust.on_another_branch else "quiet", robust.sentences)
        copies = shape_png(result.points[0], result.targets[0].points, [shape[0] for shape in robust.shapes])
        yield page.Picture(copies, "the shape, its copies with scatter and the target")
    margins = [(name.replace("_", " "), _with_unit(name, margin)) for name, margin in result.constraints.items()]
    limits = [page.Title("Limits", 3), page.TableBlock(("limit", "margin"), margins)]
    yield page.Columns([[page.Title("Convergence", 3), convergence(f"curve-{number}", result)], limits], "wide")


def _pose(number: int, result: StudyResult, pose: int) -> Iterator[page.Block]:
    """Yield the shape of one pose beside its target, and the layout with its pressures."""
    target, muscles, pressures = result.targets[pose], result.design.muscles, result.pressure[pose]
    if len(result.targets) > 1:
        weight = "" if target.weight == 1 else f", weight {target.weight:g}"
        yield page.Title(f"Pose {pose + 1}{weight}", 3)
    rows = []
    for wish in result.study.targets[pose].wishes:
        off = in_mm(Landmarks.of([wish], result.design.fabric).distances(result.points[pose]))
        rows.append((wish.words, float(off.mean()), float(off.max()), f"{wish.weight:g}"))
    if rows:
        yield page.TableBlock(("asked for", "mean distance\nmm", "largest\nmm", "weight"), rows)
    corners = ["\n".join(map(_place, m.path[1:-1])) for m in muscles]
    table = {
        "muscle": range(len(muscles)),
        "channel": [m.channel for m in muscles],
        "side": [m.side for m in muscles],
        "from u, v\nmm": [_place(m.path[0]) for m in muscles],
        **({"by corners at": corners} if any(corners) else {}),
        "to u, v\nmm": [_place(m.path[-1]) for m in muscles],
        "kPa": [page.kpa(pressures[m.channel]) for m in muscles],
    }
    layout = page.LayoutBlock(result.design, pressures, result.study.limits.pressure[1])
    turn = page.Text("Drag: turn. Wheel: zoom. Click a name: hide it.", "quiet")
    flat = [page.Title("Layout and pressures, kPa", 3), layout, page.columns(table)]
    yield page.Columns([[overlay(f"scene-{number}-{pose}", result, pose), turn], flat], "wide")


def _place(point: tuple[float, float]) -> str:
    return f"{page.mm(point[0], 0)}, {page.mm(point[1], 0)}"


def _with_unit(limit: str, margin: float) -> str:
    """Return a margin as people read it; lengths but for what is named here."""
    units = {"pressure": (1e-3, "kPa"), "contraction": (1e2, "%"), "channels": (1.0, ""), "air": (1e6, "cm^3")}
    factor, unit = units.get(limit, (1e3, "mm"))
    return f"{factor * margin:.0f}" if not unit else f"{factor * margin:.1f} {unit}"


def _provenance(result: StudyResult) -> dict[str, str]:
    hashes = ", ".join(target.sha256[:12] for target in result.targets)
    return {
        **({} if is_wished(result.study.targets) else {"target clouds, sha256": hashes}),
        "parameters": "data sheet" if result.study.model is None else "calibrated model",
        "search": "prox-linear local searches over NLopt (SLSQP), derivatives of shapes or differences in batches",
        "versions": page.package_versions(PACKAGES),
        "Python": f"{platform.python_version()} on {platform.system()}",
    }

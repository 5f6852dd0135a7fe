"""The main job on embedded data: a measured cloud becomes pressures for *basic*, then a layout of few muscles; then
what a measured set says about the model that was searched with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize

from fabdesign.drawings.layout_drawing import HALF, HIGH, LOW
from fabdesign.drawings.oblique import box_of, draw_shape
from fabdesign.formats.json_file import plain, read_json, write_json
from fabdesign.geometry.metrics import MANY_BEYOND, beyond_in_words
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import ForwardModel
from fabdesign.output import atomic_file, work_folder, write_text
from fabdesign.runtime.fingerprint import OtherContent, sha256
from fabdesign.runtime.store import read_kept
from fabdesign.study_files.study_file import MuscleChoice, Study, StudyLimits
from fabdesign.study_files.study_targets import Price, TargetFile
from fabdesign.units import in_kpa, in_mm
from optimize.search.evaluations import Evaluations
from studies.demo.measured import DATA, MODEL, SET, ShippedErrors, as_blocks, evaluate_shipped
from studies.demo.measured import as_text as shipped_as_text
from studies.layouts import VERSIONS, StudyResult, render_report, run_study

TARGET = "demo_target.npz"
MEASURED = "measured.json"  # what the measured trials say of the model, kept
FILES = "report.html", "demo.png"
SOURCE = "last frame, 1.5 s after rest, of trial 078 of set rig_a, a basic motion measured on a synthetic rig"
MOST_MUSCLES = 4
NO_WORSE = 1e-3  # of the value: fewer muscles serve only where they come as near
LIMITS = {  # of search at most: on two free cores the demo ends after about three minutes
    "basic": StudyLimits(seconds=120.0, evaluations=120),  # a quarter of a minute there; the same result elsewhere
    "free": StudyLimits(seconds=90.0),
}
TITLES = {"basic": "basic: pressures of eight muscles", "free": "free: a layout of at most four muscles"}


@dataclass(frozen=True, eq=False)
class Demo:
    """Both searches, as far as they came, and what the measured set says; None where a search was interrupted."""

    runs: list[StudyResult]
    shipped: ShippedErrors | None
    json_keys: ClassVar = ("runs", lambda of: [*map(_run, of.runs)]), ("measured_set", "shipped")


def _run(result: StudyResult) -> dict[str, Any]:
    """Return what `demo --json` prints of a search."""
    counts = {"evaluations": len(result.history), "wall_s": result.wall_s}
    return {"name": result.study.name, **plain(result.errors), **counts}


def run_demo(
    out: Path,
    *,
    forward: ForwardModel | None = None,
    coarse: ForwardModel | None = None,
    force: bool = False,
    progress: Callable[[str, Evaluations], None] = lambda name, evaluations: None,
    say: Callable[[str], None] = lambda line: None,
) -> Demo:
    """Run both studies, `basic` and `free`, into folders of these names in `out`, compare the shipped model with
    measured trials, and write `out/report.html` and `out/demo.png`.

    The target's cloth differs from its data sheet, which the simulator uses; the pressures found make up for it.
    Ctrl-C ends the study under way with its result and leaves out the next; the same call goes on, and ends at once
    where all is done. force: search anew. Raises InputError like `run_study`.
    """
    with work_folder(out, made_by="demo", force=force) as work:
        results = _run_studies(work.folder, forward, coarse, progress)
        work.complete = not results[-1].interrupted
        content = _content(work.folder, results)
        shipped = _kept_errors(work.folder, content) if work.complete else None
        if shipped is None or not all((work.folder / name).is_file() for name in FILES):
            if work.complete and shipped is None:
                say("evaluating the shipped model on measured trials")
                shipped = evaluate_shipped(forward=forward)
            sections = {TITLES[result.study.name]: result for result in results}
            with work.adding() as files:
                more = [] if shipped is None else as_blocks(shipped)
                page = render_report("A measured shape becomes a layout", sections, more=more)
                write_text(files / "report.html", page)
                save_picture([*sections.items()], files / "demo.png")
                if shipped is not None:
                    write_json(files / MEASURED, {"content": content, "errors": shipped.kept()})
    return Demo(results, shipped)


def _content(out: Path, results: Sequence[StudyResult]) -> dict[str, str]:
    """Return what the comparison with measured trials and the page depend on, by name."""
    shipped = [*(DATA / SET).rglob("*"), DATA / MODEL, *DATA.glob("*.safetensors")]
    content = {file.relative_to(DATA).as_posix(): sha256(file) for file in sorted(shipped) if file.is_file()}
    for result in results:
        content[result.study.name] = sha256(out / result.study.name / "result.json")
    return content | {"versions": VERSIONS}


def _kept_errors(out: Path, content: dict[str, str]) -> ShippedErrors | None:
    """Return what the last call found, where it depended on the same; None otherwise."""

    def read(file: Path) -> ShippedErrors | None:
        kept = read_json(file)
        return ShippedErrors.of_kept(kept["errors"]) if kept["content"] == content else None

    return read_kept(out / MEASURED, read, "the evaluation")


def _run_studies(
    out: Path, forward: ForwardModel | None, coarse: ForwardModel | None, progress: Callable[[str, Evaluations], None]
) -> list[StudyResult]:
    results: list[StudyResult] = []
    with as_file(files("fabdesign") / "data" / TARGET) as target:
        for study in demo_studies(target):
            show = partial(progress, study.name)
            if results:  # what eight muscles were found to need is worth knowing where there are four
                study = replace(study, start_pressures=results[0].pressure[0])
            search = partial(run_study, study, out / study.name, forward=forward, coarse=coarse, progress=show)
            try:
                result = search()
            except OtherContent:  # of an earlier version, or from other start pressures; the folder is the demo's own
                result = search(force=True)
            results.append(result)
            if result.interrupted:
                break
    return results


def demo_studies(target: Path) -> list[Study]:
    """Return pressures for the catalogue's *basic* layout, and layout and pressures of at most four muscles."""
    cloud = (TargetFile(target, description=SOURCE),)
    basic = build("basic")
    return [
        Study("basic", basic, cloud, limits=LIMITS["basic"]),
        Study(
            "free",
            basic,
            cloud,
            positions=True,
            muscles=MuscleChoice(1, MOST_MUSCLES),
            price=Price(tolerance=NO_WORSE),
            limits=LIMITS["free"],
        ),
    ]


def as_text(demo: Demo) -> str:
    """Return tables for people; distances in mm."""
    head = f"{'mm':8}{'Chamfer':>9}{'floor':>8}{'surface RMS':>13}{'beyond 10 mm':>14}{'evaluations':>13}{'seconds':>9}"
    rows = [f"target: {SOURCE}", head]
    for run in demo.runs:
        mm = run.errors.millimetres()
        distances = f"{mm['chamfer']:9.2f}{mm['chamfer_floor']:8.2f}{mm['surface_rms']:13.2f}{run.errors.beyond:14.1%}"
        rows.append(f"{run.study.name:8}{distances}{len(run.history):13}{run.wall_s:9.0f}")
    rows += [
        f"{run.study.name}: {beyond_in_words(run.errors.beyond)}"
        for run in demo.runs
        if run.errors.beyond >= MANY_BEYOND
    ]
    return "\n".join([*rows, *([] if demo.shipped is None else ["", shipped_as_text(demo.shipped)])])


SHOWN = 1200  # target points drawn
COLOURS = LinearSegmentedColormap.from_list("pressure", [tuple(c / 255) for c in (LOW, HALF, HIGH)])


def save_picture(results: Sequence[tuple[str, StudyResult]], path: Path) -> None:
    """Write a PNG with a row for every (title, result), of its first pose. Raises InputError."""
    figure = plt.figure(figsize=(10.5, 3.9 * len(results)), layout="constrained")
    grid = figure.add_gridspec(len(results), 3, width_ratios=(1.7, 1, 1))
    for row, (title, result) in enumerate(results):
        points, target, errors = result.points[0], result.targets[0].points, result.errors
        scene = figure.add_subplot(grid[row, 0])
        draw_shape(scene, Shape.of(points).middle, target[:: max(1, len(target) // SHOWN)], box_of([points, target]))
        distances = f"Chamfer {in_mm(errors.chamfer):.2f} mm, floor {in_mm(errors.chamfer_floor):.2f}"
        scene.set_title(f"{title}\n{distances}", fontsize=11)
        flat = [figure.add_subplot(grid[row, column]) for column in (1, 2)]
        for axes, side in zip(flat, ("front", "back"), strict=True):
            _draw_face(axes, side, result)
        highest = in_kpa(result.study.limits.pressure[1])
        figure.colorbar(ScalarMappable(Normalize(0, highest), COLOURS), ax=flat, label="kPa", shrink=0.7)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=90, format="png")
    plt.close(figure)


def _draw_face(axes: Axes, side: str, result: StudyResult) -> None:
    fabric, highest = result.design.fabric, result.study.limits.pressure[1]
    for number, muscle in enumerate(result.design.muscles):
        if muscle.side != side:
            continue
        pressure = result.pressure[0][muscle.channel]
        path = in_mm(np.array(muscle.path))
        axes.plot(*path.T, color=COLOURS(pressure / highest), linewidth=5, solid_capstyle="round")
        place = path[0] + (path[-1] - path[0]) * (0.3 + 0.4 * (number % 2))
        box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
        axes.text(place[0], place[1], f"{in_kpa(pressure):.0f}", ha="center", va="center", fontsize=9, bbox=box)
    axes.axhline(0, color="black", linewidth=4)
    axes.set(xlim=(0, in_mm(fabric.width)), ylim=(in_mm(fabric.height), 0), xlabel="u, mm", ylabel="v, mm")
    axes.set_title("front" if side == "front" else "back, seen through the cloth", fontsize=10)
    axes.set_aspect("equal")
    axes.set_facecolor("#f5f6f8")

"""One picture of what studies found: target over result in 3D, and the layout flat beside it (PNG)."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

from fabdesign.units import in_kpa, in_mm

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize

from fabdesign.drawings.layout_drawing import HALF, HIGH, LOW
from fabdesign.output import whole_file
from studies.layouts.result import StudyResult
from studies.report.oblique import box_of
from studies.report.shape_picture import draw_shape, middle_of

SHOWN = 1200  # target points drawn
COLOURS = LinearSegmentedColormap.from_list("pressure", [tuple(c / 255) for c in (LOW, HALF, HIGH)])


def save_picture(results: Sequence[tuple[str, StudyResult]], path: Path) -> None:
    """Write a PNG with a row for every (title, result), of its first pose. Raises InputError."""
    figure = plt.figure(figsize=(10.5, 3.9 * len(results)), layout="constrained")
    grid = figure.add_gridspec(len(results), 3, width_ratios=(1.7, 1, 1))
    for row, (title, result) in enumerate(results):
        _draw_scene(figure.add_subplot(grid[row, 0]), title, result)
        flat = [figure.add_subplot(grid[row, column]) for column in (1, 2)]
        for axes, side in zip(flat, ("front", "back"), strict=True):
            _draw_face(axes, side, result)
        highest = in_kpa(result.study.limits.pressure[1])
        figure.colorbar(ScalarMappable(Normalize(0, highest), COLOURS), ax=flat, label="kPa", shrink=0.7)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=90, format="png")
    plt.close(figure)


def _draw_scene(axes: Axes, title: str, result: StudyResult) -> None:
    points, target = result.points[0], result.targets[0].points
    draw_shape(axes, middle_of(points), target[:: max(1, len(target) // SHOWN)], box_of([points, target]))
    errors = result.errors
    axes.set_title(
        f"{title}\nChamfer {in_mm(errors.chamfer):.2f} mm, floor {in_mm(errors.chamfer_floor):.2f}", fontsize=11
    )


def _draw_face(axes: Axes, side: str, result: StudyResult) -> None:
    fabric, highest = result.design.fabric, result.study.limits.pressure[1]
    for number, muscle in enumerate(result.design.muscles):
        if muscle.side != side:
            continue
        pressure = result.pressures[0][muscle.channel]
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

"""The same side by side as a picture (PNG) of some instants, or an animation (GIF, MP4)."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.ticker import FixedLocator, MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from studies.view.distance import Distance, errors_in_words
from studies.view.items import Item
from studies.view.shapes import CLOUD, MUSCLE, parts_of, vertex_normals

SHOWN = 1500  # points of a cloud drawn
INSTANTS = 5  # of a picture, from the first to the last frame
RATE = 15.0  # Hz of an animation
_UPWARDS = [0, 2, 1]
_ELEVATION, _AZIMUTH = 12, -60  # degrees
_TO_VIEWER = np.array([0.489, 0.208, 0.847])  # x, y, z of the file, whose z is the second axis reversed
_LEAST_WIDTH = 6.0  # inches, that a line of words needs
_LETTERS = 13.0  # an inch holds, of 9 points


def instants_of(items: Sequence[Item], times: Sequence[float]) -> list[float]:
    """s: those asked for, or INSTANTS spread over what there is."""
    if times:
        return list(times)
    begin, end = _span(items)
    return [begin] if end <= begin else np.linspace(begin, end, INSTANTS).tolist()


def save_picture(
    items: Sequence[Item],
    path: Path,
    apart: Sequence[Distance | None],
    times: Sequence[float] = (),
    *,
    overlay: bool = False,
) -> None:
    """Write a PNG with a row an item and a column an instant [s]. apart: how far each panel is from the one it is
    compared with; overlay: whether that one's points lie over it."""
    instants = instants_of(items, times)
    shape = (len(items), len(instants))
    figure = plt.figure(figsize=(max(2.6 * shape[1], _LEAST_WIDTH) + 0.4, 3.1 * shape[0]), layout="constrained")
    box = _box(items)
    rows = figure.subfigures(shape[0], 1, squeeze=False)[:, 0]
    for row, item, distance in zip(rows, items, apart, strict=True):
        drawn = _DrawnPanel(item, _reference(items, distance, overlay))
        row.suptitle(_wrapped(item, distance, figure.get_figwidth()), fontsize=9, x=0.01, ha="left")
        for column, instant in enumerate(instants if item.moves else instants[:1]):
            axes = row.add_subplot(1, shape[1], column + 1, projection="3d")
            frame = item.nearest(instant)
            drawn.draw(axes, frame, box)
            axes.set_title(f"{item.times[frame]:.2f} s" if item.moves else "a still shape", fontsize=8, loc="left")
    figure.savefig(path, dpi=100, format="png")
    plt.close(figure)


def _reference(items: Sequence[Item], distance: Distance | None, overlay: bool) -> Item | None:
    """Return what a panel is compared with, where its points are to lie over the panel."""
    return next((item for item in items if overlay and distance and item.title == distance.reference), None)


def save_animation(
    items: Sequence[Item], path: Path, apart: Sequence[Distance | None], *, overlay: bool = False
) -> None:
    """Write a GIF, or by the ending an MP4, of the items side by side, in real time at RATE. overlay: as in a picture.
    Raises InputError where ffmpeg fails."""
    begin, end = _span(items)
    instants = np.arange(begin, end + 0.5 / RATE, 1 / RATE)
    figure = plt.figure(figsize=(3.4 * len(items), 4.1), layout="constrained")
    panels = [figure.add_subplot(1, len(items), k + 1, projection="3d") for k in range(len(items))]
    drawn = [_DrawnPanel(item, _reference(items, own, overlay)) for item, own in zip(items, apart, strict=True)]
    heads = [_head(item, distance) for item, distance in zip(items, apart, strict=True)]
    box = _box(items)

    def show(instant: float) -> list[Any]:
        for axes, one, head in zip(panels, drawn, heads, strict=True):
            axes.clear()
            one.draw(axes, one.item.nearest(instant), box)
            axes.set_title(f"{head}\n{instant:.2f} s", fontsize=7, loc="left")
        return []

    animation = FuncAnimation(figure, show, frames=instants, blit=False)
    try:
        if path.suffix.lower() == ".mp4":
            _save_video(animation, path)
        else:
            animation.save(path, writer=PillowWriter(fps=round(RATE)), dpi=70)
    finally:
        plt.close(figure)


def _save_video(animation: FuncAnimation, path: Path) -> None:
    """Write by the ffmpeg of the system, else by that of the package imageio-ffmpeg."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        import imageio_ffmpeg

        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    try:
        with plt.rc_context({"animation.ffmpeg_path": ffmpeg}):
            animation.save(path, writer=FFMpegWriter(fps=round(RATE)), dpi=100)
    except (subprocess.CalledProcessError, BrokenPipeError) as error:
        said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()[-1]
        raise InputError(
            f"{path.name}: {Path(ffmpeg).name} cannot write it ({said}); expected room, or a .gif"
        ) from None


def _wrapped(item: Item, distance: Distance | None, width: float) -> str:
    """Return what stands over a row, in lines that a picture of `width` inches holds."""
    lines = [item.title, *([_distance_in_words(distance)] if distance else [])]
    return "\n".join(part for line in lines for part in wrap(line, int(_LETTERS * width)))


def _distance_in_words(distance: Distance) -> str:
    when = f"{distance.when}, " if distance.when else ""
    return f"from {distance.reference}: {when}{errors_in_words(distance.whole)}"


def _head(item: Item, distance: Distance | None) -> str:
    """As many lines for every panel, so that all stay alike."""
    more = ["", "", ""]
    if distance is not None:
        more = [f"from {distance.reference}, {distance.when}:", *errors_in_words(distance.whole).split(", ")]
    return "\n".join([item.title, *(more + [""])[:3]])


def _span(items: Sequence[Item]) -> tuple[float, float]:
    return min(float(item.times[0]) for item in items), max(float(item.times[-1]) for item in items)


def _box(items: Sequence[Item]) -> np.ndarray:
    """(2, 3) m, lowest and highest coordinates of all."""
    ends = [(frame.min(axis=0), frame.max(axis=0)) for item in items for frame in item.frames if len(frame)]
    return np.array([np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)])


class _DrawnPanel:
    """A panel that is drawn frame by frame, the file's y upwards: matplotlib's vertical axis is its third."""

    def __init__(self, item: Item, below: Item | None = None) -> None:
        self.item, self._below = item, below
        parts = [part for part in parts_of(item) if part.triangles.max() < len(item.frames[0])]  # muscles are lines
        self._corners = np.concatenate([np.zeros((0, 3), int), *(part.triangles for part in parts)])
        self._colours = np.repeat([part.colour for part in parts], [len(part.triangles) for part in parts], axis=0)

    def draw(self, axes: Any, frame: int, box: np.ndarray) -> None:
        points = np.asarray(self.item.frames[frame])[:, _UPWARDS]
        if not len(self._corners):
            shown = points[:: -(-len(points) // SHOWN)]
            axes.scatter(*shown.T, s=1.2, color=CLOUD, depthshade=False)
        else:
            colours = {"facecolors": self._colours, "edgecolors": self._colours}
            axes.add_collection3d(Poly3DCollection(points[self._corners], **colours, linewidths=0.1, shade=True))
            if len(muscles := self._seen_muscles(frame)):
                axes.add_collection3d(Line3DCollection(muscles, colors=[MUSCLE], zorder=10))
        if self._below is not None:
            cloud = np.asarray(self._below.frames[self._below.nearest(self.item.times[frame])])[:, _UPWARDS]
            axes.scatter(*cloud[:: -(-len(cloud) // SHOWN)].T, s=1.2, color=CLOUD, depthshade=False, zorder=20)
        low, high = box[:, _UPWARDS]
        axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), zlim=(low[2], high[2]))
        axes.computed_zorder = False
        sides = np.maximum(high - low, 0.02)
        axes.set_box_aspect(sides)
        axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
        axes.tick_params(labelsize=6, pad=-2)
        for axis, share in zip(axes._axis_map.values(), sides / sides.max(), strict=True):
            # a shallow axis has room for one number
            axis.set_major_locator(MaxNLocator(3 if share > 0.5 else 2) if share > 0.35 else FixedLocator([0.0]))

    def _seen_muscles(self, frame: int) -> np.ndarray:
        """(n, 2, 3) m: intervals on a face that looks towards the viewer. Drawn last, since by their depth matplotlib
        would sort them half into the cloth; a fold in front does not hide them."""
        muscles, points = self.item.muscles, np.asarray(self.item.frames[frame])
        if muscles is None or not len(muscles.sides):
            return np.zeros((0, 2, 3))
        ends = muscles.points[frame][muscles.intervals]
        normals = vertex_normals(points, self._corners)
        half, seen = len(points) // 2, np.zeros(len(ends), dtype=bool)
        for side, face in ((1, slice(0, half)), (-1, slice(half, None))):
            own = muscles.sides[muscles.owners] == side
            nearest = cKDTree(points[face]).query(ends[own].mean(axis=1))[1]
            seen[own] = normals[face][nearest] @ _TO_VIEWER > 0
        return np.asarray(ends[seen][:, :, _UPWARDS])

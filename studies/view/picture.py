"""Items side by side as a picture (PNG) of some instants, or an animation (GIF, MP4)."""

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
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.spatial import cKDTree

from fabdesign.drawings import oblique
from fabdesign.errors import InputError
from studies.view.items import Item, errors_in_words, timeline
from studies.view.shapes import CLOUD, MUSCLE, OVERLAY, key_of, parts_of, vertex_normals

SHOWN = 1500  # points of a cloud drawn
INSTANTS = 5  # of a picture, from the first to the last frame
RATE = 15.0  # Hz of an animation
_WIDE, _NARROW = 6.0, 2.6  # inches: a still shape, and an instant of a motion
_LINE = 0.16  # inches, of words of 9 points
_LEAST_WIDTH = 6.0  # inches, that a line of words needs
_LETTERS = 13.0  # an inch holds, of 9 points


def save_picture(items: Sequence[Item], path: Path, times: Sequence[float] = (), *, overlay: bool = False) -> None:
    """Write a PNG with a row an item and a column an instant [s]: those asked for, or at most INSTANTS frames spread
    over what there is. overlay: whether over a panel lie the points of what it is compared with."""
    every = timeline(items)
    spread = every[np.unique(np.linspace(0, len(every) - 1, INSTANTS).round().astype(int))].tolist()
    instants = (list(times) or spread) if any(item.moves for item in items) else [0.0]
    drawn = _DrawnPanels(items, overlay)
    width = _WIDE if len(instants) == 1 else _NARROW
    size = max(width * len(instants), _LEAST_WIDTH) + 0.2
    heads = [wrapped_head(item, size) for item in items]
    heights = [width * drawn.tall + 0.35 + _LINE * (head.count("\n") + 1) for head in heads]
    figure = plt.figure(figsize=(size, sum(heights) + 0.4), layout="constrained")
    drawn.draw_key(figure)
    rows = figure.subfigures(len(items), 1, squeeze=False, height_ratios=heights)[:, 0]
    for number, (row, item, head) in enumerate(zip(rows, items, heads, strict=True)):
        row.suptitle(head, fontsize=9, x=0.01, ha="left")
        for axes, instant in zip(row.subplots(1, len(instants), squeeze=False)[0], instants, strict=True):
            frame = item.nearest(instant)
            drawn.draw(axes, number, frame)
            axes.set_title(f"{item.times[frame]:.2f} s" if item.moves else "a still shape", fontsize=8, loc="left")
    figure.savefig(path, dpi=100, format="png")
    plt.close(figure)


def save_animation(items: Sequence[Item], path: Path, *, overlay: bool = False) -> None:
    """Write a GIF, or by the ending an MP4, of the items side by side, in real time at RATE. overlay: as in a picture.
    Raises InputError where ffmpeg fails."""
    begin, end = min(float(item.times[0]) for item in items), max(float(item.times[-1]) for item in items)
    instants = np.arange(begin, end + 0.5 / RATE, 1 / RATE)
    drawn = _DrawnPanels(items, overlay)
    size = max(3.4 * len(items), _LEAST_WIDTH), 3.4 * drawn.tall + 1.0
    figure = plt.figure(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(items), squeeze=False)[0]
    drawn.draw_key(figure)

    def show(instant: float) -> list[Any]:
        for number, (axes, item) in enumerate(zip(panels, items, strict=True)):
            axes.clear()
            drawn.draw(axes, number, item.nearest(instant))
            axes.set_title(f"{_head(item)}\n{instant:.2f} s", fontsize=7, loc="left")
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
        message = (getattr(error, "stderr", None) or str(error)).strip().splitlines()[-1]
        raise InputError(
            f"{path.name}: {Path(ffmpeg).name} cannot write it ({message}); expected room, or a .gif"
        ) from None


def wrapped_head(item: Item, width: float) -> str:
    """Return what stands over a row, in lines that a picture of `width` inches holds."""
    lines = [item.title]
    if (distance := item.apart) is not None:
        when = f"{distance.when}, " if distance.when else ""
        lines.append(f"from {distance.reference}: {when}{errors_in_words(distance.overall)}")
    return "\n".join(part for line in lines for part in wrap(line, int(_LETTERS * width)))


def _head(item: Item) -> str:
    """Return a head of as many lines for every panel, so that all stay alike."""
    more = list[str]()
    if (distance := item.apart) is not None:
        more = [f"from {distance.reference}, {distance.when}:", *errors_in_words(distance.overall).split(", ")]
    return "\n".join([item.title, *more, "", "", ""][:4])


class _DrawnPanels:
    """Panels that are drawn frame by frame, all in one room. overlay: whether over a panel lie the points of what it is
    compared with. tall: height over width of a panel."""

    def __init__(self, items: Sequence[Item], overlay: bool) -> None:
        self._items, self._overlay = items, overlay
        by_title = {item.title: item for item in items}
        self._below = [by_title[item.apart.reference] if overlay and item.apart else None for item in items]
        self._room = oblique.box_of([frame for item in items for frame in item.frames])
        low, high = oblique.extent(self._room)
        self.tall = float((high[1] - low[1]) / (high[0] - low[0]))

    def draw_key(self, figure: Figure) -> None:
        """Write below all panels what their colours stand for."""
        key = key_of(self._items, overlay=self._overlay and len(self._items) > 1)
        style: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 5}
        marks = [Line2D([], [], color=colour, label=name, **style) for name, colour in key]
        spacing = {"handletextpad": 0.1, "columnspacing": 1.2}
        figure.legend(handles=marks, loc="outside lower left", ncols=len(key), frameon=False, fontsize=8, **spacing)

    def draw(self, axes: Any, number: int, frame: int) -> None:
        item, below = self._items[number], self._below[number]
        points = np.asarray(item.frames[frame])
        parts = [part for part in parts_of(item) if part.triangles.max() < len(points)]  # muscles are lines
        if not parts:
            oblique.draw_points(axes, points[:: -(-len(points) // SHOWN)], CLOUD)
        else:
            triangles = np.concatenate([part.triangles for part in parts])
            colours = np.repeat([part.colour for part in parts], [len(part.triangles) for part in parts], axis=0)
            corners = points[triangles]
            # of a cloth's two faces only what looks towards the viewer: they are too near to be sorted by depth
            seen = oblique.facing(corners) if item.is_cloth else slice(None)
            oblique.draw_triangles(axes, corners[seen], colours[seen])
            if len(muscles := _seen_muscles(item, frame, triangles)):
                oblique.draw_lines(axes, muscles, MUSCLE)
        if below is not None:
            cloud = np.asarray(below.frames[below.nearest(item.times[frame])])
            oblique.draw_points(axes, cloud[:: -(-len(cloud) // SHOWN)], OVERLAY)
        oblique.draw_room(axes, self._room)


def _seen_muscles(item: Item, frame: int, triangles: np.ndarray) -> np.ndarray:
    """Return (n, 2, 3) m: intervals on a face that looks towards the viewer. Drawn last, since by their depth
    matplotlib would sort them half into the cloth; a fold in front does not hide them."""
    muscles, points = item.muscles, np.asarray(item.frames[frame])
    if muscles is None or not len(muscles.sides):
        return np.zeros((0, 2, 3))
    ends = muscles.points[frame][muscles.intervals]
    normals = vertex_normals(points, triangles)
    half, seen = len(points) // 2, np.zeros(len(ends), dtype=bool)
    for side, face in ((1, slice(0, half)), (-1, slice(half, None))):
        on_side = muscles.sides[muscles.owners] == side
        nearest = cKDTree(points[face]).query(ends[on_side].mean(axis=1))[1]
        seen[on_side] = normals[face][nearest] @ oblique.TO_VIEWER > 0
    return np.asarray(ends[seen])

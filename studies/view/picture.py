"""The same side by side as a picture (PNG) of some instants, or an animation (GIF)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from studies.view.items import Item

SHOWN = 1500  # points of a cloud drawn
FRONT, BACK, CLOUD = "#cc3838", "#3873bf", "#222b3d"
INSTANTS = 5  # of a picture, from the first to the last frame
RATE = 15.0  # Hz of an animation


def instants_of(items: Sequence[Item], times: Sequence[float]) -> list[float]:
    """s: those asked for, or INSTANTS spread over what there is."""
    if times:
        return list(times)
    begin, end = _span(items)
    return [begin] if end <= begin else np.linspace(begin, end, INSTANTS).tolist()


def save_picture(items: Sequence[Item], path: Path, times: Sequence[float] = ()) -> None:
    """A PNG with a row an item and a column an instant [s]."""
    instants = instants_of(items, times)
    shape = (len(items), len(instants))
    figure = plt.figure(figsize=(2.6 * shape[1] + 0.4, 2.9 * shape[0]), layout="constrained")
    box = _box(items)
    for row, item in enumerate(items):
        for column, instant in enumerate(instants):
            axes = figure.add_subplot(*shape, row * shape[1] + column + 1, projection="3d")
            frame = item.nearest(instant)
            _draw(axes, item, frame, box)
            name = f"{item.title}\n" if column == 0 else "\n"
            axes.set_title(f"{name}{item.times[frame]:.2f} s", fontsize=9, loc="left")
    figure.savefig(path, dpi=100, format="png")
    plt.close(figure)


def save_animation(items: Sequence[Item], path: Path) -> None:
    """A GIF of the items side by side, in real time at RATE."""
    begin, end = _span(items)
    instants = np.arange(begin, end + 0.5 / RATE, 1 / RATE)
    figure = plt.figure(figsize=(3.2 * len(items), 3.4), layout="constrained")
    panels = [figure.add_subplot(1, len(items), k + 1, projection="3d") for k in range(len(items))]
    box = _box(items)

    def show(instant: float) -> list[Any]:
        for axes, item in zip(panels, items, strict=True):
            axes.clear()
            _draw(axes, item, item.nearest(instant), box)
            axes.set_title(f"{item.title}\n{instant:.2f} s", fontsize=9, loc="left")
        return []

    FuncAnimation(figure, show, frames=instants, blit=False).save(path, writer=PillowWriter(fps=round(RATE)), dpi=70)
    plt.close(figure)


def _span(items: Sequence[Item]) -> tuple[float, float]:
    return min(float(item.times[0]) for item in items), max(float(item.times[-1]) for item in items)


def _box(items: Sequence[Item]) -> np.ndarray:
    """(2, 3) m, lowest and highest coordinates of all."""
    ends = [(frame.min(axis=0), frame.max(axis=0)) for item in items for frame in item.frames if len(frame)]
    return np.array([np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)])


def _draw(axes: Any, item: Item, frame: int, box: np.ndarray) -> None:
    """With the file's y upwards: matplotlib's vertical axis is its third."""
    points = np.asarray(item.frames[frame])[:, [0, 2, 1]]
    if item.triangles is None:
        shown = points[:: -(-len(points) // SHOWN)]
        axes.scatter(*shown.T, s=1.2, color=CLOUD, depthshade=False)
    else:
        half = len(item.triangles) // 2
        colours = [FRONT] * half + [BACK] * (len(item.triangles) - half)
        corners = points[item.triangles]
        axes.add_collection3d(
            Poly3DCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.1, shade=True)
        )
    low, high = box[:, [0, 2, 1]]
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(np.maximum(high - low, 0.02))
    axes.view_init(elev=12, azim=-60)
    axes.tick_params(labelsize=6, pad=-2)
    axes.locator_params(nbins=3)

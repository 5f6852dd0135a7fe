"""Shapes in space drawn flat, as seen from the front at an angle: a parallel projection, so that lengths compare
between pictures and a picture is as large as what it shows; and a shape beside its target, from there and from the
side."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import front_triangles
from fabdesign.nouns.array import Array
from fabdesign.units import in_mm

Box = Array  # (2, 3) m, lowest and highest coordinates

YAW, PITCH = np.radians(34), np.radians(13)  # of the viewer, to the right of the front and above it
RIGHT = np.array([np.cos(YAW), 0.0, -np.sin(YAW)])
TO_VIEWER = np.array([np.cos(PITCH) * np.sin(YAW), np.sin(PITCH), np.cos(PITCH) * np.cos(YAW)])
UP = np.cross(TO_VIEWER, RIGHT)
_LIGHT = np.array([0.3, 0.4, 0.85]) / np.linalg.norm([0.3, 0.4, 0.85])
_GRID = 0.05  # m
_LINES = "#d5dbe3"


def flat(points: Any) -> Array:
    """Return (..., 2) m in the picture of points (..., 3) m."""
    return np.asarray(np.asarray(points, float) @ np.stack([RIGHT, UP], axis=1))


def facing(corners: Array) -> NDArray[np.bool_]:
    """Return (t,) whether triangles (t, 3, 3) m, whose corners go round to the left as seen from outside, look towards
    the viewer."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ TO_VIEWER > 0)


def draw_triangles(axes: Any, corners: Array, colours: Array) -> None:
    """Draw triangles (t, 3, 3) m, the farthest first, in colours (t, 3 or 4) that the light shades."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    shaded = np.array(colours, float)
    shaded[:, :3] *= (0.45 + 0.55 * np.abs(normals @ _LIGHT))[:, None]
    order = np.argsort(corners.mean(axis=1) @ TO_VIEWER)
    edges = shaded[order] if shaded.shape[1] == 3 else "none"  # seams of what is not seen through are closed
    axes.add_collection(
        PolyCollection(list(flat(corners[order])), facecolors=shaded[order], edgecolors=edges, linewidths=0.3)
    )


def draw_points(axes: Any, points: Any, colour: Any) -> None:
    """Draw points (n, 3) m, larger ones where they are few."""
    size = 2.5 * float(np.clip(600 / max(len(points), 1), 1, 4))  # points squared
    axes.scatter(*flat(points).T, s=size, color=colour, linewidths=0, zorder=20)


def draw_lines(axes: Any, ends: Array, colour: Any) -> None:
    """Draw straight lines (n, 2, 3) m over all."""
    axes.add_collection(LineCollection(list(flat(ends)), colors=[colour], linewidths=1.6, zorder=10))


def draw_room(axes: Any, box: Box) -> None:
    """Draw a grid on the floor below a box and fit the axes to both, with the grid's size in words."""
    low, high = np.array(box, float)
    first, last = np.floor(low / _GRID) * _GRID, np.ceil(high / _GRID) * _GRID
    lines = [[[x, low[1], first[2]], [x, low[1], last[2]]] for x in np.arange(first[0], last[0] + _GRID / 2, _GRID)] + [
        [[first[0], low[1], z], [last[0], low[1], z]] for z in np.arange(first[2], last[2] + _GRID / 2, _GRID)
    ]
    axes.add_collection(LineCollection(list(flat(lines)), colors=_LINES, linewidths=0.7, zorder=0))
    least, most = extent(box)
    axes.set(xlim=(least[0], most[0]), ylim=(least[1], most[1]), aspect="equal")
    axes.set_axis_off()
    axes.text(0.0, 0.0, f"grid {in_mm(_GRID):g} mm", transform=axes.transAxes, fontsize=7, color="#5a6675")


def extent(box: Box) -> tuple[Array, Array]:
    """Return the lower left and the upper right corner (2,) m of the picture of a box with its floor."""
    low, high = np.array(box, float)
    first, last = np.floor(low / _GRID) * _GRID, np.ceil(high / _GRID) * _GRID
    floor = flat([[x, low[1], z] for x in (first[0], last[0]) for z in (first[2], last[2])])
    body = flat([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    every = np.concatenate([floor, body])
    room = 0.02 * np.ptp(every, axis=0).max()
    return every.min(axis=0) - room, every.max(axis=0) + room


def box_of(frames: Sequence[Any]) -> Box:
    """Return (2, 3) m, the lowest and highest coordinates of all points (n, 3) m."""
    some = [np.asarray(frame, float) for frame in frames if len(frame)]
    low, high = np.min([f.min(axis=0) for f in some], axis=0), np.max([f.max(axis=0) for f in some], axis=0)
    return np.array([low, np.maximum(high, low + 0.005)])


def wires_svg(faces: Any, every: int = 8) -> str:
    """Return lines of cloths (frames, rows, columns, 3) m as SVG: the last frame blue, those before grey."""
    shown = flat(faces) * (1e3, -1e3)
    low, high = shown.reshape(-1, 2).min(axis=0) - 4, shown.reshape(-1, 2).max(axis=0) + 4
    groups = []
    for k, frame in enumerate(shown):
        colour = "#1f6fb2" if k == len(shown) - 1 else "#b9c2cd"
        wires = (*frame[::every, ::2], *frame[::2, ::every].swapaxes(0, 1))
        drawn = "".join(f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in wire)}"/>' for wire in wires)
        groups.append(f'<g fill="none" stroke="{colour}">{drawn}</g>')
    box = " ".join(f"{value:.1f}" for value in (*low, *(high - low)))
    return f'<svg viewBox="{box}" style="max-height: 18rem" role="img" aria-label="cloth">{"".join(groups)}</svg>'


SHOWN = 900  # points of the target drawn
CLOTH, TARGET = "#8fb3d9", "#b2182b"
WIDTH, HEIGHT, DPI = 9.0, 4.4, 90  # inches of a picture, and dots an inch


def shape_png(points: Array, target: Array, copies: Sequence[Array] = ()) -> bytes:
    """Return a PNG. points (2 n n, 3) m: front face, then back face; target (n, 3) m. copies: shapes like
    `points` whose columns are drawn thinly in the side view."""
    middle, others = Shape.of(points).middle, [Shape.of(copy).middle for copy in copies]
    some = target[:: max(1, len(target) // SHOWN)]
    every = np.concatenate([middle.reshape(-1, 3), some, *(other.reshape(-1, 3) for other in others)])
    box = box_of([every])
    low, high = box + [[-0.005], [0.005]]
    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    draw_shape(figure.add_subplot(1, 2, 1), middle, some, box)
    _from_the_side(figure.add_subplot(1, 2, 2), middle, others, some, low, high)
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=DPI, metadata={"Software": None})
    return data.getvalue()


def draw_shape(axes: Any, middle: Array, target: Array, box: Array) -> None:
    """Draw a cloth's nodes (n, n, 3) m and the points of its target, from the front at an angle."""
    side = len(middle)
    corners = middle.reshape(-1, 3)[front_triangles(side, side)]
    draw_triangles(axes, corners, np.tile(to_rgba(CLOTH, 0.75), (len(corners), 1)))
    draw_points(axes, target, TARGET)
    draw_room(axes, box)


def _from_the_side(axes: Any, middle: Array, others: Sequence[Array], target: Array, low: Array, high: Array) -> None:
    """Draw the columns of the cloth, z to the right and y upwards, in mm."""
    axes.plot(in_mm(target[:, 2]), in_mm(target[:, 1]), ".", markersize=2.5, color=TARGET, label="target")
    columns = np.linspace(0, len(middle) - 1, 9).round().astype(int)
    for other in others:
        for k in columns[::4]:
            axes.plot(in_mm(other[:, k, 2]), in_mm(other[:, k, 1]), "-", color="#7a8694", linewidth=0.6)
    if others:
        axes.plot([], [], "-", color="#9aa5b1", label="copies with scatter, three columns")
    for k in columns:
        axes.plot(in_mm(middle[:, k, 2]), in_mm(middle[:, k, 1]), "-", color="#2f5f8f", linewidth=1.0)
    axes.plot([], [], "-", color="#2f5f8f", label="cloth, nine columns")
    axes.set(xlim=(in_mm(low[2]), in_mm(high[2])), ylim=(in_mm(low[1]), in_mm(high[1])))
    axes.set(xlabel="z, mm (from the side)", ylabel="y, mm", aspect="equal")
    axes.legend(fontsize="small", frameon=False, loc="lower left", bbox_to_anchor=(0, 1))

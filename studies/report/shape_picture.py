"""A shape beside its target as a picture in a page: from the front at an angle, and from the side."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from fabdesign.drawings.oblique import box_of, draw_points, draw_room, draw_triangles
from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import front_triangles
from fabdesign.nouns.array import Array
from fabdesign.units import in_mm

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

"""Where a design's muscles lie, as fields on a coarse grid over the cloth."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design

Array = NDArray[np.float64]

NODES = 11  # a side of the grid on which a corrector sees the cloth
_DENSITY = 50.0  # 1/m of muscle per area that counts as one
_SAMPLES = 8  # an interval between fixed points


@dataclass(frozen=True, eq=False)
class Interval:
    """Between two fixed points of one muscle."""

    muscle: int
    start: Array  # (2,) (u, v) m
    end: Array  # (2,) (u, v) m
    along: float  # share of the muscle's length at its middle

    @property
    def length(self) -> float:
        """m, on the flat cloth."""
        return float(np.linalg.norm(self.end - self.start))


def intervals_of(design: Design) -> list[Interval]:
    """All intervals, muscle by muscle."""
    intervals = []
    for m, muscle in enumerate(design.muscles):
        done = 0.0
        for a, b in pairwise(muscle.fixed_points()):
            length = float(np.linalg.norm(b - a))
            intervals.append(Interval(m, a, b, (done + length / 2) / muscle.length))
            done += length
    return intervals


def deposits(design: Design, nodes: int = NODES) -> Array:
    """(2, intervals, 3, nodes, nodes): on the front and on the back, how much of each interval lies around each node
    (rows: rising v, columns: rising u), times its direction's components uu, vv and uv.

    Length per area, spread over the four nodes around each piece, by `_DENSITY`; a straight muscle has about 1 on the
    nodes under it. What is spread so keeps its direction and side: a layout is an arrangement of the same pieces.
    """
    fabric = design.fabric
    intervals = intervals_of(design)
    result = np.zeros((2, len(intervals), 3, nodes, nodes))
    spacing = np.array([fabric.width, fabric.height]) / (nodes - 1)
    shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    for i, interval in enumerate(intervals):
        direction = (interval.end - interval.start) / interval.length
        tensor = np.array([direction[0] ** 2, direction[1] ** 2, direction[0] * direction[1]])
        amount = interval.length / _SAMPLES / spacing.prod() / _DENSITY
        side = 0 if design.muscles[interval.muscle].side == "front" else 1
        for at in interval.start + shares[:, None] * (interval.end - interval.start):
            for row, col, weight in around(at, fabric.width, fabric.height, nodes):
                result[side, i, :, row, col] += amount * weight * tensor
    return result


def around(at: Array, width: float, height: float, nodes: int) -> list[tuple[int, int, float]]:
    """(row, column, weight) of the four nodes around (u, v) [m]: bilinear interpolation."""
    x = np.clip(np.asarray(at) / (width, height), 0, 1) * (nodes - 1)
    first = np.minimum(x.astype(int), nodes - 2)
    u, v = x - first
    col, row = (int(k) for k in first)
    return [
        (row, col, (1 - u) * (1 - v)),
        (row, col + 1, u * (1 - v)),
        (row + 1, col, (1 - u) * v),
        (row + 1, col + 1, u * v),
    ]

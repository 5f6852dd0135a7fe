"""Where a design's muscles lie, as fields on a coarse grid over the cloth."""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design

Array = NDArray[np.float64]

NODES = 11  # a side of the grid on which a corrector sees the cloth
_DENSITY = 50.0  # 1/m of muscle per area that counts as one
_SAMPLES = 8  # an interval between fixed points


@dataclass(frozen=True, eq=False)
class Interval:
    """The part of a muscle between two fixed points."""

    muscle: int
    start: Array  # (2,) (u, v) m
    end: Array  # (2,) (u, v) m
    along: float  # share of the muscle's length at its middle


def intervals_of(design: Design) -> list[Interval]:
    """Return all intervals, muscle by muscle."""
    intervals = []
    for m, muscle in enumerate(design.muscles):
        done, whole = 0.0, muscle.length
        for a, b in pairwise(muscle.fixed_points()):
            length = float(np.linalg.norm(b - a))
            intervals.append(Interval(m, a, b, (done + length / 2) / whole))
            done += length
    return intervals


def deposits(design: Design, nodes: int = NODES) -> Array:
    """Return (2, intervals, 3, nodes, nodes): on the front and on the back, how much of each interval lies around each
    node (rows: rising v, columns: rising u), times its direction's components uu, vv and uv.

    Length per area, spread over the four nodes around each piece, by `_DENSITY`; a straight muscle has about 1 on the
    nodes under it. What is spread so keeps its direction and side: a layout is an arrangement of the same pieces.
    """
    intervals = intervals_of(design)
    result = np.zeros((2, len(intervals), 3, nodes, nodes))
    if not intervals:
        return result
    size = np.array([design.fabric.width, design.fabric.height])
    start, way = np.array([i.start for i in intervals]), np.array([i.end - i.start for i in intervals])
    length = np.linalg.norm(way, axis=1)
    u, v = (way / length[:, None]).T
    shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    around = _around(start[:, None] + shares[:, None] * way[:, None], size, nodes)
    amount = length / _SAMPLES / np.prod(size / (nodes - 1)) / _DENSITY
    side = [0 if design.muscles[i.muscle].side == "front" else 1 for i in intervals]
    result[side, np.arange(len(intervals))] = (
        np.stack([u * u, v * v, u * v], axis=1)[:, :, None, None] * (amount[:, None, None] * around)[:, None]
    )
    return result


def _around(at: Array, size: Array, nodes: int) -> Array:
    """Return (n, nodes, nodes): sums of the bilinear weights of points (n, k, 2) [m] of a cloth of `size` (2,) m."""
    x = np.clip(at / size, 0, 1) * (nodes - 1)
    first = np.minimum(x.astype(int), nodes - 2)
    u, v = np.moveaxis(x - first, -1, 0)
    of = np.arange(len(at))[:, None]
    result = np.zeros((len(at), nodes, nodes))
    for right, down in product((0, 1), repeat=2):
        weight = (u if right else 1 - u) * (v if down else 1 - v)
        np.add.at(result, (of, first[..., 1] + down, first[..., 0] + right), weight)
    return result

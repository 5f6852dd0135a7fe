"""The fixed points of a design on the grid: which nodes each holds, and the intervals between them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from sim.design.loops import line_weights, patch_size
from sim.state import PATCH

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lacing:
    """The fixed points of one design on an n x n grid; interval k runs from point k to k + 1 where `active`."""

    base: NDArray[np.int32]  # (p, 2) row and column of the first node
    weights: Array  # (6, p, PATCH): wu, wv, du, dv, eu, ev, zeros behind
    offset: Array  # (p,) m, signed: positive on the front
    active: Array  # (p,) 1 where an interval starts
    rest: Array  # (p,) m
    channel: NDArray[np.int32]  # (p,)
    muscle_type: tuple[str, ...]  # (p,)
    muscle: NDArray[np.int32]  # (p,) which of the design's
    along: Array  # (p,) the interval's middle from the muscle's first end, over its length


def touched(design: Design, n: int) -> tuple[int, int]:
    """Return how many nodes across and down a loop of this design can touch."""
    return patch_size(n, design.fabric.width / (n - 1)), patch_size(n, design.fabric.height / (n - 1))


def lace(design: Design, n: int, across: int, down: int) -> Lacing:
    """Return the fixed points with the weights of across x down nodes around each."""
    hu, hv = design.fabric.width / (n - 1), design.fabric.height / (n - 1)
    weights = [np.zeros((6, 0, PATCH))]
    base = [np.zeros((0, 2), np.int32)]
    offset, active, rest, channel, types, kinds, along = [], [], [], [], [], [], []
    for index, muscle in enumerate(design.muscles):
        first, touching, lengths = _loops(muscle, n, hu, hv, across, down)
        count = len(first)
        base.append(first)
        weights.append(touching)
        kinds += [index] * count
        along += [*((np.cumsum(lengths) - lengths / 2) / lengths.sum()), 0.0]
        side = 1.0 if muscle.side == "front" else -1.0
        offset += [side * design.muscle_types[muscle.type].axis_offset] * count
        active += [1.0] * (count - 1) + [0.0]
        rest += [*lengths, 1.0]
        channel += [muscle.channel] * count
        types += [muscle.type] * count
    return Lacing(
        np.concatenate(base), np.concatenate(weights, axis=1),
        np.array(offset), np.array(active), np.array(rest), np.array(channel, np.int32), tuple(types),
        np.array(kinds, np.int32), np.array(along),
    )  # fmt: skip


@lru_cache(maxsize=512)
def _loops(
    muscle: Muscle, n: int, hu: float, hv: float, across: int, down: int
) -> tuple[NDArray[np.int32], Array, Array]:
    """Return of the muscle's fixed points the first node (p, 2), weights (6, p, PATCH); lengths of its intervals
    [m]."""
    points = muscle.fixed_points()
    i, wu, du, eu = line_weights(points[:, 0], n, hu, across)
    j, wv, dv, ev = line_weights(points[:, 1], n, hv, down)
    touching = np.zeros((6, len(points), PATCH))
    touching[::2, :, :across], touching[1::2, :, :down] = (wu, du, eu), (wv, dv, ev)
    return np.stack([j, i], axis=1).astype(np.int32), touching, np.linalg.norm(np.diff(points, axis=0), axis=1)

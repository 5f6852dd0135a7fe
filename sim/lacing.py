"""Where a fixed point holds the cloth: weights of the nodes around it.

A muscle is laced through interstices of tape 10.5 mm wide, so a fixed point holds the cloth by a loop, not by a
mathematical point, which would pull infinitely far into it: displacement ~ F ln(r) / (2 pi k). The loop's share of the
cloth is a cubic B-spline with knots LOOP apart in both directions: its variance is that of a square of 2 LOOP. A grid
of spacing h gives way to so narrow a load more than the sheet does, so that WIDENED h^2 is added to LOOP^2. Closer to a
hem than LOOP the knots are as far apart as the hem is away, so that a muscle that ends on a held edge is held.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from sim.state import PATCH

LOOP = 0.005  # m; the trials of rig_c (synthetic) that may be fitted like 4 to 5 mm best, 0 or 7 mm less
WIDENED = 1 / 8  # with it grids of 10 and 5 mm come nearest to fine ones (docs/lab/simulator.md)


def patch_size(nodes: int, spacing: float) -> int:
    """Return how many nodes of a line with `spacing` [m] a loop can touch; with spacings under 1.25 mm it is
    narrower."""
    return min(4 * max(1, int(np.ceil(LOOP / spacing - 1e-9))), 4 * (nodes // 4), PATCH)


class LineWeights(NamedTuple):
    """The weights of loops on a line of nodes, by their first node (...)."""

    first: NDArray[np.int_]
    value: Array  # (..., count)
    slope: Array  # (..., count) 1/m, derivatives of the weights
    moment: Array  # (..., count) m


class MuscleLoops(NamedTuple):
    """The loops at a muscle's p fixed points."""

    first: NDArray[np.int32]  # (p, 2) node
    weights: Array  # (6, p, PATCH)
    lengths: Array  # m, of the intervals


def line_weights(t: ArrayLike, nodes: int, spacing: float | Array, count: int) -> LineWeights:
    """Return the weights of loops at `t` (...) [m] on a line of nodes. spacing: m, one for all or (..., 1).

    `count`: of weights, patch_size at least. B-spline weights, with knots a spacing apart at least, and Catmull-Rom
    weights, of no variance, are mixed for the loop's. Beyond the ends of the line the quadratic of three nodes goes on.
    """
    at = np.asarray(t, dtype=float)[..., None]
    around = _around(at / spacing, nodes, count)
    x = np.asarray(around * spacing - at)
    knots = np.clip(np.minimum(at, (nodes - 1) * spacing - at), 0.0, LOOP)
    scale = np.minimum(np.maximum(knots, spacing), spacing * count / 4)
    value, slope = _spline(x, scale)
    sharp, rise = _catmull_rom(np.asarray(x / spacing))
    share = np.minimum(1.0, (knots / scale) ** 2) * (1 + WIDENED * (spacing / LOOP) ** 2)
    value, slope = sharp + share * (value - sharp), rise / spacing + share * (slope - rise / spacing)
    first, fold = _fold(around, nodes)
    value, slope = (np.einsum("...nk,...k->...n", fold, w) for w in (value, slope))
    return LineWeights(first, value, slope, value * ((first[..., None] + np.arange(count)) * spacing - at))


def interpolation_weights(t: float, nodes: int) -> tuple[int, Array]:
    """Return the first of four nodes and their weights at `t` node spacings along a line: Catmull-Rom."""
    around = _around(np.array([t]), nodes, 4)
    first, fold = _fold(around, nodes)
    return int(first), fold @ _catmull_rom(np.asarray(around - t))[0]


def _around(t: Array, nodes: int, count: int) -> NDArray[np.int_]:
    """Return (..., count) nodes around `t` (..., 1) node spacings along a line; some may lie beyond its ends."""
    below = np.clip(np.floor(t).astype(int), 0, nodes - 2)
    return np.asarray(below - count // 2 + 1 + np.arange(count))


def _spline(x: Array, scale: Array) -> tuple[Array, Array]:
    """Return cubic B-spline weights of nodes at x [m] from the loop's middle, and their derivatives [1/m] when the loop
    moves up the line; linear functions of x are reproduced for any ratio of scale and spacing."""

    def total(values: Array) -> Array:
        return np.asarray(values.sum(axis=-1, keepdims=True))

    r = np.abs(x) / scale
    value = np.where(r < 1, 4 - 6 * r**2 + 3 * r**3, np.clip(2 - r, 0, None) ** 3)
    slope = np.where(r < 1, 12 * r - 9 * r**2, 3 * np.clip(2 - r, 0, None) ** 2) * np.sign(x)
    value, slope = value / total(value), slope / total(slope * x)
    mean = total(value * x)
    value = value * (1 - mean * (x - mean) / (total(value * x**2) - mean**2))
    return value, slope - total(slope) * value


def _catmull_rom(x: Array) -> tuple[Array, Array]:
    """Return the same for the interpolation that reproduces quadratics, in node spacings."""
    r = np.abs(x)
    value = np.where(r < 1, 2 - 5 * r**2 + 3 * r**3, np.clip(2 - r, 0, None) ** 2 * (1 - r)) / 2
    slope = np.where(r < 1, 10 * r - 9 * r**2, np.clip(2 - r, 0, None) * (4 - 3 * r)) * np.sign(x) / 2
    return value, slope


def _fold(around: NDArray[np.int_], nodes: int) -> tuple[NDArray[np.int_], Array]:
    """Return the first (...) of as many nodes on the line, and the matrices (..., count, count) that take weights of
    `around` (..., count) to them."""
    first = np.clip(around[..., 0], 0, nodes - around.shape[-1])
    held = first[..., None] + np.arange(around.shape[-1])
    fold = (held[..., :, None] == around[..., None, :]).astype(float)
    beyond = np.clip(np.maximum(-around, around - nodes + 1), 0, None)
    end = np.stack([(beyond + 1) * (beyond + 2) / 2, -beyond * (beyond + 2), beyond * (beyond + 1) / 2], axis=-2)
    fold[..., :3, :] += end * (around < 0)[..., None, :]
    fold[..., -3:, :] += end[..., ::-1, :] * (around >= nodes)[..., None, :]
    return first, fold


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
    loops = [_loops(muscle, n, hu, hv, across, down) for muscle in design.muscles]
    of = [index for index, loop in enumerate(loops) for _ in loop.first]  # the muscle of each fixed point
    muscles, lengths = [design.muscles[index] for index in of], [loop.lengths for loop in loops]
    sides = [1.0 if muscle.side == "front" else -1.0 for muscle in muscles]
    return Lacing(
        base=np.concatenate([np.zeros((0, 2), np.int32), *(loop.first for loop in loops)]),
        weights=np.concatenate([np.zeros((6, 0, PATCH)), *(loop.weights for loop in loops)], axis=1),
        offset=np.array([s * design.muscle_types[m.type].axis_offset for s, m in zip(sides, muscles, strict=True)]),
        active=np.array([share for one in lengths for share in (*np.ones(len(one)), 0.0)]),
        rest=np.array([length for one in lengths for length in (*one, 1.0)]),
        channel=np.array([muscle.channel for muscle in muscles], np.int32),
        muscle_type=tuple(muscle.type for muscle in muscles),
        muscle=np.array(of, np.int32),
        along=np.array([p for one in lengths for p in (*((np.cumsum(one) - one / 2) / one.sum()), 0.0)]),
    )


@lru_cache(maxsize=512)
def _loops(muscle: Muscle, n: int, hu: float, hv: float, across: int, down: int) -> MuscleLoops:
    points = muscle.fixed_points()
    i, wu, du, eu = line_weights(points[:, 0], n, hu, across)
    j, wv, dv, ev = line_weights(points[:, 1], n, hv, down)
    touching = np.zeros((6, len(points), PATCH))
    touching[::2, :, :across], touching[1::2, :, :down] = (wu, du, eu), (wv, dv, ev)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return MuscleLoops(np.stack([j, i], axis=1).astype(np.int32), touching, lengths)

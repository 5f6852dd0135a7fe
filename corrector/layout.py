"""Where a design's muscles lie, as fields on a coarse grid over the cloth; and how far a design is from others: where
muscles lie, in which direction and on which side, and of what all is made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from fabdesign.geometry.shape import bilinear
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import MuscleType

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
        done, total = 0.0, muscle.length
        for a, b in pairwise(muscle.fixed_points()):
            length = float(np.linalg.norm(b - a))
            intervals.append(Interval(m, a, b, (done + length / 2) / total))
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
    points, weights = bilinear((np.clip(at / size, 0, 1) * (nodes - 1)).reshape(-1, 2), nodes, nodes)
    result = np.zeros((len(at), nodes**2))
    np.add.at(result, (np.repeat(np.arange(len(at)), at.shape[1]), points.T), weights.T)
    return result.reshape(-1, nodes, nodes)


FAR = 1e9  # of a design that is held in another way
_PATCH = 3  # nodes a side: what lies within 30 mm of a node of a 0.2 m cloth
_FACTOR = 1.25  # between two constants that counts as a distance of one
_PRESSURE = 200e3  # Pa, at which muscle types are compared


def described(design: Design) -> dict[str, Any]:
    """Return what `distance` compares, as lists and numbers that JSON takes."""
    fabric = design.fabric
    constants = {
        "width": fabric.width,
        "height": fabric.height,
        "thickness": fabric.thickness,
        "areal_density": fabric.areal_density,
        "membrane_1": fabric.membrane_stiffness[0],
        "membrane_2": fabric.membrane_stiffness[1],
        "shear": fabric.shear_stiffness,
        "bending_1": fabric.bending_stiffness[0],
        "bending_2": fabric.bending_stiffness[1],
    }
    return {
        "name": design.name,
        "held": [str(fabric.hung), fabric.support, *(float(g) for g in fabric.gravity)],
        "constants": constants,
        "muscles": [_constants_of(design.muscle_types[name]) for name in sorted({m.type for m in design.muscles})],
        "patches": _patches(design).round(4).tolist(),
    }


def _constants_of(kind: MuscleType) -> list[float]:
    """Return the axis offset [m] and tension [N] at the row of the bench nearest to `_PRESSURE` and the rest length."""
    pressure, contraction = np.array(kind.bench.pressure), np.array(kind.bench.contraction)
    row = np.argmin(np.abs(pressure - _PRESSURE) / _PRESSURE + np.abs(contraction))
    return [kind.axis_offset, max(kind.bench.force[int(row)], 1e-3)]


def _patches(design: Design) -> Array:
    """Return (n^2, 6): around every node, how much muscle lies on the front and on the back, by direction."""
    field = deposits(design).sum(axis=1)  # (2, 3, n, n)
    smooth = uniform_filter(field, (1, 1, _PATCH, _PATCH), mode="nearest")
    return np.moveaxis(smooth.reshape(6, -1), 0, 1)


def distance(design: Mapping[str, Any], known: Sequence[Mapping[str, Any]]) -> float:
    """Return how far one design is from all the `known` ones together, as `described`; 0: nothing about it is new.

    Two parts, added: over the nodes, RMS of how far the muscles around one are from what some node of a known design
    has around it (1: one straight muscle more or less), and how far the constants are from the
    nearest known design's, in factors of 1.25.
    """
    alike = [other for other in known if list(other["held"]) == list(design["held"])]
    if not alike:
        return FAR
    apart = min(_constants_apart(design, other) for other in alike)
    tree = cKDTree(np.concatenate([np.asarray(other["patches"]).reshape(-1, 6) for other in alike]))
    away, _ = tree.query(np.asarray(design["patches"]).reshape(-1, 6))
    return float(np.sqrt(np.mean(np.square(_PATCH * away)))) + apart


def _constants_apart(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Return the largest difference of logarithms, in logarithms of `_FACTOR`; of muscle types from the nearest one."""
    fabric = [_apart([one["constants"][name]], [other["constants"][name]]) for name in one["constants"]]
    muscles = [min((_apart(kind, known) for known in other["muscles"]), default=FAR) for kind in one["muscles"]]
    return max([*fabric, *muscles])


def _apart(one: Sequence[float], other: Sequence[float]) -> float:
    return float(np.abs(np.log(np.array(one) / np.array(other))).max() / np.log(_FACTOR))

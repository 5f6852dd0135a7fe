"""How far a design is from others: where muscles lie, in which direction and on which side, and of what all is made."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from corrector.layout import deposits
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import MuscleType

Array = NDArray[np.float64]

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

"""Where the muscles lie on a cloth that has moved, and how far they are contracted and tensed there."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.mid_surface import at_places, mid_surface, two_faces
from fabdesign.nouns.design import Design

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class LacedMuscles:
    """The muscles of one motion, one after another. contraction, tension: of the intervals between fixed points, where
    a simulator gave them; of a corrected motion they are those before the correction."""

    points: NDArray[np.float32]  # (T, p, 3) m, the axis at the fixed points
    begins: NDArray[np.int64]  # (muscles + 1,) muscle k has points begins[k]:begins[k + 1]
    sides: NDArray[np.int64]  # (muscles,) 1 on the front, -1 on the back
    diameters: NDArray[np.float64]  # (muscles,) m, outer
    contraction: NDArray[np.float32] | None = None  # (T, p - muscles), 1 - l / l0
    tension: NDArray[np.float32] | None = None  # (T, p - muscles) N

    @property
    def spans(self) -> list[slice]:
        """Return the span of each muscle's points."""
        return [slice(int(first), int(last)) for first, last in pairwise(self.begins)]

    @property
    def intervals(self) -> NDArray[np.int64]:
        """(p - muscles, 2) the two points of every interval."""
        starts = np.delete(np.arange(self.begins[-1]), self.begins[1:] - 1)
        return np.stack([starts, starts + 1], axis=1)

    @property
    def owners(self) -> NDArray[np.int64]:
        """(p - muscles,) which muscle each interval belongs to."""
        return np.repeat(np.arange(len(self.sides)), np.diff(self.begins) - 1)


def laced_muscles(
    design: Design,
    points: Floats,
    *,
    contraction: NDArray[np.float32] | None = None,
    tension: NDArray[np.float32] | None = None,
) -> LacedMuscles:
    """Return the muscles of a design on a motion's points (T, 2 n n, 3) m, its axes `axis_offset` off the
    mid-surface."""
    fabric, faces, middle = design.fabric, two_faces(points), mid_surface(points)
    normals = faces[:, 0] - middle
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    axes, sides = [np.zeros((len(points), 0, 3))], []
    for muscle in design.muscles:
        places = muscle.fixed_points() / [fabric.width, fabric.height]
        sides.append(1 if muscle.side == "front" else -1)
        off = sides[-1] * design.muscle_types[muscle.type].axis_offset
        axes.append(at_places(middle + off * normals, places))
    counts = [axis.shape[1] for axis in axes]  # the first, of none, is 0
    diameters = [design.muscle_types[muscle.type].outer_diameter for muscle in design.muscles]
    return LacedMuscles(
        points=np.concatenate(axes, axis=1).astype(np.float32),
        begins=np.cumsum(counts),
        sides=np.array(sides, dtype=np.int64),
        diameters=np.array(diameters, dtype=np.float64),
        contraction=contraction,
        tension=tension,
    )

"""How far muscles contract in a shape: the chords between their fixed points beside their lengths on the flat cloth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.mid_surface import at_places, two_faces
from fabdesign.nouns.design import Design

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Intervals:
    """The intervals of all muscles of a design, one after another. lengths (k,) m on the flat cloth; muscle (k,): whose
    they are; ends (k, 2): numbers of their fixed points."""

    places: Array  # (m, 2) of the fixed points, shares of width and height
    offsets: Array  # (m,) of the axis there from the mid-surface, towards the front, in thicknesses
    ends: NDArray[np.intp]
    lengths: Array
    muscle: NDArray[np.intp]

    @staticmethod
    def of(design: Design) -> "Intervals":
        fabric = design.fabric
        points = [muscle.fixed_points() for muscle in design.muscles]
        counts = [len(chain) for chain in points]
        first = np.cumsum([0, *counts[:-1]])
        begins = np.concatenate([k + np.arange(n - 1) for k, n in zip(first, counts, strict=True)])
        every = np.concatenate(points)
        signs = [1.0 if muscle.side == "front" else -1.0 for muscle in design.muscles]
        offsets = [design.muscle_types[muscle.type].axis_offset for muscle in design.muscles]
        return Intervals(
            places=every / [fabric.width, fabric.height],
            offsets=np.repeat(np.multiply(signs, offsets) / fabric.thickness, counts),
            ends=np.stack([begins, begins + 1], axis=1),
            lengths=np.linalg.norm(every[begins + 1] - every[begins], axis=1),
            muscle=np.repeat(np.arange(len(counts)), np.array(counts) - 1),
        )

    def chords(self, shape: Array) -> Array:
        """Return (..., k, 3) m of a shape (..., 2 n n, 3) m, and linear in it."""
        faces = two_faces(shape)
        front, back = (at_places(faces[..., face, :, :, :], self.places) for face in (0, 1))
        axis = (front + back) / 2 + self.offsets[:, None] * (front - back)
        return np.asarray(axis[..., self.ends[:, 1], :] - axis[..., self.ends[:, 0], :])

    def contraction(self, chords: Array) -> Array:
        """Return (..., k), negative where stretched."""
        return np.asarray(1 - np.linalg.norm(chords, axis=-1) / self.lengths)


def largest_contraction(design: Design, shape: Array) -> float:
    """Return the largest contraction of any interval of any muscle, in any pose of a shape (poses, 2 n n, 3) m."""
    intervals = Intervals.of(design)
    return float(intervals.contraction(intervals.chords(shape)).max())


class LinearContraction:
    """Margins of the largest contraction that is allowed, a muscle and pose each, where the shape is linear in x. The
    muscles' fixed points stay where they are at the centre."""

    def __init__(self, design: Design, allowed: float, centre: Array, shape: Array, slopes: Array) -> None:
        """shape (poses, 2 n n, 3) m at the centre (n,), slopes (n, poses, 2 n n, 3) m."""
        self._intervals, self._allowed, self._centre = Intervals.of(design), allowed, centre
        self._chords, self._slopes = self._intervals.chords(shape), self._intervals.chords(slopes)
        self._muscles = range(len(design.muscles))

    @property
    def count(self) -> int:
        return len(self._chords) * len(self._muscles)

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return (count,) margins, negative where violated, and their slopes (count, n)."""
        chords = self._chords + np.tensordot(x - self._centre, self._slopes, axes=1)
        contracted = self._intervals.contraction(chords)  # (poses, k)
        lengths = np.maximum(np.linalg.norm(chords, axis=-1), 1e-12)
        margins, slopes = [], []
        for pose, row in enumerate(contracted):
            for muscle in self._muscles:
                members = np.flatnonzero(self._intervals.muscle == muscle)
                k = int(members[np.argmax(row[members])])
                margins.append(self._allowed - row[k])
                along = chords[pose, k] / (lengths[pose, k] * self._intervals.lengths[k])
                slopes.append(self._slopes[:, pose, k] @ along)
        return np.array(margins), np.array(slopes)

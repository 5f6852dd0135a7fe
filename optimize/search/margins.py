"""How far a layout is from what may be built: a margin for every limit of every muscle or pair of muscles, plane
geometry of their paths, and how far muscles contract in a shape."""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.shape import Shape, at_places
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.study_files.study_file import StudyLimits


def clearance(a: Array, b: Array) -> float:
    """Return the least distance [m] between two polylines; where they cross, minus the least shift of an end that parts
    them."""
    i, j = np.array(list(product(range(len(a) - 1), range(len(b) - 1)))).T
    return float(segment_clearance(a[i], a[i + 1], b[j], b[j + 1]).min())


def segment_clearance(p: Array, q: Array, r: Array, s: Array) -> Array:
    """Return (...,) m: the clearance of the segments from p to q and from r to s."""
    ends = np.minimum(
        np.minimum(_to_segment(p, r, s), _to_segment(q, r, s)), np.minimum(_to_segment(r, p, q), _to_segment(s, p, q))
    )
    crossing = (_turn(p, q, r) * _turn(p, q, s) < 0) & (_turn(r, s, p) * _turn(r, s, q) < 0)
    return np.where(crossing, -ends, ends)


def bend_radius(path: Array) -> Array:
    """Return (...,) m, of paths (..., corners, 2): the largest radius that rounds every corner, tangent to both its
    legs; neighbours share a leg half and half."""
    legs = np.diff(path, axis=-2)
    lengths = np.linalg.norm(legs, axis=-1)
    reach = lengths / 2
    reach[..., 0], reach[..., -1] = lengths[..., 0], lengths[..., -1]
    if legs.shape[-2] == 2:
        reach = lengths
    along = np.einsum("...ij,...ij->...i", legs[..., :-1, :], legs[..., 1:, :])
    cosine = along / np.maximum(lengths[..., :-1] * lengths[..., 1:], 1e-12)
    half_turn = np.arccos(np.clip(cosine, -1.0, 1.0)) / 2
    radii = np.minimum(reach[..., :-1], reach[..., 1:]) / np.maximum(np.tan(half_turn), 1e-9)
    return np.asarray(radii.min(axis=-1))


def _to_segment(point: Array, a: Array, b: Array) -> Array:
    along, to = b - a, point - a
    t = np.clip(_dot(to, along) / np.maximum(_dot(along, along), 1e-18), 0.0, 1.0)[..., None]
    off = to - t * along
    return np.sqrt(_dot(off, off))


def _dot(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _turn(a: Array, b: Array, c: Array) -> Array:
    ab, ac = b - a, c - a
    return ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]


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
        faces = Shape.of(shape).faces
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
        """Keep the linear shape. shape: (poses, 2 n n, 3) m at the centre (n,), slopes (n, poses, 2 n n, 3) m."""
        self._intervals, self._allowed, self._centre = Intervals.of(design), allowed, centre
        self._chords, self._slopes = self._intervals.chords(shape), self._intervals.chords(slopes)
        self._muscles = range(len(design.muscles))

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return (muscles poses,) margins, negative where violated, and their slopes (muscles poses, n)."""
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


ATMOSPHERE = 101_325.0  # Pa
Limits = StudyLimits  # that every proposal respects; `air`: `free_air`


class Margins:
    """The margins [m] of a design's muscles, wherever their corners lie; nowhere negative where they may be built.

    `names` says which limit each of them is of: `shortest` (fewer than two intervals bend next to nothing),
    `stock_length`, `min_bend_radius` and, of two muscles on one face, `spacing`; `muscles`, which one or two it is of.
    """

    def __init__(self, design: Design, limits: Limits) -> None:
        muscles = design.muscles
        ends = np.cumsum([0, *(len(muscle.path) for muscle in muscles)]).tolist()
        self._corners = list(pairwise(ends))
        kinds = [design.muscle_types[muscle.type] for muscle in muscles]
        self._shortest = np.array([2 * muscle.fixed_point_pitch for muscle in muscles])
        self._stocked = [i for i, kind in enumerate(kinds) if kind.stock_length is not None]
        self._stock = np.array(
            [(kinds[i].stock_length or 0.0) - 2 * (kinds[i].tail_length or 0.0) for i in self._stocked]
        )
        bent = [i for i, kind in enumerate(kinds) if kind.min_bend_radius is not None and len(muscles[i].path) > 2]
        self._bent = [(*self._corners[i], kinds[i].min_bend_radius or 0.0) for i in bent]
        self._spacing = limits.spacing
        pairs = [(j, i) for i in range(len(muscles)) for j in range(i) if muscles[i].side == muscles[j].side]
        self._segments: list[tuple[int, int]] = []  # corners that all pairs of segments start at
        self._groups: list[int] = []  # where each pair of muscles begins
        for j, i in pairs:
            self._groups.append(len(self._segments))
            one, other = (range(a, b - 1) for a, b in (self._corners[j], self._corners[i]))
            self._segments += product(one, other)
        alone = {"shortest": range(len(muscles)), "stock_length": self._stocked, "min_bend_radius": bent}
        of: list[tuple[str, tuple[int, ...]]] = [(name, (i,)) for name, whom in alone.items() for i in whom]
        of += [("spacing", pair) for pair in pairs]
        self.names, self.muscles = tuple(name for name, _ in of), tuple(whom for _, whom in of)

    def lengths(self, corners: Array) -> Array:
        """Return (..., muscles) m on the flat cloth."""
        legs = np.linalg.norm(np.diff(corners, axis=-2), axis=-1)
        return np.stack([legs[..., a : b - 1].sum(axis=-1) for a, b in self._corners], axis=-1)

    def at(self, corners: Array) -> Array:
        """Return (..., k) m, of layouts whose muscles' corners, one after another, are (..., corners, 2) m."""
        lengths = self.lengths(corners)
        parts = [lengths - self._shortest, self._stock - lengths[..., self._stocked]]
        parts += [(bend_radius(corners[..., a:b, :]) - least)[..., None] for a, b, least in self._bent]
        if self._groups:
            p, r = np.array(self._segments).T
            apart = segment_clearance(*(corners[..., k, :] for k in (p, p + 1, r, r + 1)))
            parts.append(np.minimum.reduceat(apart, self._groups, axis=-1) - self._spacing)
        return np.concatenate(parts, axis=-1)


def free_air(design: Design, lengths: Array, pressures: Array) -> Array:
    """Return (..., poses) m^3 at atmospheric pressure that pressures (..., poses, channels) Pa take beside what is in
    muscles of lengths (..., muscles) m anyway: of cylinders of the outer diameter, which a muscle that swells
    exceeds."""
    areas = np.array([np.pi / 4 * design.muscle_types[muscle.type].outer_diameter ** 2 for muscle in design.muscles])
    by_muscle = pressures[..., [muscle.channel for muscle in design.muscles]]
    return np.asarray((by_muscle * (areas * lengths)[..., None, :]).sum(axis=-1) / ATMOSPHERE)


def constraint_margins(
    design: Design, pressures: Array, limits: Limits, shape: Array | None = None
) -> dict[str, float]:
    """Return the least margin of every limit by name: m; Pa for `pressure`, m^3 for `air`, none for `contraction` and
    `channels`. Negative: violated. shape: (poses, 2 n n, 3) m, by which `contraction` goes.

    `spacing` is absent where no face has two muscles, `min_bend_radius` and `stock_length` where no type states one,
    the last three where there is no limit.
    """
    fabric = design.fabric
    corners = np.concatenate([np.array(muscle.path) for muscle in design.muscles])
    margins = Margins(design, limits)
    least: dict[str, float] = {}
    for name, margin in zip(margins.names, margins.at(corners).tolist(), strict=True):
        least[name] = min(margin, least.get(name, np.inf))
    least["inside_cloth"] = float(np.min([corners, np.array([fabric.width, fabric.height]) - corners]))
    least["pressure"] = float(min(np.min(pressures) - limits.pressure[0], limits.pressure[1] - np.max(pressures)))
    if limits.contraction is not None and shape is not None:
        least["contraction"] = limits.contraction - largest_contraction(design, shape)
    if limits.channels is not None:
        least["channels"] = float(limits.channels - design.channels)
    if limits.air is not None:
        least["air"] = float(np.min(limits.air - free_air(design, margins.lengths(corners), pressures)))
    return least

"""Mirror images of layouts, left for right. Where the target is its own image, a search that begins at an even layout
stays at even ones, and an even layout is taken before others that are as near."""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fabdesign.geometry.shape import Shape
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import SIDE
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.objective import Objective, Poses, Target
from optimize.search.starts import Start

EVEN = 1e-6  # of a variable, by which an even layout may differ from its image,
EVEN_SHAPE = 1e-4  # and m RMS of a shape: what a grid and single precision leave
EVEN_CLOUD = 1.05  # times the mean distance of its points to the next one: another sample of one surface has 1;
EVEN_MARKERS = 1e-3  # m, in place of it where points are few
ACROSS = np.array([-1.0, 1.0, 1.0])  # what an image does to x, y, z


@dataclass(frozen=True, eq=False)
class Mirror:
    """The image of a layout's vector: its variable k is variable `order[k]`, or 1 less it where `flipped`."""

    order: NDArray[np.intp]
    flipped: NDArray[np.bool_]

    def even(self, x: Vector) -> Vector:
        """Return the middle between x and its image: it is its own image."""
        image = x[self.order]
        return np.asarray((x + np.where(self.flipped, 1.0 - image, image)) / 2)

    def keeps(self, x: Vector) -> bool:
        """Return whether x is its own image."""
        return bool(np.abs(self.even(x) - x).max(initial=0.0) <= EVEN)

    def slopes(self, slopes: Array) -> Array:
        """Return slopes (n, poses, 2 m, 3) of a shape along the even part of each step."""
        sign = np.where(self.flipped, -1.0, 1.0)[:, None, None, None]
        return np.asarray((slopes + sign * slopes[self.order]) / 2)


def mirror_of(space: DesignSpace, x: Vector) -> Mirror | None:
    """Return the mirror that lays each muscle on the one whose image lies nearest; None where muscles stay that are not
    even, or the images of one channel's muscles lie on those of several channels."""
    design, positions = space.decode(x)[0], np.arange(space.position_count).reshape(-1, 2)
    muscles, (partners, apart) = design.muscles, _partners(design)
    onto = {(muscle.channel, muscles[k].channel) for muscle, (k, _) in zip(muscles, partners, strict=True)}
    if len(onto) > len(dict(onto)) or not (space.vary_positions or apart <= EVEN):
        return None
    order = []
    if space.vary_positions:
        corners = np.split(positions, np.cumsum([len(muscle.path) for muscle in muscles])[:-1])
        order += [corners[k][::-1] if backwards else corners[k] for k, backwards in partners]
    if space.vary_pressures:
        levels = positions.size + np.arange(space.start_pressures.size).reshape(space.start_pressures.shape)
        order.append(levels[:, [dict(onto).get(channel, channel) for channel in range(space.channels)]])
    flipped = np.arange(space.dimension) < positions.size
    flipped[1::2] = False
    return Mirror(np.concatenate([part.ravel() for part in order]), flipped)


def _partners(design: Design) -> tuple[list[tuple[int, bool]], float]:
    """Return for each muscle the one whose image it lies nearest to, of its kind and each taken once, and whether that
    image runs backwards; and how far [m] the worst two lie apart."""
    muscles, width = design.muscles, design.fabric.width
    pairs = []
    for i, j in combinations_with_replacement(range(len(muscles)), 2):
        one, other = (np.array(muscles[k].path) for k in (i, j))
        if (muscles[i].side, muscles[i].type, len(one)) == (muscles[j].side, muscles[j].type, len(other)):
            image = [width, 0.0] + other * [-1.0, 1.0]
            forwards, backwards = (float(np.linalg.norm(one - path, axis=1).mean()) for path in (image, image[::-1]))
            pairs.append((min(forwards, backwards), i, j, backwards < forwards))
    partners: dict[int, tuple[int, bool]] = {}
    worst = 0.0
    for away, i, j, reverse in sorted(pairs):
        if i not in partners and j not in partners:
            partners[i], partners[j], worst = (j, reverse), (i, reverse), away
    return [partners[k] for k in range(len(muscles))], worst


def is_even(point: Start) -> bool:
    """Return whether a layout with its pressures is its own image."""
    mirror = mirror_of(*point)
    return mirror is not None and mirror.keeps(point[1])


def is_even_shape(shape: Poses) -> bool:
    """Return whether a shape (poses, 2 n, 3) m is its own image."""
    faces = Shape(shape).faces
    return bool(np.sqrt(np.mean((faces - faces[..., ::-1, :] * ACROSS) ** 2)) <= EVEN_SHAPE)


def has_even_targets(objective: Objective) -> bool:
    """Return whether each target is its own image, as far as its points can say."""
    return all(not target.free and _is_even_target(target) for target in objective.targets)


def _is_even_target(target: Target) -> bool:
    if target.weighting is not None:
        weights = target.weighting.of_points(2 * SIDE**2).reshape(2, SIDE, SIDE)
        if np.any(weights != weights[..., ::-1]):
            return False
    if target.landmarks is not None:
        return _are_even(target.landmarks)
    tree = KDTree(target.points)
    apart = tree.query(target.points * ACROSS)[0].mean()
    if target.markers:
        return bool(apart <= EVEN_MARKERS)
    return bool(apart <= max(EVEN_CLOUD * tree.query(target.points, 2)[0][:, 1].mean(), EVEN_SHAPE))


def _are_even(wishes: Landmarks) -> bool:
    """Return whether each wish has its image among the wishes."""

    def sorted_rows(shares: Array, goals: Array) -> Array:
        rows = np.column_stack([shares, np.where(wishes.given, goals, 0.0), wishes.given, wishes.weights]).round(6)
        return rows[np.lexsort(rows.T)]

    image = sorted_rows(wishes.shares * [-1.0, 1.0] + [1.0, 0.0], wishes.goals * ACROSS)
    return np.array_equal(image, sorted_rows(wishes.shares, wishes.goals))

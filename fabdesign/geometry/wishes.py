"""Regions of the cloth that count more, or less, than the rest where a shape is compared with a target; and wishes in
place of a target's cloud: places of the cloth and where they are to come, in all coordinates or some."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import isqrt
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.formats.schema import ABOVE_0, FileUnit, Key, Metre, Within
from fabdesign.formats.table import Table
from fabdesign.geometry.hung_cloth import STRETCH, held_places, on_flat_cloth
from fabdesign.geometry.shape import Shape, at_places, bilinear
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.fabric import Fabric
from fabdesign.units import in_mm

Point = tuple[float, float, float]
Corners = tuple[tuple[float, float], ...]

EDGES = ("top", "bottom", "left", "right")
ALONG = 9  # places of an edge, and of a tube in each direction
WORLD, FROM_FLAT = ("x", "y", "z"), ("right", "up", "forward")
ON_EDGE = 1e-9  # m from a region's edge: so near is inside
_FLAT = 50.0  # cloth heights, the radius of a tube that bends a cloth of 0.2 m by 2 mm


def _box(value: tuple[float, ...], table: Table) -> Corners | None:
    """Return the corners of [left, upper, right, lower]."""
    left, upper, right, lower = value
    return ((left, upper), (right, upper), (right, lower), (left, lower)) if left < right and upper < lower else None


_BOX = Key(
    form=tuple[float, float, float, float],
    read=_box,
    expected="[left, upper, right, lower] in m, two corners (u, v)",
)

_CORNERS = Key(
    expected="either box = [u, v, u, v] or polygon = [[u, v], ...]",
    one_of={"box": Annotated[Corners, _BOX, "m: left, upper, right, lower"], "polygon": Corners},
)


@dataclass(frozen=True)
class Region:
    """A part of the cloth. corners: (u, v) m of a polygon, in order. weight: of places in it, against 1 of the
    others."""

    corners: Annotated[Corners, _CORNERS]
    weight: Annotated[float, Within(above=0, most=1000), "of the distances there; others count once"]

    def resolved(self, table: Table) -> "Region":
        """Raise InputError unless it is a part of the cloth."""
        fabric = table.find("design").fabric
        key = "box" if "box" in table else "polygon"
        if len(self.corners) < 3:
            raise table.bad(key, "three corners or more")
        places = np.array(self.corners)
        if ((places.max(axis=0) <= 0) | (places.min(axis=0) >= [fabric.width, fabric.height])).any():
            raise table.bad(key, f"a part of the cloth, {fabric.width:g} by {fabric.height:g} m")
        return self


@dataclass(frozen=True)
class Weighting:
    """How much each place of a cloth of so many m counts: as the last region that it lies in says, else 1."""

    regions: tuple[Region, ...]
    width: float
    height: float

    def of_points(self, count: int) -> Array:
        """Return (count,) of the points of both faces, as `ForwardModel` gives them."""
        return _of_points(self, count)

    @property
    def in_words(self) -> str:
        """Return the regions in words."""
        words = []
        for region in self.regions:
            (left, upper), (right, lower) = in_mm(np.array([np.min(region.corners, 0), np.max(region.corners, 0)]))
            kind = "the box" if len(region.corners) == 4 else "a polygon within"
            at = f"u {left:.0f} to {right:.0f}, v {upper:.0f} to {lower:.0f} mm"
            words.append(f"{region.weight:g} times in {kind} {at}")
        return ", ".join(words)


@lru_cache(maxsize=32)
def _of_points(weighting: Weighting, count: int) -> Array:
    side = isqrt(count // 2)
    u, v = np.meshgrid(np.linspace(0, weighting.width, side), np.linspace(0, weighting.height, side))
    places, weights = np.stack([u.ravel(), v.ravel()], axis=1), np.ones(side * side)
    for region in weighting.regions:
        weights[_inside(places, np.array(region.corners))] = region.weight
    return np.concatenate([weights, weights])


def _inside(places: Array, corners: Array) -> NDArray[np.bool_]:
    """Return (n,) whether places (n, 2) lie in a polygon (k, 2) or on its edge: by the crossings of a ray across."""
    a, b = corners, np.roll(corners, -1, axis=0)
    (u, v), along = places.T[:, :, None], b - a
    between = (a[:, 1] > v) != (b[:, 1] > v)
    rise = np.where(along[:, 1] == 0, 1.0, along[:, 1])
    crossed = between & (u < a[:, 0] + (v - a[:, 1]) / rise * along[:, 0])
    to = places[:, None] - a
    t = np.clip((to * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-18), 0, 1)
    on_edge = np.linalg.norm(to - t[:, :, None] * along, axis=2).min(axis=1) <= ON_EDGE
    return np.asarray((crossed.sum(axis=1) % 2 == 1) | on_edge)


@dataclass(frozen=True)
class Wish:
    """Where places of the cloth are to come. given: which of x, y, z count."""

    words: str  # for people
    places: tuple[tuple[float, float], ...]  # (u, v) m
    goals: tuple[Point, ...]  # m, a place each; where a coordinate does not count, that of the flat cloth
    given: tuple[bool, bool, bool]
    weight: float = 1.0


_PLACE = Key(
    expected=f"either at = [u, v] or edge = one of {', '.join(EDGES)}",
    one_of={
        "at": Annotated[tuple[float, float], FileUnit("m"), "one place (u, v) of the cloth"],
        "edge": Annotated[Literal["top", "bottom", "left", "right"], "nine places of it"],
    },
)


@dataclass(frozen=True)
class WishKeys:
    """A wish as a file has it."""

    place: Annotated[tuple[float, float] | str, _PLACE]
    x: Annotated[Metre | None, "in the world; what is not given is free"] = None
    y: Metre | None = None
    z: Metre | None = None
    right: Annotated[Metre | None, "from the flat hanging cloth"] = None
    up: Metre | None = None
    forward: Annotated[Metre | None, "towards the front"] = None
    weight: Annotated[float, ABOVE_0, "among several wishes"] = 1.0

    def resolved(self, table: Table) -> Wish:
        """Return the wish on the cloth of the study. Raises InputError for one that the cloth cannot grant."""
        fabric = table.find("design").fabric
        if isinstance(self.place, str):
            share = np.linspace(0, 1, ALONG)
            u = {"left": 0 * share, "right": 0 * share + 1}.get(self.place, share) * fabric.width
            v = {"top": 0 * share, "bottom": 0 * share + 1}.get(self.place, share) * fabric.height
            where, places = f"{self.place} edge", np.stack([u, v], axis=1)
        else:
            places = np.array([self.place])
            if not ((places >= 0) & (places <= np.array([fabric.width, fabric.height]) + 1e-9)).all():
                raise table.bad("at", f"a place on the cloth, {fabric.width:g} by {fabric.height:g} m")
            where = f"({self.place[0]:g}, {self.place[1]:g})"
        goals, given, words = on_flat_cloth(places, fabric), [False] * 3, []
        for axis, (world, beside) in enumerate(zip(WORLD, FROM_FLAT, strict=True)):
            absolute, relative = getattr(self, world), getattr(self, beside)
            if absolute is not None and relative is not None:
                raise table.error(f"{world} and {beside} say the same; expected one of them")
            given[axis] = absolute is not None or relative is not None
            if absolute is not None:
                goals[:, axis] = absolute
                words.append(f"{world} = {in_mm(absolute):g} mm")
            elif relative is not None:
                goals[:, axis] += relative
                words.append(f"{in_mm(relative):g} mm {beside}")
        if not any(given):
            raise table.error(f"no goal; expected some of {', '.join((*WORLD, *FROM_FLAT))}, in m")
        axes: Any = tuple(given)
        wish = Wish(f"{where}: {', '.join(words)}", _tuples(places), _tuples(goals), axes, self.weight)
        _require_reachable(wish, fabric, table.where)
        return wish


@dataclass(frozen=True)
class TubeKeys:
    """The whole cloth bent about a horizontal axis, from the upper edge on, where the tube stands upright."""

    radius: Annotated[Metre, Within(least=0.005), "of the tube"]
    towards: Annotated[Literal["front", "back"], "the face on whose side the axis lies"] = "front"

    def resolved(self, table: Table) -> Wish:
        """Return the wish of 81 places. Raises InputError for a tube that hardly bends the cloth."""
        fabric = table.find("design").fabric
        if fabric.hung != "top":
            raise table.error("for a cloth held elsewhere; expected one hung by its top edge")
        if self.radius > (most := _FLAT * fabric.height):
            raise table.bad("radius", f"a number{Within(least=0.005, most=most)}")
        sign = 1.0 if self.towards == "front" else -1.0
        u, v = np.meshgrid(np.linspace(0, fabric.width, ALONG), np.linspace(0, fabric.height, ALONG))
        turn = v / self.radius
        out = sign * self.radius * (1 - np.cos(turn))
        goals = np.stack([u - fabric.width / 2, -self.radius * np.sin(turn), out], axis=-1)
        places = np.stack([u, v], axis=-1).reshape(-1, 2)
        turned = np.degrees(fabric.height / self.radius)
        words = f"a tube of radius {in_mm(self.radius):g} mm, {turned:.0f} degrees of it, towards the {self.towards}"
        return Wish(words, _tuples(places), _tuples(goals.reshape(-1, 3)), (True, True, True))


def _tuples(rows: Array) -> Any:
    return tuple(tuple(row) for row in rows.tolist())


def _require_reachable(wish: Wish, fabric: Fabric, where: str) -> None:
    """Raise InputError for a goal farther from all held places than the flat cloth lets its place be."""
    held = held_places(fabric)
    if not len(held):
        return
    given = np.array(wish.given)
    for place, goal in zip(wish.places, wish.goals, strict=True):
        flat = on_flat_cloth(np.array([place]), fabric)[0]
        reach = np.linalg.norm(held - flat, axis=1)
        away = np.linalg.norm((held - goal)[:, given], axis=1)
        # every held place bounds it
        worst = int(np.argmax(away - STRETCH * reach))
        if away[worst] > STRETCH * reach[worst] + 1e-6:
            raise InputError(
                f"{where}: place ({place[0]:g}, {place[1]:g}) is to lie {in_mm(away[worst]):.0f} mm from a held place; "
                f"expected at most {in_mm(reach[worst]):.0f} mm, as on the flat cloth"
            )


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The wishes of a target as arrays: `goals` (k, 3) m of `shares` (k, 2) of width and height, `given` (k, 3),
    `weights` (k,) with sum 1: a wish counts by its weight, however many places it has."""

    shares: Array
    goals: Array
    given: NDArray[np.bool_]
    weights: Array

    @staticmethod
    def of(wishes: Sequence[Wish], fabric: Fabric) -> "Landmarks":
        size = np.array([fabric.width, fabric.height])
        counts = [len(wish.places) for wish in wishes]
        weights = np.repeat([wish.weight / len(wish.places) for wish in wishes], counts)
        return Landmarks(
            np.concatenate([wish.places for wish in wishes]) / size,
            np.concatenate([wish.goals for wish in wishes]),
            np.repeat([wish.given for wish in wishes], counts, axis=0),
            weights / weights.sum(),
        )

    def off(self, points: Floats) -> Array:
        """Return (k, 3) m from the goals to the places of a cloth (2 n n, 3) m, 0 where a coordinate does not count."""
        return np.where(self.given, at_places(Shape.of(points).middle, self.shares) - self.goals, 0.0)

    def distances(self, points: Floats) -> Array:
        """Return (k,) m."""
        return np.asarray(np.linalg.norm(self.off(points), axis=1))

    def mean(self, points: Floats) -> float:
        """Return the mean distance [m], by the weights."""
        return float(self.weights @ self.distances(points))

    def gradient(self, points: Floats) -> tuple[float, Array]:
        """Return `mean`, and its derivative by each coordinate (2 n n, 3)."""
        off = self.off(points)
        sizes = np.linalg.norm(off, axis=1)
        pull = (self.weights / np.maximum(sizes, 1e-12))[:, None] * off
        slope = np.zeros(points.shape)
        side = Shape(points).side
        nodes, weights = bilinear((side - 1) * self.shares, side, side)
        for node, weight in zip(nodes.T, weights.T, strict=True):
            for face in (0, side * side):
                np.add.at(slope, node + face, 0.5 * weight[:, None] * pull)
        return float(self.weights @ sizes), slope

    @cached_property
    def key(self) -> str:
        """Return what makes two of them the same."""
        return repr([a.tolist() for a in (self.shares, self.goals, self.given, self.weights)])

"""Wishes in place of a target's cloud: places of the cloth and where they are to come, in all coordinates or some."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.fabric import Fabric
from fabdesign.hung_cloth import held_places, on_flat_cloth
from fabdesign.mid_surface import at_places, cells_of, mid_surface
from fabdesign.table import Table
from fabdesign.units import in_mm

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
Point = tuple[float, float, float]

EDGES = ("top", "bottom", "left", "right")
ALONG = 9  # places of an edge, and of a tube in each direction
WORLD, FROM_FLAT = ("x", "y", "z"), ("right", "up", "forward")
_FLAT = 50.0  # cloth heights, the radius of a tube that bends a cloth of 0.2 m by 2 mm
_STRETCH = 1.15  # of the flat cloth's lengths, as of a cloud (fabdesign/hung_cloth.py)


@dataclass(frozen=True)
class Wish:
    """Where places of the cloth are to come. given: which of x, y, z count."""

    said: str  # for people
    places: tuple[tuple[float, float], ...]  # (u, v) m
    goals: tuple[Point, ...]  # m, a place each; where a coordinate does not count, that of the flat cloth
    given: tuple[bool, bool, bool]
    weight: float = 1.0


def read_wishes(table: Table, fabric: Fabric) -> tuple[Wish, ...]:
    """Of a target's `[[wishes]]` and `tube`; none where it has neither. Keys: docs/files.md. Raises InputError."""
    wishes = [_wish(own, fabric) for own in table.tables("wishes")]
    tube = table.table("tube", None)
    return (*wishes, *([] if tube is None else [_tube(tube, fabric)]))


def _wish(table: Table, fabric: Fabric) -> Wish:
    if ("at" in table) == ("edge" in table):
        raise InputError(f"{table.where}: expected either at = [u, v] or edge = one of {', '.join(EDGES)}")
    size = np.array([fabric.width, fabric.height])
    if "at" in table:
        at = table.numbers("at", count=2)
        if not ((np.array(at) >= 0) & (np.array(at) <= size + 1e-9)).all():
            raise table.bad("at", f"a place on the cloth, {fabric.width:g} by {fabric.height:g} m")
        where, places = f"({at[0]:g}, {at[1]:g})", np.array([at])
    else:
        edge = table.text("edge", choices=EDGES)
        where, places = f"{edge} edge", _of_edge(edge, fabric)
    flat = on_flat_cloth(places, fabric)
    goals, given, said = flat.copy(), [False] * 3, []
    for axis, (world, beside) in enumerate(zip(WORLD, FROM_FLAT, strict=True)):
        if world in table and beside in table:
            raise InputError(f"{table.where}: {world} and {beside} say the same; expected one of them")
        if world in table:
            value = table.number(world)
            goals[:, axis], given[axis] = value, True
            said.append(f"{world} = {in_mm(value):g} mm")
        elif beside in table:
            value = table.number(beside)
            goals[:, axis], given[axis] = flat[:, axis] + value, True
            said.append(f"{in_mm(value):g} mm {beside}")
    if not any(given):
        raise InputError(f"{table.where}: no goal; expected some of {', '.join((*WORLD, *FROM_FLAT))}, in m")
    weight = table.number("weight", 1.0, above=0)
    table.finish()
    wish = Wish(f"{where}: {', '.join(said)}", _tuples(places), _tuples(goals), (given[0], given[1], given[2]), weight)
    _require_reachable(wish, fabric, table.where)
    return wish


def _tube(table: Table, fabric: Fabric) -> Wish:
    """The whole cloth bent about a horizontal axis, from the upper edge on, where the tube stands upright."""
    if fabric.hung != "top":
        raise InputError(f"{table.where}: for a cloth held elsewhere; expected one hung by its top edge")
    radius = table.number("radius", least=0.005, most=_FLAT * fabric.height)
    sign = {"front": 1.0, "back": -1.0}[table.text("towards", "front", choices=("front", "back"))]
    table.finish()
    u, v = np.meshgrid(np.linspace(0, fabric.width, ALONG), np.linspace(0, fabric.height, ALONG))
    turn = v / radius
    goals = np.stack([u - fabric.width / 2, -radius * np.sin(turn), sign * radius * (1 - np.cos(turn))], axis=-1)
    places = np.stack([u, v], axis=-1).reshape(-1, 2)
    turned = np.degrees(fabric.height / radius)
    face = "front" if sign > 0 else "back"
    said = f"a tube of radius {in_mm(radius):g} mm, {turned:.0f} degrees of it, towards the {face}"
    return Wish(said, _tuples(places), _tuples(goals.reshape(-1, 3)), (True, True, True))


def _of_edge(edge: str, fabric: Fabric) -> Array:
    """(ALONG, 2) m."""
    share = np.linspace(0, 1, ALONG)
    u = {"left": 0 * share, "right": 0 * share + 1}.get(edge, share) * fabric.width
    v = {"top": 0 * share, "bottom": 0 * share + 1}.get(edge, share) * fabric.height
    return np.stack([u, v], axis=1)


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
        worst = int(np.argmax(away - _STRETCH * reach))
        if away[worst] > _STRETCH * reach[worst] + 1e-6:
            raise InputError(
                f"{where}: place ({place[0]:g}, {place[1]:g}) is to lie {in_mm(away[worst]):.0f} mm from a held place; "
                f"expected at most {in_mm(reach[worst]):.0f} mm, as on the flat cloth"
            )


@dataclass(frozen=True, eq=False)
class Landmarks:
    """All wishes of a target as arrays: `goals` (k, 3) m of `shares` (k, 2) of width and height, `given` (k, 3),
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
        """(k, 3) m from the goals to the places of a cloth (2 n n, 3) m, 0 where a coordinate does not count."""
        return np.where(self.given, at_places(mid_surface(points), self.shares) - self.goals, 0.0)

    def distances(self, points: Floats) -> Array:
        """(k,) m."""
        return np.asarray(np.linalg.norm(self.off(points), axis=1))

    def mean(self, points: Floats) -> float:
        """m, by the weights."""
        return float(self.weights @ self.distances(points))

    def gradient(self, points: Floats) -> tuple[float, Array]:
        """`mean`, and its derivative by each coordinate (2 n n, 3)."""
        off = self.off(points)
        sizes = np.linalg.norm(off, axis=1)
        pull = (self.weights / np.maximum(sizes, 1e-12))[:, None] * off
        slope = np.zeros(points.shape)
        half = len(points) // 2
        for node, weight in self._corners(isqrt(half)):
            for face in (0, half):
                np.add.at(slope, node + face, 0.5 * weight[:, None] * pull)
        return float(self.weights @ sizes), slope

    def _corners(self, side: int) -> Iterator[tuple[NDArray[np.intp], Array]]:
        """The four nodes (k,) around every place, with their weights (k,): those of `at_places`."""
        (s, t), (i, j) = cells_of(self.shares, side, side)
        for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = (t if down else 1 - t) * (s if across else 1 - s)
            yield (j + down) * side + i + across, weight

    @cached_property
    def key(self) -> str:
        """What makes two of them the same."""
        return repr([a.tolist() for a in (self.shares, self.goals, self.given, self.weights)])

"""Regions of the cloth that count more, or less, than the rest where a shape is compared with a target."""

from dataclasses import dataclass
from functools import lru_cache
from math import isqrt
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fabdesign.formats.schema import Key, Within
from fabdesign.formats.table import Table
from fabdesign.nouns.array import Array
from fabdesign.units import in_mm

ON_EDGE = 1e-9  # m from a region's edge: so near is inside


Corners = tuple[tuple[float, float], ...]


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

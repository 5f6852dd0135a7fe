"""Named points of a cloth over time, as a CSV."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.csv_table import write_rows
from fabdesign.geometry.shape import Shape, at_places
from studies.view.items import Item

# shares of width and height from the upper left corner, seen from the front
USUAL = {
    "lower_left": (0.0, 1.0),
    "lower_middle": (0.5, 1.0),
    "lower_right": (1.0, 1.0),
    "middle": (0.5, 0.5),
}


def save_markers(items: Sequence[Item], path: Path, markers: Mapping[str, tuple[float, float]]) -> None:
    """A row a panel and frame: `panel`, `time_s`, and x, y, z in m of every marker, which lies on the mid-surface.

    markers: (u, v) m in fabric coordinates; without any, those of USUAL. Raises InputError for a panel that is no
    cloth, for one whose size is not known, and for a marker beside the cloth.
    """
    names = [*(markers or USUAL)]
    rows = []
    for item in items:
        if not item.is_cloth:
            raise InputError(f"{item.title}: is a cloud or mesh, without named points; expected motions of a cloth")
        places = [_place(item, name, *markers[name]) for name in names] if markers else [*USUAL.values()]
        for time, points in zip(item.times, item.frames, strict=True):
            places_at = at_places(Shape.of(points).middle, places)
            rows.append([item.title, f"{time:.6f}", *(f"{value:.6f}" for value in places_at.ravel())])
    columns = [f"{name}_{axis}_m" for name in names for axis in "xyz"]
    write_rows(path, ["panel", "time_s", *columns], rows)


def _place(item: Item, name: str, u: float, v: float) -> tuple[float, float]:
    if item.size is None:
        raise InputError(f"{item.title}: does not say its cloth's size; expected a motion simulated by this version")
    share = np.array([u, v]) / item.size
    if (share < -1e-9).any() or (share > 1 + 1e-9).any():
        width, height = item.size
        raise InputError(f"marker {name} at {u:g}, {v:g} m: expected a place on the cloth, {width:g} by {height:g} m")
    return float(share[0]), float(share[1])

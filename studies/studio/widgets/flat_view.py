"""The flat cloth as on the sewing table, front and back: muscles that are clicked and dragged, and lacing rows."""

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any

import numpy as np

from fabdesign.nouns.muscle import Muscle
from studies.studio.document import Document
from studies.studio.layout import Point, rows
from studies.studio.widgets.declared import Node, Post
from studies.studio.widgets.scene import BACK, BROKEN, FRONT, LIFT, Array, Colour, Places, colour, on_plane, ribbon

_HANDLE = 0.0035  # m, radius of an end or corner
_LEAST_WIDTH = 0.0035  # m, of a muscle's band: thinner ones are hard to hit
_PLAIN = {"flat_shading": True, "cast_shadow": False, "receive_shadow": False, "side": "double"}
_THIN = {"thickness": 1.0, "thickness_units": "screen"}
_SHEET = np.array([(0, 2, 1), (0, 3, 2)], dtype=np.uint32)


class FlatView:
    """Draws a design flat, twice, and hands on what a hand does to it. post: runs a function on the document's
    thread."""

    def __init__(self, document: Document, post: Post) -> None:
        self._document, self._post = document, post
        self._grabbed: Point = (0.0, 0.0)

    @property
    def _places(self) -> Places:
        return Places.of(self._document.layout.design.fabric)

    def nodes(self) -> dict[str, Node]:
        document, places = self._document, self._places
        nodes: dict[str, Node] = {}
        for side, shade, title in (("front", FRONT, "front"), ("back", BACK, "back, seen from behind")):
            nodes |= _sheet(places, side, shade, title, document.row_distance)
        broken = {i for line in document.broken() for i in line.muscles}
        for i, muscle in enumerate(document.layout.design.muscles):
            diameter = document.layout.design.muscle_types[muscle.type].outer_diameter
            shade = BROKEN if i in broken else colour(muscle.channel)
            nodes |= _muscle(self, i, muscle, diameter, shade, i == document.selected, places)
        other = document.other()
        legs = [] if other is None else [*_legs(other[0].design.muscles, places)]
        if legs:
            style = {"thickness": 2.5, "thickness_units": "screen"}
            nodes["/flat/other"] = Node("line_segments", {"points": np.array(legs), "colors": (90, 95, 100), **style})
        return nodes

    def select(self, i: int) -> Any:
        return lambda _: self._post(lambda: self._document.select(i))

    def drag_corner(self, i: int, k: int, event: Any) -> None:
        to = self._pointed(i, event)
        if to is not None:
            self._post(lambda: self._document.drag_corner(i, k, to, last=event.phase == "end"))

    def drag_band(self, i: int, event: Any) -> None:
        at = self._pointed(i, event)
        if at is None:
            return
        if event.phase == "start":
            self._grabbed = at
        by = (at[0] - self._grabbed[0], at[1] - self._grabbed[1])
        self._post(lambda: self._document.drag_muscle(i, by, last=event.phase == "end"))

    def _pointed(self, i: int, event: Any) -> Point | None:
        """Return (u, v) m under the pointer, on the face of a muscle, which is selected where a drag begins."""
        muscles = self._document.layout.design.muscles
        eye = np.asarray(event.client.camera.position, dtype=float)
        at = on_plane(eye, np.asarray(event.end_position, dtype=float), LIFT)
        if at is None or i >= len(muscles):
            return None
        if event.phase == "start":
            self.select(i)(event)
        return self._places.fabric_point(at, muscles[i].side)


@lru_cache(maxsize=64)  # in a drag most muscles stay
def _muscle(
    view: FlatView, i: int, muscle: Muscle, diameter: float, shade: Colour, selected: bool, places: Places
) -> dict[str, Node]:
    """Return a muscle's band with its number, and a ball at each end and corner."""
    path = places.flat(np.array(muscle.path), muscle.side)
    vertices, faces = ribbon(path, max(diameter, _LEAST_WIDTH) * (1.5 if selected else 1.0))
    band = {"vertices": vertices, "faces": faces, "color": shade, **_PLAIN}
    label = {"text": f"{i}", "position": path[0] + [0.0, 0.004, 0.004], "anchor": "bottom-center"}
    radius, dark = _HANDLE * (1.3 if selected else 1.0), (20, 20, 20) if selected else shade
    nodes = {
        f"/flat/muscle_{i}": Node("mesh_simple", band, view.select(i), partial(view.drag_band, i)),
        f"/flat/number_{i}": Node("label", label),
    }
    for k, at in enumerate(path):
        ball = {"radius": radius, "color": dark, "position": at + [0.0, 0.0, 0.001], "subdivisions": 2}
        nodes[f"/flat/corner_{i}_{k}"] = Node("icosphere", ball, view.select(i), partial(view.drag_corner, i, k))
    return nodes


@lru_cache(maxsize=4)
def _sheet(places: Places, side: str, shade: Colour, title: str, row_distance: float) -> dict[str, Node]:
    """Return one face of the flat cloth, with lacing rows across and down, `row_distance` m apart."""
    w, h = places.width, places.height
    plane = places.flat(np.array([(0, 0), (w, 0), (w, h), (0, h)], dtype=float), side, lift=0.0)
    above = (float(plane[:, 0].mean()), float(plane[0, 1]) + 0.06 * h, 0.0)
    sheet = {"vertices": plane.astype(np.float32), "faces": _SHEET, "color": shade, **_PLAIN}
    nodes = {
        f"/flat/{side}": Node("mesh_simple", sheet),
        f"/flat/{side}_title": Node("label", {"text": title, "position": above, "anchor": "bottom-center"}),
    }
    ends = [np.array([(0.0, v), (w, v)]) for v in rows(h, row_distance)]
    ends += [np.array([(u, 0.0), (u, h)]) for u in rows(w, row_distance)]
    if ends:
        lines = np.array([places.flat(end, side, lift=0.0003) for end in ends])
        nodes[f"/flat/{side}_rows"] = Node("line_segments", {"points": lines, "colors": (150, 160, 172), **_THIN})
    return nodes


def _legs(muscles: Any, places: Places) -> Iterator[Array]:
    """Yield the ends (2, 3) m of each leg of another drawing's muscles, below the muscles of the one that is shown."""
    for muscle in muscles:
        path = places.flat(np.array(muscle.path), muscle.side, lift=0.8 * LIFT)
        yield from np.stack([path[:-1], path[1:]], axis=1)

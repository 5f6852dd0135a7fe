"""The flat cloth as on the sewing table, front and back: muscles that are clicked and dragged, and lacing rows."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from studies.studio.layout import Point
from studies.studio.scene import BACK, BROKEN, FRONT, LIFT, Places, colour, on_plane, ribbon
from studies.studio.snapping import rows

_HANDLE = 0.0035  # m, radius of an end or corner
_LEAST_WIDTH = 0.0035  # m, of a muscle's band: thinner ones are hard to hit
Array = NDArray[np.float64]


class Hands(Protocol):
    """What a hand does to a layout."""

    def select(self, index: int) -> None: ...

    def drag_corner(self, index: int, corner: int, to: Point, *, last: bool) -> None: ...

    def drag_muscle(self, index: int, by: Point, *, last: bool) -> None:
        """by: since the drag began."""
        ...


@dataclass
class _Drawn:
    """The handles of one muscle, and what they were drawn as."""

    kind: tuple[Any, ...]
    band: Any
    corners: list[Any]
    label: Any
    look: tuple[Any, ...] = ()  # all that it is drawn from


class FlatView:
    """Draws a design flat, twice, and tells `hands` what is done to it. post: runs a function on the thread that owns
    the layout."""

    def __init__(self, scene: Any, hands: Hands, post: Callable[[Callable[[], None]], None]) -> None:
        self._scene, self._hands, self._post = scene, hands, post
        self._muscles: list[_Drawn] = []
        self._places: Places | None = None
        self._sheet: tuple[Any, ...] = ()
        self._grabbed: Point = (0.0, 0.0)
        self._other = False  # whether another drawing's muscles are shown

    def draw(self, design: Design, *, selected: int | None, broken: set[int], row_distance: float | None) -> None:
        """row_distance: m between lacing rows; None: none are shown."""
        fabric = design.fabric
        self._places = places = Places.of(fabric)
        sheet = (fabric.width, fabric.height, row_distance)
        if sheet != self._sheet:
            self._sheet = sheet
            self._draw_sheets(places, row_distance)
        for gone in self._muscles[len(design.muscles) :]:
            gone.band.remove()
            gone.label.remove()
            for corner in gone.corners:
                corner.remove()
        del self._muscles[len(design.muscles) :]
        for i in range(len(design.muscles)):
            self._draw_muscle(i, design, places, i == selected, i in broken)

    def draw_other(self, design: Design | None) -> None:
        """Another drawing's muscles, as thin grey lines; None takes them away."""
        legs = []
        for muscle in () if design is None or self._places is None else design.muscles:
            path = self._places.flat(np.array(muscle.path), muscle.side, lift=0.8 * LIFT)  # type: ignore[union-attr]
            legs += list(np.stack([path[:-1], path[1:]], axis=1))
        if legs:
            self._scene.add_line_segments(
                "/flat/other", np.array(legs), (90, 95, 100), thickness=2.5, thickness_units="screen"
            )
        elif self._other:
            self._scene.remove_by_name("/flat/other")
        self._other = bool(legs)

    def _draw_sheets(self, places: Places, row_distance: float | None) -> None:
        w, h = places.width, places.height
        corners = np.array([(0, 0), (w, 0), (w, h), (0, h)], dtype=float)
        for side, shade in (("front", FRONT), ("back", BACK)):
            plane = places.flat(corners, side, lift=0.0).astype(np.float32)
            faces = np.array([(0, 2, 1), (0, 3, 2)], dtype=np.uint32)
            self._scene.add_mesh_simple(
                f"/flat/{side}", plane, faces, color=shade, side="double", flat_shading=True, cast_shadow=False,
                receive_shadow=False,
            )  # fmt: skip
            title = "front" if side == "front" else "back, seen from behind"
            self._scene.add_label(
                f"/flat/{side}_title", title, position=(float(plane[:, 0].mean()), float(plane[0, 1]) + 0.06 * h, 0.0),
                anchor="bottom-center",
            )  # fmt: skip
            segments = _row_segments(places, side, row_distance)
            if len(segments):
                self._scene.add_line_segments(
                    f"/flat/{side}_rows", segments, (150, 160, 172), thickness=1.0, thickness_units="screen"
                )
            else:
                self._scene.remove_by_name(f"/flat/{side}_rows")

    def _draw_muscle(self, i: int, design: Design, places: Places, selected: bool, broken: bool) -> None:
        muscle = design.muscles[i]
        width = max(design.muscle_types[muscle.type].outer_diameter, _LEAST_WIDTH)
        shade = BROKEN if broken else colour(muscle.channel)
        kind, look = (muscle.side, len(muscle.path)), (muscle, places, width, selected, shade)
        if i < len(self._muscles) and self._muscles[i].look == look:
            return  # in a drag most muscles stay
        path = places.flat(np.array(muscle.path), muscle.side)
        vertices, triangles = ribbon(path, width * (1.5 if selected else 1.0))
        if i == len(self._muscles) or self._muscles[i].kind != kind:
            self._make(i, kind, vertices, triangles, len(path))
        drawn = self._muscles[i]
        drawn.look = look
        drawn.band.vertices, drawn.band.color = vertices, shade
        drawn.label.position = tuple(path[0] + [0.0, 0.004, 0.004])
        drawn.label.text = f"{i}"
        for corner, at in zip(drawn.corners, path, strict=True):
            corner.position = tuple(at + [0.0, 0.0, 0.001])
            corner.color = (20, 20, 20) if selected else shade
            corner.radius = _HANDLE * (1.3 if selected else 1.0)

    def _make(self, i: int, kind: tuple[Any, ...], vertices: Any, triangles: Any, corners: int) -> None:
        if i < len(self._muscles):
            old = self._muscles[i]
            for corner in old.corners:
                corner.remove()
        name, side = f"/flat/muscle_{i}", kind[0]
        band = self._scene.add_mesh_simple(
            name, vertices, triangles, side="double", flat_shading=True, cast_shadow=False, receive_shadow=False
        )
        label = self._scene.add_label(f"/flat/number_{i}", f"{i}", anchor="bottom-center")
        balls = [self._scene.add_icosphere(f"/flat/corner_{i}_{k}", _HANDLE, subdivisions=2) for k in range(corners)]
        drawn = _Drawn(kind, band, balls, label)
        self._muscles[i : i + 1] = [drawn]
        band.on_click(lambda _: self._post(lambda: self._hands.select(i)))
        band.on_drag("left")(lambda event: self._band_dragged(i, side, event))
        for k, ball in enumerate(balls):
            ball.on_click(lambda _: self._post(lambda: self._hands.select(i)))
            ball.on_drag("left")(lambda event, k=k: self._corner_dragged(i, k, side, event))

    def _corner_dragged(self, i: int, k: int, side: str, event: Any) -> None:
        to = self._pointed(side, event)
        if to is None:
            return
        if event.phase == "start":
            self._post(lambda: self._hands.select(i))
        self._post(lambda: self._hands.drag_corner(i, k, to, last=event.phase == "end"))

    def _band_dragged(self, i: int, side: str, event: Any) -> None:
        at = self._pointed(side, event)
        if at is None:
            return
        if event.phase == "start":
            self._grabbed = at
            self._post(lambda: self._hands.select(i))
        by = (at[0] - self._grabbed[0], at[1] - self._grabbed[1])
        self._post(lambda: self._hands.drag_muscle(i, by, last=event.phase == "end"))

    def _pointed(self, side: str, event: Any) -> Point | None:
        """(u, v) m under the pointer."""
        assert self._places is not None
        eye = np.asarray(event.client.camera.position, dtype=float)
        at = on_plane(eye, np.asarray(event.end_position, dtype=float), LIFT)
        return None if at is None else self._places.fabric_point(at, side)


def _row_segments(places: Places, side: str, distance: float | None) -> Array:
    """(n, 2, 3) m, lacing rows across and down."""
    if distance is None:
        return np.zeros((0, 2, 3))
    w, h = places.width, places.height
    across, down = rows(h, distance), rows(w, distance)
    ends = [np.array([(0.0, v), (w, v)]) for v in across] + [np.array([(u, 0.0), (u, h)]) for u in down]
    return np.array([places.flat(end, side, lift=0.0003) for end in ends]).reshape(-1, 2, 3)

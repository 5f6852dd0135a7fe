"""Where the pieces stand in the one scene, from where one looks at first, and the colours; and the flat cloth as on the
sewing table, front and back: muscles that are clicked and dragged, and lacing rows."""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.geometry.shape import Shape, at_places
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.muscle import Muscle
from studies.studio.document import Document
from studies.studio.layout import Point, rows
from studies.studio.widgets.declared import LIFT, Node

Colour = tuple[int, int, int]
# of channels, one after another; distinct also to most who see no red or green
COLOURS = (
    (0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167),
    (86, 180, 233), (160, 110, 60), (90, 90, 200), (120, 150, 40),
)  # fmt: skip
BROKEN = (220, 30, 30)
FRONT, BACK = (214, 222, 232), (196, 204, 190)  # of the cloth's faces
VIEW, ASPECT = 0.6, 1.3  # rad that is seen from top to bottom; width over height of what the panel leaves, mostly
_FILLED = 0.97  # of the picture, by what is to be in view
_PLOT = 0.5  # of the cloth's height, that a program's plot has
_GAP = 0.25  # of the cloth's longer side, between the pieces
_BENT = 0.2  # of the cloth's height, that a bent one comes forward or back, and is in view at first
# of the hung cloth in the scene: it is seen in three-quarters view, where it bends
HUNG_TURN = Rotation.from_euler("yx", [-40.0, 15.0], degrees=True)


@dataclass(frozen=True)
class Places:
    """A cloth of width and height [m]: its front lies above its back, the hung cloth to their right. The origin is the
    middle of all of it."""

    width: float
    height: float

    @staticmethod
    def of(fabric: Fabric) -> "Places":
        return Places(fabric.width, fabric.height)

    @property
    def gap(self) -> float:
        """Return the distance [m] between the pieces."""
        return _GAP * max(self.width, self.height)

    def flat_origin(self, side: str) -> tuple[float, float]:
        """Return (x, y) m of the upper left corner of a flat face."""
        left = -self.width - self.gap
        return left, (self.height + self.gap / 2 if side == "front" else -self.gap / 2)

    @property
    def hung_origin(self) -> tuple[float, float, float]:
        """Return the middle [m] of the hung cloth's top edge."""
        return (self.gap + self.width / 2, self.height / 2 + self.gap / 2, 0.0)

    @property
    def plot(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return (x, y) m of the lower left corner of a program's plot, and its width and height, below the hung
        cloth."""
        return (self.gap, -self.height - self.gap / 2), (self.width, _PLOT * self.height)

    @property
    def outline(self) -> Array:
        """Return the corners (n, 3) m of all of it: flat faces, titles, the room of the hung cloth when it bends."""
        title, corners = 0.6 * self.gap, np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * [self.width, self.height]
        flat = np.concatenate([self.flat(corners, side) for side in ("front", "back")])
        x, y, z = (1.08 * self.width / 2, self.height, _BENT * self.height)
        box = np.array([(i, j, k) for i in (-x, x) for j in (0, -y) for k in ((-z, z) if j else (0,))], dtype=float)
        return np.concatenate([flat, flat + [0, title, 0], HUNG_TURN.apply(box) + self.hung_origin])

    def flat(self, points: Array, side: str, *, lift: float = LIFT) -> Array:
        """Return (n, 3) m of points (n, 2) in fabric coordinates; from behind, right is left."""
        (x, y), u, v = self.flat_origin(side), points[:, 0], points[:, 1]
        across = u if side == "front" else self.width - u
        return np.stack([x + across, y - v, np.full_like(u, lift)], axis=1)

    def fabric_point(self, at: Array, side: str) -> Point:
        """Return (u, v) m of a place (3,) on a flat face."""
        x, y = self.flat_origin(side)
        across = float(at[0]) - x
        return (across if side == "front" else self.width - across), y - float(at[1])


def colour(channel: int) -> Colour:
    return COLOURS[channel % len(COLOURS)]


def ribbon(path: Array, width: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return vertices (4 n, 3) m and triangles (2 n, 3) of a flat band, `width` m wide, along (n + 1, 3) m."""
    legs = np.diff(path, axis=0)
    length = np.maximum(np.linalg.norm(legs, axis=1, keepdims=True), 1e-9)
    along = legs / length * width / 2
    across = np.stack([-along[:, 1], along[:, 0], np.zeros(len(along))], axis=1)
    a, b = path[:-1] - along, path[1:] + along
    vertices = np.stack([a + across, a - across, b - across, b + across], axis=1).reshape(-1, 3)
    first = 4 * np.arange(len(legs))[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]], axis=1).reshape(-1, 3)
    return vertices.astype(np.float32), triangles.astype(np.uint32)


def laced(points: NDArray[np.float32], muscle: Muscle, fabric: Fabric) -> Array:
    """Return a muscle's fixed points (n, 3) m on a shape (2 m^2, 3) m of the cloth, a little off its face."""
    faces = at_places(Shape.of(points).faces, muscle.fixed_points() / [fabric.width, fabric.height])
    face, behind = faces if muscle.side == "front" else faces[::-1]
    return np.asarray(face + 0.75 * (face - behind))


def heat(values: Array, largest: float) -> NDArray[np.uint8]:
    """Return (n, 3) colours of values from 0 to `largest`: white to dark red."""
    stops = np.array([(247, 247, 247), (253, 219, 146), (239, 101, 72), (127, 0, 0)], dtype=float)
    at = np.linspace(0, max(largest, 1e-12), len(stops))
    return np.rint([np.interp(values, at, stop) for stop in stops.T]).T.astype(np.uint8)


def eye_of(places: Places, aspect: float = ASPECT) -> tuple[float, float, float]:
    """Return where [m] one looks from at first, towards the origin: all is in view, a little from the right and above.
    aspect: width over height of the picture."""
    back = np.array([0.12, 0.1, 1.0]) / np.linalg.norm([0.12, 0.1, 1.0])
    right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
    points, high = places.outline, _FILLED * np.tan(VIEW / 2)
    across, up = np.abs(points @ right) / aspect, np.abs(points @ np.cross(back, right))
    x, y, z = back * (np.maximum(across, up) / high + points @ back).max()
    return float(x), float(y), float(z)


_HANDLE = 0.0035  # m, radius of an end or corner
_LEAST_WIDTH = 0.0035  # m, of a muscle's band: thinner ones are hard to hit
_PLAIN = {"flat_shading": True, "cast_shadow": False, "receive_shadow": False, "side": "double"}
_SHEET = np.array([(0, 2, 1), (0, 3, 2)], dtype=np.uint32)


def lines(*paths: Array, shade: Colour, thickness: float = 1.0, **look: Any) -> Node:
    """Return lines, each through points (n, 3) m. thickness: pixels, or m with `thickness_units` "world" in `look`,
    which is more of viser's."""
    points = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in paths])
    given = {"points": points, "colors": shade, "thickness": thickness, "thickness_units": "screen", **look}
    return Node("line_segments", given)


def flat_nodes(document: Document) -> dict[str, Node]:
    """Return a design flat, twice, with what a hand does to it."""
    design, places = document.layout.design, Places.of(document.layout.design.fabric)
    nodes: dict[str, Node] = {}
    for side, shade, title in (("front", FRONT, "front"), ("back", BACK, "back, seen from behind")):
        nodes |= _sheet(places, side, shade, title, document.row_distance)
    broken = {i for line in document.broken for i in line.muscles}
    for i, muscle in enumerate(design.muscles):
        shade = BROKEN if i in broken else colour(muscle.channel)
        diameter = design.muscle_types[muscle.type].outer_diameter
        nodes |= _muscle(document, i, muscle, diameter, shade, i == document.selected, places)
    if document.other is not None and (others := document.other.at(document.pose).design.muscles):
        paths = [places.flat(np.array(m.path), m.side, lift=0.8 * LIFT) for m in others]
        nodes["/flat/other"] = lines(*paths, shade=(90, 95, 100), thickness=2.5)  # below the muscles shown
    return nodes


@lru_cache(maxsize=64)  # in a drag most muscles stay
def _muscle(
    document: Document, i: int, muscle: Muscle, diameter: float, shade: Colour, selected: bool, places: Places
) -> dict[str, Node]:
    """Return a muscle's band with its number, and a ball at each end and corner."""
    path = places.flat(np.array(muscle.path), muscle.side)
    vertices, faces = ribbon(path, max(diameter, _LEAST_WIDTH) * (1.5 if selected else 1.0))
    band = {"vertices": vertices, "faces": faces, "color": shade, **_PLAIN}
    label = {"text": f"{i}", "position": path[0] + [0.0, 0.004, 0.004], "anchor": "bottom-center"}
    look = {"radius": _HANDLE * (1.3 if selected else 1.0), "color": (20, 20, 20) if selected else shade}
    select = partial(document.select, i)

    def drag_band(begin: Array, at: Array, last: bool) -> None:
        (u, v), (u0, v0) = (places.fabric_point(place, muscle.side) for place in (at, begin))
        document.drag_muscle(i, (u - u0, v - v0), last=last)

    def drag_corner(k: int, _: Array, at: Array, last: bool) -> None:
        document.drag_corner(i, k, places.fabric_point(at, muscle.side), last=last)

    nodes = {
        f"/flat/muscle_{i}": Node("mesh_simple", band, select, drag_band),
        f"/flat/number_{i}": Node("label", label),
    }
    for k, place in enumerate(path):
        ball = {"position": place + [0.0, 0.0, 0.001], "subdivisions": 2, **look}
        nodes[f"/flat/corner_{i}_{k}"] = Node("icosphere", ball, select, partial(drag_corner, k))
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
    ends = [[(0.0, v), (w, v)] for v in rows(h, row_distance)] + [[(u, 0.0), (u, h)] for u in rows(w, row_distance)]
    if ends:
        threads = [places.flat(np.array(end), side, lift=0.0003) for end in ends]
        nodes[f"/flat/{side}_rows"] = lines(*threads, shade=(150, 160, 172))
    return nodes

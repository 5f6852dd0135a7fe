"""Where the pieces stand in the one scene: the flat cloth from the front, from behind, and the cloth as it hangs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.fabric import Fabric
from fabdesign.muscle import Muscle
from studies.studio.layout import Point

Array = NDArray[np.float64]
LIFT = 0.0015  # m, of muscles above the flat cloth
# of channels, one after another; distinct also to most who see no red or green
COLOURS = (
    (0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167),
    (86, 180, 233), (160, 110, 60), (90, 90, 200), (120, 150, 40),
)  # fmt: skip
BROKEN = (220, 30, 30)
FRONT, BACK = (214, 222, 232), (196, 204, 190)  # of the cloth's faces
_GAP = 0.25  # of the cloth's longer side, between the pieces
_BENT = 0.2  # of the cloth's height, that a bent one comes forward or back, and is in view at first
_TURN, _TILT = -40.0, 15.0  # degrees about y and then x: the hung cloth is seen in three-quarters view, where it bends


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
        """m, between the pieces."""
        return _GAP * max(self.width, self.height)

    def flat_origin(self, side: str) -> tuple[float, float]:
        """(x, y) m of the upper left corner of a flat face."""
        left = -self.width - self.gap
        return left, (self.height + self.gap / 2 if side == "front" else -self.gap / 2)

    @property
    def hung_origin(self) -> tuple[float, float, float]:
        """m, of the middle of the hung cloth's top edge."""
        return (self.gap + self.width / 2, self.height / 2 + self.gap / 2, 0.0)

    @property
    def hung_turn(self) -> tuple[float, float, float, float]:
        """w, x, y, z of the hung cloth's turn in the scene."""
        y, x = np.radians([_TURN, _TILT]) / 2
        w = float(np.cos(x) * np.cos(y))
        return w, float(np.sin(x) * np.cos(y)), float(np.cos(x) * np.sin(y)), float(np.sin(x) * np.sin(y))

    @property
    def outline(self) -> Array:
        """(n, 3) m, corners of all of it: flat faces, their titles, and the room of the hung cloth when it is bent."""
        title, corners = 0.6 * self.gap, np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * [self.width, self.height]
        flat = np.concatenate([self.flat(corners, side) for side in ("front", "back")])
        x, y, z = (1.08 * self.width / 2, self.height, _BENT * self.height)
        box = np.array([(i, j, k) for i in (-x, x) for j in (0, -y) for k in ((-z, z) if j else (0,))], dtype=float)
        w, *axis = self.hung_turn
        turned = box + 2 * np.cross(axis, np.cross(axis, box) + w * box)
        return np.concatenate([flat, flat + [0, title, 0], turned + self.hung_origin])

    def flat(self, points: Array, side: str, *, lift: float = LIFT) -> Array:
        """(n, 3) m of points (n, 2) in fabric coordinates; from behind, right is left."""
        (x, y), u, v = self.flat_origin(side), points[:, 0], points[:, 1]
        across = u if side == "front" else self.width - u
        return np.stack([x + across, y - v, np.full_like(u, lift)], axis=1)

    def fabric_point(self, at: Array, side: str) -> Point:
        """(u, v) m of a place (3,) on a flat face."""
        x, y = self.flat_origin(side)
        across = float(at[0]) - x
        return (across if side == "front" else self.width - across), y - float(at[1])


def on_plane(eye: Array, through: Array, z: float) -> Array | None:
    """(3,) m where the ray from `eye` through another point meets the plane z; None where it does not."""
    direction = through - eye
    if abs(direction[2]) < 1e-9 or (t := (z - eye[2]) / direction[2]) <= 0:
        return None
    return np.asarray(eye + t * direction)


def colour(channel: int) -> tuple[int, int, int]:
    return COLOURS[channel % len(COLOURS)]


def ribbon(path: Array, width: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices (4 n, 3) m and triangles (2 n, 3) of a flat band of `width` m along a path (n + 1, 3) m in a plane z."""
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
    """(n, 3) m, a muscle's fixed points on a shape (2 m^2, 3) m of the cloth, a little off its face."""
    side = int(np.sqrt(len(points) // 2))
    faces = points.reshape(2, side, side, 3).astype(np.float64)
    own = 0 if muscle.side == "front" else 1
    at = muscle.fixed_points() / [fabric.width, fabric.height] * (side - 1)
    first = np.clip(np.floor(at).astype(int), 0, side - 2)
    (s, t), (i, j) = (at - first).T[:, :, None], first.T
    face = faces[own] + 0.75 * (faces[own] - faces[1 - own])
    upper = (1 - s) * face[j, i] + s * face[j, i + 1]
    lower = (1 - s) * face[j + 1, i] + s * face[j + 1, i + 1]
    return np.asarray((1 - t) * upper + t * lower)


def heat(values: Array, largest: float) -> NDArray[np.uint8]:
    """(n, 3) colours of values from 0 to `largest`: white to dark red."""
    stops = np.array([(247, 247, 247), (253, 219, 146), (239, 101, 72), (127, 0, 0)], dtype=float)
    share = np.clip(values / max(largest, 1e-12), 0, 1) * (len(stops) - 1)
    low = np.minimum(share.astype(int), len(stops) - 2)
    return np.rint(stops[low] + (share - low)[:, None] * (stops[low + 1] - stops[low])).astype(np.uint8)

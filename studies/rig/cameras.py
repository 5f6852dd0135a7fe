"""The sensors of the rig: noisy points of both faces; where four depth cameras stand, and what they meet (z-buffer)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from studies.rig.ground_truth import Sensing
from studies.rig.scene import Scene

Array = NDArray[np.float64]


STRAY_REACH = 0.05  # m around the cloth's box


def faces(scene: Scene, x: Array, uv: Array, side: Array) -> Array:
    """(n, 3) m: points of the faces at `uv` (n, 2) m; side (n,) is 1 in front and -1 at the back."""
    patch = scene.patch
    a1, a2 = patch.matrix(uv, 1, 0) @ x, patch.matrix(uv, 0, 1) @ x
    normal = np.cross(a2, a1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = scene.design.fabric.thickness / 2
    return np.asarray(patch.matrix(uv) @ x + (half * side)[:, None] * normal)


def measure(scene: Scene, x: Array, sensing: Sensing, rng: np.random.Generator) -> Array:
    """One frame: sensing.points points (n, 3) m of the cloth with control points x."""
    n = sensing.points
    fabric = scene.design.fabric
    uv = rng.random((n, 2)) * [fabric.width, fabric.height]
    points = faces(scene, x, uv, rng.choice([-1.0, 1.0], n))
    points += rng.normal(0.0, sensing.noise, points.shape)
    stray = rng.random(n) < sensing.strays
    low, high = points.min(axis=0) - STRAY_REACH, points.max(axis=0) + STRAY_REACH
    points[stray] = rng.uniform(low, high, (int(stray.sum()), 3))
    for distort in scene.sensed:
        points = distort(points)
    return points


Ints = NDArray[np.int64]

CAMERAS = {"front_left": (-1, 1), "front_right": (1, 1), "back_left": (-1, -1), "back_right": (1, -1)}
POSITION = (0.42, 0.02, 0.46)  # m: |x|, y, |z|
LOOKS_AT = (0.0, -0.1, 0.0)  # m
FLYING_REACH = 0.025  # m
POSE_SHIFT, POSE_TURN = 0.010, 2.0  # m and degrees: the most that a nominal pose is off
MESH = 121  # points a side of the surface that is drawn


def mesh(scene: Scene, x: Array) -> tuple[Array, Ints]:
    """Both faces and the hem between them as triangles."""
    fabric = scene.design.fabric
    u, v = np.meshgrid(np.linspace(0, fabric.width, MESH), np.linspace(0, fabric.height, MESH))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    vertices = np.concatenate([faces(scene, x, uv, np.full(len(uv), side)) for side in (1.0, -1.0)])
    k = np.arange(MESH * MESH).reshape(MESH, MESH)
    quads = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 4)
    border = np.concatenate([k[0], k[1:, -1], k[-1, -2::-1], k[-2:0:-1, 0]])
    back = MESH * MESH
    hem = np.stack([border, np.roll(border, -1), np.roll(border, -1) + back, border + back], axis=1)
    every = np.concatenate([quads, quads + back, hem])
    return vertices, np.concatenate([every[:, [0, 1, 2]], every[:, [0, 2, 3]]])


@njit(cache=True)
def draw(points: Array, triangles: Ints, shape: tuple[int, int], pinhole: Array) -> Array:
    """Depth (rows, columns) m at every pixel's ray; infinite where it meets nothing. pinhole: focal lengths and centre,
    columns first, in pixels."""
    rows, columns = shape
    depth = np.full((rows, columns), np.inf)
    fx, fy, cx, cy = pinhole
    for t in range(triangles.shape[0]):
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        ax, ay = a[0] / a[2] * fx + cx, a[1] / a[2] * fy + cy
        bx, by = b[0] / b[2] * fx + cx, b[1] / b[2] * fy + cy
        cx_, cy_ = c[0] / c[2] * fx + cx, c[1] / c[2] * fy + cy
        area = (bx - ax) * (cy_ - ay) - (by - ay) * (cx_ - ax)
        if area == 0.0:
            continue
        for row in range(max(0, int(np.ceil(min(ay, by, cy_)))), min(rows - 1, int(max(ay, by, cy_))) + 1):
            for col in range(max(0, int(np.ceil(min(ax, bx, cx_)))), min(columns - 1, int(max(ax, bx, cx_))) + 1):
                wb = ((col - ax) * (cy_ - ay) - (row - ay) * (cx_ - ax)) / area
                wc = ((bx - ax) * (row - ay) - (by - ay) * (col - ax)) / area
                wa = 1.0 - wb - wc
                if wa >= 0.0 and wb >= 0.0 and wc >= 0.0:  # 1 / z is linear in the image
                    z = 1.0 / (wa / a[2] + wb / b[2] + wc / c[2])
                    depth[row, col] = min(depth[row, col], z)
    return depth


def at_edge(depth: Array, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels beside the background, or beside something more than FLYING_REACH behind."""
    far = np.where(seen, depth, np.inf)
    padded = np.pad(far, 1, constant_values=np.inf)
    around = [padded[1 + i : padded.shape[0] - 1 + i, 1 + j : padded.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    with np.errstate(invalid="ignore"):
        return np.asarray(seen & np.any([n - far > FLYING_REACH for n in around], axis=0))


_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))


def look(x: float, z: float) -> Array:
    """camera_to_world of a camera at (x, POSITION y, z) m that looks at LOOKS_AT; its y axis points down."""
    position = np.array([x, POSITION[1], z])
    forward = np.array(LOOKS_AT) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose


def disturb(pose: Array, rng: np.random.Generator) -> Array:
    """A pose up to POSE_SHIFT and POSE_TURN off."""
    direction, axis = rng.normal(size=(2, 3))
    wrong = pose.copy()
    wrong[:3, 3] += direction / np.linalg.norm(direction) * POSE_SHIFT * rng.random()
    turn = axis / np.linalg.norm(axis) * np.radians(POSE_TURN) * rng.random()
    wrong[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    return wrong

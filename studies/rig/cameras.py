"""The sensors of the rig: noisy points of both faces; four depth cameras (z-buffer, noise, holes, flying pixels); and a
stereo depth camera, by default a RealSense D435i, with what its depth images show of the cloth.

Errors of stereo are made in the disparity d = f B / z [pixels]: noise that neighbours share, since a window is matched;
a ripple of one period a pixel, since a match between two pixels leans to the nearer one (pixel locking; Shimizu,
Okutomi 2001, "Precise sub-pixel estimation on area-based matching"); pixels that fly between two surfaces; holes. At
0.6 m one pixel of disparity is 2.8 % of the depth: the ripple's period.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, generate_binary_structure, maximum_filter
from scipy.spatial.transform import Rotation

from fabdesign.clouds.recording import write_recording
from fabdesign.depth.intrinsics import Intrinsics
from fabdesign.depth.sensor import Sensor
from fabdesign.depth.stream import cloud_of
from fabdesign.formats.json_file import write_json
from fabdesign.nouns.array import Array
from studies.rig.motion import equilibrium
from studies.rig.scene import Scene
from studies.rig.shell import Ints
from studies.rig.specimen import Sensing, TrialTask, control_points, prepare

STRAY_REACH = 0.05  # m around the cloth's box


def faces(scene: Scene, x: Array, uv: Array, side: Array) -> Array:
    """Return (n, 3) m: points of the faces at `uv` (n, 2) m; side (n,) is 1 in front and -1 at the back."""
    patch = scene.patch
    a1, a2 = patch.matrix(uv, 1, 0) @ x, patch.matrix(uv, 0, 1) @ x
    normal = np.cross(a2, a1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = scene.design.fabric.thickness / 2
    return np.asarray(patch.matrix(uv) @ x + (half * side)[:, None] * normal)


def measure(scene: Scene, x: Array, sensing: Sensing, rng: np.random.Generator) -> Array:
    """Return one frame: sensing.points points (n, 3) m of the cloth with control points x."""
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


CAMERAS = {"front_left": (-1, 1), "front_right": (1, 1), "back_left": (-1, -1), "back_right": (1, -1)}
POSITION = (0.42, 0.02, 0.46)  # m: |x|, y, |z|
LOOKS_AT = (0.0, -0.1, 0.0)  # m
PIXEL = 0.0045  # of ray slope between pixels
HALF_IMAGE = 70  # pixels
NOISE = 0.02  # pixels of disparity of a recording's clouds, 0.75 mm at 0.65 m
FLYING_REACH = 0.025  # m
POSE_SHIFT, POSE_TURN = 0.010, 2.0  # m and degrees: the most that a nominal pose is off
MESH = 121  # points a side of the surface that is drawn
FRAMES = 10


def record(task: TrialTask, folder: Path, truth_file: Path) -> None:
    """Write the task's motion as FRAMES frames seen by the four cameras into `folder`, its name that of the recording,
    and their true poses to `truth_file`."""
    scene = prepare(task)
    rng = np.random.default_rng([task.truth.seed, task.order, 2])
    nominal = [Sensor(name, look(x * POSITION[0], z * POSITION[2])) for name, (x, z) in CAMERAS.items()]
    truth = [Sensor(s.name, disturb(s.camera_to_world, rng)) for s in nominal]
    shown = np.unique(np.linspace(0, len(task.times) - 1, FRAMES).round().astype(int))
    shapes = control_points(task)[shown]
    rest = equilibrium(scene, scene.patch.flat(), np.zeros(task.design.channels))
    optics = Intrinsics(2 * HALF_IMAGE + 1, 2 * HALF_IMAGE + 1, (1 / PIXEL, 1 / PIXEL), (HALF_IMAGE, HALF_IMAGE))
    camera = StereoCamera(optics, unit=2e-5, noise=NOISE, shared=0.0, ripple=task.truth.sensing.ripple)

    def view(x: Array, sensor: Sensor) -> Array:
        return cloud_of(camera.image(scene, x, sensor.camera_to_world, rng) * camera.unit, optics.slopes)

    frames = [{s.name: view(x, s) for s in truth} for x in shapes]
    reference = {s.name: view(rest, s) for s in truth}
    write_recording(folder, task.design, task.program, task.times[shown], nominal, frames, reference)
    poses = {s.name: s.camera_to_world.tolist() for s in truth}
    write_json(truth_file, {"camera_to_world": poses})


def mesh(scene: Scene, x: Array) -> tuple[Array, Ints]:
    """Return both faces and the hem between them as triangles."""
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
    """Return depths (rows, columns) m at every pixel's ray; infinite where it meets nothing. pinhole: focal lengths and
    centre, columns first, in pixels."""
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
    """Return pixels beside the background, or beside something more than FLYING_REACH behind."""
    far = np.where(seen, depth, np.inf)
    around = maximum_filter(far, footprint=generate_binary_structure(2, 1), mode="constant", cval=np.inf)
    with np.errstate(invalid="ignore"):
        return np.asarray(seen & (around - far > FLYING_REACH))


def look(x: float, z: float) -> Array:
    """Return camera_to_world of a camera at (x, POSITION y, z) m that looks at LOOKS_AT; its y axis points down."""
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
    """Return a pose up to POSE_SHIFT and POSE_TURN off."""
    direction, axis = rng.normal(size=(2, 3))
    wrong = pose.copy()
    wrong[:3, 3] += direction / np.linalg.norm(direction) * POSE_SHIFT * rng.random()
    turn = axis / np.linalg.norm(axis) * np.radians(POSE_TURN) * rng.random()
    wrong[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    return wrong


@dataclass(frozen=True)
class StereoCamera:
    """Optics and errors; shares are of pixels."""

    optics: Intrinsics = field(default_factory=lambda: Intrinsics(848, 480, (425.0, 425.0), (424.0, 240.0)))
    baseline: float = 0.05  # m
    unit: float = 1e-3  # m of a depth step
    noise: float = 0.04  # pixels of disparity, 0.8 mm at 0.65 m
    shared: float = 1.0  # pixels, standard deviation of the window over which neighbours share their noise
    ripple: float = 0.05  # pixels of disparity, amplitude: 0.85 mm at 0.6 m
    holes: float = 0.03
    flying: float = 0.35  # of those at an edge

    def image(self, scene: Scene, x: Array, pose: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return the depth image (height, width) of the cloth with control points x. pose: camera_to_world (4, 4) m."""
        vertices, triangles = mesh(scene, x)
        for distort in scene.sensed:
            vertices = distort(vertices)
        (fx, fy), (cx, cy) = self.optics.focal, self.optics.centre
        shape = self.optics.height, self.optics.width
        seen = (vertices - pose[:3, 3]) @ pose[:3, :3]
        return self.reported(draw(seen, triangles, shape, np.array([fx, fy, cx, cy])), rng)

    def reported(self, depth: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return what the camera makes of true depths (rows, columns) m; infinite: nothing there, 0 in the image."""
        seen = np.isfinite(depth)
        rows, columns = np.nonzero(seen)
        image = np.zeros(depth.shape, np.uint16)
        if not len(rows):
            return image
        part = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
        depth, seen = depth[part], seen[part]
        noise = gaussian_filter(rng.normal(0.0, 1.0, depth.shape), self.shared)
        noise *= self.noise * max(1.0, 2.0 * np.sqrt(np.pi) * self.shared)
        scale = self.optics.focal[0] * self.baseline
        with np.errstate(divide="ignore", invalid="ignore"):
            disparity = scale / depth
            disparity = disparity + noise - self.ripple * np.sin(2 * np.pi * disparity)
            z = scale / disparity
        flies = at_edge(depth, seen) & (rng.random(depth.shape) < self.flying)
        z = z + flies * rng.uniform(0.0, FLYING_REACH, depth.shape)
        kept = seen & (rng.random(depth.shape) >= self.holes) & np.isfinite(z)
        image[part] = np.where(kept, np.clip(np.nan_to_num(z) / self.unit, 0, 65535), 0).round().astype(np.uint16)
        return image

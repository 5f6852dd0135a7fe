"""A virtual stereo depth camera, by default a RealSense D435i: what its depth images show of the cloth.

Errors are those of stereo, so they are made in the disparity d = f B / z [pixels]: noise that neighbours share, since a
window is matched; a ripple of one period a pixel, since a match between two pixels leans to the nearer one (pixel
locking; Shimizu, Okutomi 2001, "Precise sub-pixel estimation on area-based matching"); pixels that fly between two
surfaces; holes. At 0.6 m one pixel of disparity is 2.8 % of the depth: the ripple's period.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fabdesign.clouds.recording import write_recording
from fabdesign.depth.intrinsics import Intrinsics
from fabdesign.depth.sensor import Sensor
from fabdesign.depth.stream import cloud_of
from fabdesign.formats.json_file import write_json
from studies.rig.cameras import CAMERAS, FLYING_REACH, POSITION, Ints, at_edge, disturb, draw, look, mesh
from studies.rig.motion import equilibrium
from studies.rig.scene import Scene
from studies.rig.specimen import TrialTask, control_points, prepare

Array = NDArray[np.float64]
PIXEL, HALF_IMAGE = 0.0045, 70  # of a recording's clouds: ray slope between pixels, and pixels
NOISE = 0.02  # pixels of disparity, 0.75 mm at 0.65 m
FRAMES = 10


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
    frame_rate: float = 30.0  # Hz

    def image(
        self, scene: Scene, x: Array, pose: Array, rng: np.random.Generator, beside: Sequence[tuple[Array, Ints]] = ()
    ) -> NDArray[np.uint16]:
        """Return the depth image (height, width) of the cloth with control points x, and of meshes beside it.

        pose: camera_to_world (4, 4) m.
        """
        vertices, triangles = mesh(scene, x)
        for distort in scene.sensed:
            vertices = distort(vertices)
        for points, faces in beside:
            triangles = np.concatenate([triangles, faces + len(vertices)])
            vertices = np.concatenate([vertices, points])
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


def bar(low: Sequence[float], high: Sequence[float]) -> tuple[Array, Ints]:
    """Return a box between two corners [m] as vertices and triangles: a bar of the frame, or a wall."""
    corners = np.array([[(low, high)[(k >> axis) & 1][axis] for axis in range(3)] for k in range(8)], dtype=np.float64)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


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
        return cloud_of(camera.image(scene, x, sensor.camera_to_world, rng), camera.unit, optics)

    frames = [{s.name: view(x, s) for s in truth} for x in shapes]
    reference = {s.name: view(rest, s) for s in truth}
    write_recording(folder, task.design, task.program, task.times[shown], nominal, frames, reference)
    poses = {s.name: s.camera_to_world.tolist() for s in truth}
    write_json(truth_file, {"camera_to_world": poses})

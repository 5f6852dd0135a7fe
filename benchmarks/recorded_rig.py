"""A virtual rig of four depth cameras, each on its own clock, whose shapes, poses and clocks are known."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import write_pressures
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.pressure import PressureProgram
from studies.rig.cameras import CAMERAS, POSITION, StereoCamera, disturb, look, mesh
from studies.rig.motion import equilibrium
from studies.rig.scene import Resolution, Scene
from studies.rig.specimen import GroundTruth, TrialTask, control_points, prepare

DURATION, REST = 2.0, 0.8  # s, of the motion and before it
FINE = 1 / 480  # s between the shapes that are kept
OFFSETS = (0.0, 0.040, -0.040, 0.025)  # s
DRIFTS = (0.0, 200e-6, -200e-6, 100e-6)
LOST = 0.01  # of the images
STEPS = (0.0, 0.7, 1.4)  # s
ROWS = ((100, 400, 400, 300, 200, 200, 0, 100), (0, 200, 100, 0, 100, 300, 300, 0), (300, 0, 0, 300, 0, 100, 400, 200))


@dataclass(frozen=True, eq=False)
class RecordedRig:
    """What is true, and the images."""

    task: TrialTask
    names: tuple[str, ...]
    nominal: dict[str, Array]
    poses: dict[str, Array]
    true: dict[str, Array]  # s, when each image was exposed
    lost: dict[str, int]
    drifts: dict[str, float]
    camera: StereoCamera
    seed: int

    @cached_property
    def scene(self) -> Scene:
        return prepare(self.task)

    @cached_property
    def _shapes(self) -> tuple[Array, Array]:
        rest = equilibrium(self.scene, self.scene.patch.flat(), np.zeros(self.task.design.channels))
        return rest, control_points(self.task)

    def shape(self, time: float) -> Array:
        """Return the control points at a time [s]; before 0 at rest."""
        rest, shapes = self._shapes
        place = time / FINE - 1  # the first one is one interval after 0
        if place < 0:
            share = max(place + 1, 0.0)
            return np.asarray(rest + share * (shapes[0] - rest))
        k = min(int(place), len(shapes) - 2)
        return np.asarray(shapes[k] + (place - k) * (shapes[k + 1] - shapes[k]))

    def surface(self, time: float) -> Surface:
        """Return the true faces at a time [s]."""
        if time not in self._surfaces:
            self._surfaces[time] = Surface(*mesh(self.scene, self.shape(time)))
        return self._surfaces[time]

    @cached_property
    def _surfaces(self) -> dict[float, Surface]:
        return {}

    def stamps(self, name: str) -> Array:
        """Return a camera's stamps [s] on its own clock."""
        k = self.names.index(name)
        return np.asarray(100.0 + self.true[name] * (1 + DRIFTS[k]) + OFFSETS[k])

    def ahead(self, name: str) -> float:
        """Return by how much [s] a camera's clock is ahead of the first one's, in the middle of its stamps."""
        first = self.stamps(self.names[0])
        middle = 0.5 * (first[0] + first[-1])
        true = middle - 100.0
        k = self.names.index(name)
        return true * DRIFTS[k] + OFFSETS[k]

    def write(self, folder: Path, ending: str) -> None:
        """Write a recording whose sensors name files NAME + ending, and the images as NAME.npz."""
        folder.mkdir(parents=True, exist_ok=True)
        key = "images" if ending == ".npz" else "bag"
        lines = ['format = "fabdesign.recording/1"', f'name = "{folder.name}"', 'design = "design.toml"']
        rng = np.random.default_rng([self.seed, 3])
        write_design(self.task.design, folder / "design.toml")
        write_pressures(self.task.program, folder / "pressure.csv")
        (fx, fy), (cx, cy) = self.camera.optics.focal, self.camera.optics.centre
        for name in self.names:
            images = [self.camera.image(self.scene, self.shape(t), self.poses[name], rng) for t in self.true[name]]
            pose = np.round(self.nominal[name], 6).tolist()
            lines += ["[[sensors]]", f'name = "{name}"', f'{key} = "{name}{ending}"', f"camera_to_world = {pose}"]
            content: dict[str, Any] = {
                "depth": np.array(images),
                "stamps": self.stamps(name),
                "numbers": np.round((self.true[name] - self.true[name][0]) * 30).astype(int),
                "unit": self.camera.unit,
                "pinhole": [fx, fy, cx, cy],
                "intrinsics": np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
                "model": "brown_conrady",
                "coefficients": np.zeros(5),
            }
            np.savez_compressed(folder / f"{name}.npz", **content)
        (folder / "recording.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def make_rig(folder: Path, *, seed: int = 5, camera: StereoCamera | None = None) -> RecordedRig:
    """Return the rig; its motion is computed once and kept in the user's cache."""
    design = build("basic")
    program = PressureProgram(np.array(STEPS), 1e3 * np.array(ROWS, dtype=np.float64), DURATION)
    truth = GroundTruth(seed=seed, parameters={"membrane": 1.1, "bending": 0.9, "muscle_gain": 1.05})
    times: Array = np.arange(1, round(DURATION / FINE) + 1, dtype=np.float64) * FINE
    task = TrialTask(design, program, times, 0, truth, Resolution(element=0.02, step=FINE))
    rng = np.random.default_rng(seed)
    names = tuple(CAMERAS)
    nominal = {name: look(x * POSITION[0], z * POSITION[2]) for name, (x, z) in CAMERAS.items()}
    true, lost = {}, {}
    for name in names:
        exposed = np.arange(-REST + rng.uniform(0, 1 / 30), DURATION, 1 / 30)
        kept = rng.random(len(exposed)) >= LOST
        kept[[0, 1, -2, -1]] = True
        if name == names[0]:
            kept[len(kept) // 2] = False  # one at least
        true[name], lost[name] = exposed[kept], int((~kept).sum())
    poses = {name: disturb(pose, rng) for name, pose in nominal.items()}
    return RecordedRig(
        task, names, nominal, poses, true, lost, dict(zip(names, DRIFTS, strict=True)), camera or StereoCamera(), seed
    )


def rms_to_faces(rig: RecordedRig, times: Any, clouds: Any) -> float:
    """Return the root mean square distance [m] of clouds to the true faces at their times [s]."""
    squares = []
    for time, cloud in zip(times, clouds, strict=True):
        squares.append(rig.surface(round(float(time), 6)).distance(cloud) ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))

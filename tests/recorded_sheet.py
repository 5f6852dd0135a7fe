"""A cloth of known motion before four small depth cameras, each on its own clock: recordings in memory, for tests."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.design_file import write_design
from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import build
from studies.rig.cameras import CAMERAS, POSITION, StereoCamera, disturb, draw, look

DESIGN = build("cross", muscles=2)
SIDE = 41  # points
STEPS = (0.0, 0.55)  # s
DURATION, REST = 1.1, 0.35  # s
OFFSETS = (0.0, 0.030, -0.045, 0.020)  # s
PINHOLE = (220.0, 220.0, 120.0, 110.0)
SIZE = 220, 240  # rows, columns
CAMERA = StereoCamera(noise=0.02, ripple=0.02, shared=0.7, unit=2e-4)


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera's images, when they were exposed, and its own stamps of them."""

    nominal: Array
    pose: Array
    true: Array
    stamps: Array
    depth: NDArray[np.uint16]

    def without(self, *numbers: int) -> "Camera":
        """Return the camera without images, which were lost."""
        kept = np.delete(np.arange(len(self.true)), numbers)
        return replace(self, true=self.true[kept], stamps=self.stamps[kept], depth=self.depth[kept])


def height(v: Array, u: Array, time: float) -> Array:
    """Return z [m] of the middle surface at a time [s]: it answers each step as a critically damped mass."""
    fabric = DESIGN.fabric
    down, across = v / fabric.height, u / fabric.width - 0.5
    z = np.zeros_like(v)
    for k, (step, size) in enumerate(zip(STEPS, (0.05, -0.035), strict=True)):
        after = max(time - step, 0.0) / 0.045
        shape = down**2 * (1 + 0.8 * across) if k == 0 else down**2 + 0.5 * np.sin(3 * across) * down
        z = z + size * (1 - (1 + after) * np.exp(-after)) * shape
    return z


def faces(time: float) -> tuple[Array, NDArray[np.int64]]:
    """Return both faces as vertices and triangles."""
    fabric = DESIGN.fabric
    u, v = np.meshgrid(np.linspace(0, fabric.width, SIDE), np.linspace(0, fabric.height, SIDE))
    half = fabric.thickness / 2
    z, e = height(v, u, time), 1e-4
    slopes = [(height(v + e * a, u + e * b, time) - z) / e for a, b in ((0, 1), (1, 0))]
    normal = np.stack([-slopes[0], slopes[1], np.ones_like(z)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    middle = np.stack([u - fabric.width / 2, -v, z], axis=-1)
    k = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    quads = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 4)
    vertices = np.concatenate([(middle + s * half * normal).reshape(-1, 3) for s in (1.0, -1.0)])
    every = np.concatenate([quads, quads + SIDE * SIDE])
    return vertices, np.concatenate([every[:, [0, 1, 2]], every[:, [0, 2, 3]]])


@cache
def cameras() -> dict[str, Camera]:
    """Return the four cameras; 30 Hz, not together."""
    rng = np.random.default_rng(4)
    made = {}
    for (name, (x, z)), offset in zip(CAMERAS.items(), OFFSETS, strict=True):
        nominal = look(x * POSITION[0], z * POSITION[2])
        pose = disturb(nominal, rng)
        true = np.arange(-REST + rng.uniform(0, 1 / 30), DURATION, 1 / 30)
        made[name] = Camera(nominal, pose, true, true + 50 + offset, images(pose, true, rng))
    return made


def images(pose: Array, times: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return what a camera sees at times [s]."""
    seen = []
    for time in times:
        vertices, triangles = faces(float(time))
        local = (vertices - pose[:3, 3]) @ pose[:3, :3]
        seen.append(CAMERA.reported(draw(local, triangles, SIZE, np.array(PINHOLE)), rng))
    return np.array(seen)


def write(folder: Path, made: dict[str, Camera], *, more: str = "", pressure: str = "") -> Path:
    """Write a recording of npz stacks."""
    folder.mkdir(parents=True, exist_ok=True)
    write_design(DESIGN, folder / "design.toml")
    rows = pressure or f"time_s,channel_0,channel_1\n0,300,0\n{STEPS[1]},0,200\n"
    (folder / "pressure.csv").write_text(rows)
    lines = ['format = "fabdesign.recording/1"', 'name = "sheet"', 'design = "design.toml"', more]
    fx, fy, cx, cy = PINHOLE
    for name, camera in made.items():
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        np.savez(folder / f"{name}.npz", depth=camera.depth, stamps=camera.stamps, unit=CAMERA.unit, intrinsics=matrix)
        pose = np.round(camera.nominal, 6).tolist()
        lines += ["[[sensors]]", f'name = "{name}"', f'images = "{name}.npz"', f"camera_to_world = {pose}"]
    (folder / "recording.toml").write_text("\n".join(lines) + "\n")
    return folder

"""Targets: the clouds that studies come close to, and how close a result came."""

import hashlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.cloud_file import read_cloud
from fabdesign.design import Design
from fabdesign.distances import chamfer
from fabdesign.errors import InputError
from fabdesign.metrics import chamfer_floor, surface_floor, surface_rms
from fabdesign.sensor_noise import SensorNoise, estimate_noise
from fabdesign.study_file import TargetFile
from fabdesign.table import load_toml
from fabdesign.trial_file import read_trial


@dataclass(frozen=True, eq=False)
class LoadedTarget:
    """A cloud and where it comes from. time: s after rest, of a trial's frame; None: a shape at equilibrium."""

    points: NDArray[np.float64]  # (n, 3) m
    time: float | None
    description: str
    synthetic: bool  # measured by a synthetic rig
    noise: SensorNoise

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.points.tobytes()).hexdigest()


@dataclass(frozen=True)
class TargetErrors:
    """m, as formats.md defines them."""

    chamfer: float
    chamfer_floor: float
    surface_rms: float
    surface_floor: float


def load_target(target: TargetFile, design: Design) -> LoadedTarget:
    """Read a trial's frame (.npz), a PLY or npz cloud, or a mesh. Raises InputError."""
    fabric = design.fabric
    if target.file.suffix != ".npz":
        points = read_cloud(target.file, size=max(fabric.width, fabric.height))
        return make_target(points, None, target.description or target.file.name, design)
    trial = read_trial(target.file, size=max(fabric.width, fabric.height))
    count = len(trial.frames)
    if not -count <= target.frame < count:
        raise InputError(f"{target.file}: frame {target.frame}; expected -{count} to {count - 1}")
    time = float(trial.time[target.frame])
    where = f"frame {target.frame % count} of {target.file.stem}, {time:.3g} s after rest"
    text = ", ".join(filter(None, [target.description or where, _set_description(target.file)]))
    return make_target(trial.frames[target.frame], time, text, design)


def make_target(points: NDArray[np.float64], time: float | None, description: str, design: Design) -> LoadedTarget:
    """A target from points (n, 3) m in memory; its sensor noise is estimated."""
    noise = estimate_noise([points], design.fabric.thickness)
    return LoadedTarget(points, time, description, "synthetic rig" in description, noise)


def target_errors(targets: Sequence[LoadedTarget], shapes: NDArray[np.float64], seed: int) -> TargetErrors:
    """Mean over the targets, with shapes (poses, 2 n, 3) m; the floors are drawn with `seed`."""
    rows = []
    for target, shape in zip(targets, shapes, strict=True):
        count = len(target.points)
        rows.append(
            TargetErrors(
                chamfer(target.points, shape),
                chamfer_floor(shape, count, target.noise, seed=seed),
                surface_rms(target.points, shape),
                surface_floor(shape, count, target.noise, seed=seed),
            )
        )
    return TargetErrors(*np.mean([astuple(row) for row in rows], axis=0).tolist())


def _set_description(trial: Path) -> str:
    """Name and description of the set that a trial lies in, where it lies in one."""
    for folder in trial.resolve().parents[:2]:
        if (folder / "set.toml").is_file():
            root = load_toml(folder / "set.toml", "fabdesign.measurement-set/1")
            return f"{folder.name}: {root.text('description', '')}"
    return ""

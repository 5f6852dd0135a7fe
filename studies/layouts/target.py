"""Targets: the clouds that studies come close to, and how close a result came."""

import hashlib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.cloud_file import read_cloud
from fabdesign.design import Design
from fabdesign.errors import InputError
from fabdesign.metrics import DRAWS, Errors, trial_errors
from fabdesign.sensor_noise import SensorNoise, estimate_noise
from fabdesign.study_file import TargetFile
from fabdesign.table import load_toml
from fabdesign.trial_file import read_trial

FEWEST = 200  # points from which noise can be told from shape


@dataclass(frozen=True, eq=False)
class LoadedTarget:
    """A cloud and where it comes from. time: s after rest, of a trial's frame; None: a shape at equilibrium."""

    points: NDArray[np.float64]  # (n, 3) m
    time: float | None
    description: str

    @property
    def synthetic(self) -> bool:
        """Measured by a synthetic rig, as its description says."""
        return "synthetic" in self.description

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.points.tobytes()).hexdigest()


def load_target(target: TargetFile, design: Design, *, seed: int = 0) -> LoadedTarget:
    """Read a trial's frame (.npz), a cloud (.ply, .npz) or a mesh, sampled with `seed`. Raises InputError."""
    size = max(design.fabric.width, design.fabric.height)
    if not _is_trial(target.file):
        points = read_cloud(target.file, seed=seed, size=size)
        return LoadedTarget(points, None, target.description or target.file.name)
    trial = read_trial(target.file, size=size)
    count = len(trial.frames)
    if not -count <= target.frame < count:
        raise InputError(f"{target.file}: frame {target.frame}; expected -{count} to {count - 1}")
    time = float(trial.time[target.frame])
    where = f"frame {target.frame % count} of {target.file.stem}, {time:.3g} s after rest"
    description = ", ".join(filter(None, [target.description or where, _set_description(target.file)]))
    return LoadedTarget(trial.frames[target.frame], time, description)


def target_errors(
    targets: Sequence[LoadedTarget], shapes: NDArray[np.float64], design: Design, *, seed: int = 0, draws: int = DRAWS
) -> Errors:
    """Mean over the targets, of shapes (poses, 2 n, 3) m. The floors take the noise that the targets show."""
    clouds = [target.points for target in targets]
    enough = [cloud for cloud in clouds if len(cloud) >= FEWEST]
    noise = estimate_noise(enough, design.fabric.thickness) if enough else SensorNoise(0.0, 0.0, 0.0)
    return trial_errors(clouds, shapes, noise, seed=seed, draws=draws)


def _is_trial(path: Path) -> bool:
    if path.suffix.lower() != ".npz" or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return "offsets.npy" in archive.namelist()


def _set_description(trial: Path) -> str:
    """Name and description of the set that a trial lies in, where it lies in one."""
    for folder in trial.resolve().parents[:2]:
        if (folder / "set.toml").is_file():
            root = load_toml(folder / "set.toml", "fabdesign.measurement-set/1")
            return f"{folder.name}: {root.text('description', '')}"
    return ""

"""This module feeds back a measured run: how far the cloth was from where the model has it."""

from dataclasses import dataclass
from math import isqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fabdesign.errors import InputError
from fabdesign.files.measurement_set import read_set
from fabdesign.files.trial_file import TrialData, read_trial
from fabdesign.geometry.shape import Face, normals
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import require_pressures

SMOOTH = 0.05  # of the cloth's side, over which measured heights are averaged
APART = 0.5  # of a frame's interval: a wanted instant farther from all frames has no measured shape
FARTHEST = 0.02  # m: points farther off the model's cloth are none of it


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """A measured motion of the design, and the set points that were run."""

    file: Path
    data: TrialData


def read_run(path: Path, design: Design) -> MeasuredRun:
    """Return a trial's npz, or the last trial of a set on a design of this name. Raises InputError."""
    if path.suffix != ".npz":
        trials = [trial for trial in read_set(path).trials if trial.design_name == design.name]
        if not trials:
            raise InputError(f"{path}: no trial of design {design.name}; expected the motion that was run")
        path = max(trials, key=lambda trial: trial.order).file
    data = read_trial(path, size=max(design.fabric.width, design.fabric.height))
    require_pressures(data.program, design, str(path))
    return MeasuredRun(path, data)


def displacements(
    run: MeasuredRun, motion: Floats, times: Array, *, face: Face = "both"
) -> tuple[Array, NDArray[np.bool_]]:
    """Return (K, 2 n, 3) m, by how much the measured cloth lies beside the model's `motion` (K, 2 n, 3) m at `times`
    (K,) s, along its normals; and (K,) whether it was measured then. face: that the measured points lie on."""
    measured, apart = run.data.time, np.median(np.diff(run.data.time)) if len(run.data.time) > 1 else np.inf
    moved, seen = np.zeros(motion.shape), np.zeros(len(times), bool)
    for k, time in enumerate(times):
        frame = int(np.argmin(np.abs(measured - time)))
        if abs(measured[frame] - time) <= APART * apart + 1e-6:
            seen[k] = True
            moved[k] = _beside(run.data.frames[frame], np.asarray(motion[k], np.float64), face)
    return moved, seen


def _beside(cloud: Array, faces: Array, face: Face) -> Array:
    """Return displacements (2 n, 3) m along the normals of the front face."""
    side = isqrt(len(faces) // 2)
    count = side * side
    half = float(np.linalg.norm(faces[:count] - faces[count:], axis=1).mean()) / 2
    surface = Surface.of_faces(faces)
    place = surface.nearest(cloud)
    close = place.distance < FARTHEST
    corners = surface.triangles[place.triangle[close]]
    node = (corners % count)[np.arange(len(corners)), np.argmax(place.weights[close], axis=1)]
    over = np.where(corners[:, 0] >= count, -1.0, 1.0) * (half + place.signed[close])  # the middle, towards the front

    def mean(heights: Array) -> Array:
        sums, counts = (
            gaussian_filter(np.bincount(node, values, count).reshape(side, side), SMOOTH * side, mode="nearest")
            for values in (heights, np.ones(len(heights)))
        )
        return np.asarray(sums / np.maximum(counts, 1e-3 * counts.max()))

    # a cloth that lies farther off than its thickness is nearest to its other face: its own middle says which is which
    signs = {"front": 1.0, "back": -1.0}.get(face) or np.where(over > mean(over).ravel()[node], 1.0, -1.0)
    moved = mean(over - signs * half)[..., None] * normals(faces[:count].reshape(side, side, 3))
    return np.concatenate([moved.reshape(-1, 3)] * 2)

"""One specimen's motion: a design, its ground truth and a pressure program give the cloth's shape at every frame."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fabdesign.nouns import muscle_law
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.output import atomic_file
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import kept, user_cache
from studies.rig.effects import EFFECTS
from studies.rig.effects.listed import OF_CLOUDS
from studies.rig.ground_truth import GroundTruth
from studies.rig.motion import RigDiverged, run
from studies.rig.scene import DEFAULT, Resolution, Scene, build_scene

MECHANICS = ("spline", "shell", "cables", "scene", "motion", "specimen")  # what a motion depends on


@dataclass(frozen=True, eq=False)
class TrialTask:
    """One trial to run."""

    design: Design
    program: PressureProgram
    times: Array  # (T,) s, the frames
    order: int
    truth: GroundTruth
    resolution: Resolution = DEFAULT


def prepare(task: TrialTask) -> Scene:
    """Return the scene with the ground truth's factors and effects in it."""
    scene = build_scene(
        task.design,
        task.truth.parameters,
        task.resolution,
        max_pressure=float(task.program.pressure.max(initial=0.0)),
        seed=1000 * task.truth.seed + task.order,
    )
    for setting in task.truth.effects:
        effect = EFFECTS[setting.name]
        values = {name: default for name, (default, _) in effect.parameters.items()}
        effect.apply(scene, task.order, values | dict(setting.parameters))
    return scene


def control_points(task: TrialTask) -> Array:
    """Return (T, n, 3) control points [m] at the frames. From the cache where the same task has run before.

    Raises RigDiverged where even a quarter of the time step finds no solution.
    """
    return kept(user_cache("rig") / f"{digest_of(task)}.npy", lambda: computed_points(task), np.load, _write_points)


def _write_points(file: Path, points: Array) -> None:
    with atomic_file(file, needed=points.nbytes) as temporary, temporary.open("wb") as stream:
        np.save(stream, points)


def computed_points(task: TrialTask) -> Array:
    step = task.resolution.step
    for refinement in (1, 2, 4):
        scene = prepare(task)
        h = step / refinement
        end = float(task.times[-1]) + max(scene.time_shift, 0.0)
        steps = 1 + max(2, int(np.ceil(end / h - 1e-9)))
        edges = np.asarray((np.arange(steps + 2) - 1.5) * h, dtype=float)  # half a step from the instants
        pressures = task.program.means(edges)
        try:
            motion = run(scene, pressures, h, start=-h)
        except RigDiverged:
            if refinement == 4:
                raise
            continue
        return np.array([motion.at(max(t + scene.time_shift, 0.0)) for t in task.times])
    raise AssertionError  # the loop returns or raises


def digest_of(task: TrialTask) -> str:
    """Return the hash of everything that a motion depends on, the code of its mechanics included."""
    parts = [task.design, task.order, task.truth.seed, sorted(task.truth.parameters.items()), task.resolution]
    parts += [(e.name, sorted(e.parameters.items())) for e in task.truth.effects if e.name not in OF_CLOUDS]
    arrays = [np.asarray(array, np.float64) for array in (task.program.time, task.program.pressure, task.times)]
    here = Path(__file__).parent
    sources = [here / f"{name}.py" for name in MECHANICS] + sorted((here / "effects").glob("*.py"))
    return sha256(*map(repr, parts), *arrays, *sources, Path(str(muscle_law.__file__)))[:32]

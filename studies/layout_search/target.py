"""Targets: the clouds and wishes that studies come close to, and how close a result came."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fabdesign.clouds.target_file import PlacedTarget, read_target
from fabdesign.formats.codec import decode_key
from fabdesign.formats.table import load_toml
from fabdesign.geometry.metrics import DRAWS, CloudKind, Errors, landmark_errors, trial_errors
from fabdesign.geometry.placement import placement_of
from fabdesign.geometry.sensor_noise import NOISE_FREE, SensorNoise, estimate_noise
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.runtime.fingerprint import sha256
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.units import in_mm
from optimize.search.objective import MEASURES, Target

ENOUGH = 4000  # points for the same
NOISELESS = 1e-4  # m: bends that a quadric does not follow look like less noise than that


_NO_FILE = TargetFile(Path())


@dataclass(frozen=True, eq=False)
class LoadedTarget(Target):
    """A target and where it comes from. file: as a study names it."""

    file: TargetFile = _NO_FILE
    description: str = ""
    noise: SensorNoise = NOISE_FREE  # what the cloud shows; none on a mesh
    weight: float = 1.0  # among the poses of a study

    def beside(self, shape: Array) -> "LoadedTarget":
        """Return a free one where it lies nearest to a shape (2 n, 3) m, with how it was moved; any other as it is."""
        if not self.free:
            return self
        motion = self.motion(shape)
        placed = placement_of(1.0, Rotation.from_matrix(motion.turn.T), -motion.shift @ motion.turn)
        moved = f"{self.description}, moved by {placed} while searching"
        return replace(self, points=motion.back(self.points), description=moved, free=False)

    @property
    def measured(self) -> bool:
        """Return whether a sensor measured it, whose noise it shows."""
        return self.noise.sigma > 0

    @property
    def synthetic(self) -> bool:
        """Return whether a synthetic rig measured it, as its description says."""
        return "synthetic" in self.description

    @property
    def sha256(self) -> str:
        return sha256(self.points)


def load_target(target: TargetFile, design: Design, *, seed: int = 0) -> LoadedTarget:
    """Read a target, sampled with `seed` where it is a mesh, and place it. Raises InputError."""
    if target.wishes:
        return _wished(target, design)
    placed = read_target(target, design.fabric, seed=seed)
    frame, path = placed.geometry, target.file
    where = path.name
    if frame.trial:
        where = f"frame {frame.frame} of {path.stem}, {frame.time:.3g} s after rest"
    parts = [target.description or where, *_placed(target, placed)]
    if placed.markers:
        parts.append(f"{len(placed.points)} markers: their mean distance to the cloth, one way, in place of Chamfer")
    elif target.distances == "one way":
        parts.append("mean distance of its points to the cloth, one way, in place of Chamfer")
    if target.face != "both":
        parts.append(f"of the {target.face} face")
    if target.weighting is not None:
        parts.append(f"counts {target.weighting.in_words}")
    if frame.trial:
        parts.append(_set_description(path))
    return LoadedTarget(
        placed.points,
        frame.time,
        file=target,
        markers=placed.markers or target.distances == "one way",
        face=target.face,
        free=target.free,
        weighting=target.weighting,
        description=", ".join(filter(None, parts)),
        noise=_noise(placed, design.fabric.thickness),
        weight=target.weight,
    )


def target_errors(
    targets: Sequence[LoadedTarget], shapes: Array, design: Design, *, seed: int = 0, draws: int = DRAWS
) -> Errors:
    """Return the mean error over the targets by their weights, of shapes (poses, 2 n, 3) m. The floors take the noise
    that each target shows."""
    by_pose = pose_errors(targets, shapes, seed=seed, draws=-(-draws // len(targets)))
    weights = [target.weight for target in targets]
    return Errors(*np.average([astuple(errors) for errors in by_pose], axis=0, weights=weights).tolist())


def pose_errors(targets: Sequence[LoadedTarget], shapes: Array, *, seed: int = 0, draws: int = DRAWS) -> list[Errors]:
    """Return the errors of each target beside its shape. draws: of each floor."""
    return [
        _errors(target, shape, seed=seed + pose, draws=draws)
        for pose, (target, shape) in enumerate(zip(targets, shapes, strict=True))
    ]


def _errors(target: LoadedTarget, shape: Array, *, seed: int, draws: int) -> Errors:
    if target.landmarks is not None:
        return landmark_errors(target.landmarks, shape)
    target = target.beside(shape)
    kind = CloudKind(target.markers, target.face, target.weighting)
    return trial_errors([target.points], shape[None], target.noise, kind, seed=seed, draws=draws)


def _wished(target: TargetFile, design: Design) -> LoadedTarget:
    wishes = "; ".join(wish.words for wish in target.wishes)
    parts = [target.description, f"wishes ({wishes}), measured by the mean distance of these places"]
    landmarks, description = Landmarks.of(target.wishes, design.fabric), ", ".join(filter(None, parts))
    return LoadedTarget(
        landmarks.goals, landmarks=landmarks, file=target, description=description, weight=target.weight
    )


def _placed(target: TargetFile, placed: PlacedTarget) -> list[str]:
    """Return what was done to the file's points, for people."""
    parts = []
    if target.unit != "m" or target.scale != 1:
        parts.append(f"{target.unit} times {target.scale:g}" if target.scale != 1 else f"in {target.unit}")
    if len(placed.points) < len(placed.geometry.points) and not placed.geometry.is_mesh:
        parts.append(f"{len(placed.points)} of its {len(placed.geometry.points)} points")
    if target.place == "fit":
        parts.append(f"placed by fit with {placed.placement}")
        if placed.turned_over is not None:
            parts.append(f"as well as with rotation {placed.turned_over.turn}, front and back changed")
    elif target.rotation or any(target.translation):
        parts.append(f"placed with {placed.placement}")
    return parts


def _noise(placed: PlacedTarget, thickness: float) -> SensorNoise:
    """Return None on a mesh; a trial's is that of a cloth of this thickness [m], another cloud's also that of a single
    layer, if that is less. So little that no sensor is so good is none."""
    if placed.geometry.is_mesh or placed.markers:
        return NOISE_FREE
    some = placed.points[:: -(-len(placed.points) // ENOUGH)]
    layers = (thickness,) if placed.geometry.trial else (thickness, 0.0)
    least = min((estimate_noise([some], depth) for depth in layers), key=lambda noise: noise.sigma)
    return least if least.sigma > NOISELESS else NOISE_FREE


def _set_description(trial: Path) -> str:
    """Return the name and description of the set that a trial lies in, where it lies in one."""
    for folder in trial.resolve().parents[:2]:
        if (folder / "set.toml").is_file():
            root = load_toml(folder / "set.toml", "fabdesign.measurement-set/1")
            return f"{folder.name}: {decode_key(str, root, 'description', '')}"
    return ""


def is_wished(targets: Sequence[TargetFile]) -> bool:
    """Return whether all poses are wishes, so that there is no cloud and no noise."""
    return bool(targets) and all(target.wishes for target in targets)


def measure_of(study: Study) -> str:
    """Return the name of what a search makes small."""
    if is_wished(study.targets):
        return "distance from what was asked for"
    return MEASURES[study.objective].name


def errors_in_words(study: Study, errors: Errors) -> str:
    """Return the errors of a result in mm, beside its objective."""
    if is_wished(study.targets):
        return f"mean distance from what was asked for; root mean square {in_mm(errors.surface_rms):.3f}"
    return f"Chamfer {in_mm(errors.chamfer):.3f}, noise floor {in_mm(errors.chamfer_floor):.3f}"

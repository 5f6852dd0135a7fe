"""The targets of a motion, one at each of some instants: read from a study's files, and how far a motion is off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isqrt
from pathlib import Path
from typing import TypeVar

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.motion_file import read_motion
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.npz_file import open_npz
from fabdesign.geometry.hung_cloth import require_on_cloth
from fabdesign.geometry.metrics import landmark_errors, surface_rms
from fabdesign.geometry.sensor_noise import NOISE_FREE, estimate_noise
from fabdesign.geometry.shape import Shape, at_places, bilinear
from fabdesign.geometry.surface import Surface
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.array import Array, Floats, Indices
from fabdesign.nouns.design import Design
from fabdesign.runtime.effort import LONGEST
from fabdesign.study_files.follow_file import FollowStudy, MovingTarget
from fabdesign.study_files.study_targets import TargetFile
from optimize.fit.clouds import Match, Nodes, nodes_of
from optimize.fit.misfit import deviation_by_median
from studies.layout_search.target import LoadedTarget, load_target

POINTS = 300  # of a cloud that are compared while searching: more say nothing new
SCALE = 2e-4  # m, of what distances are worth where a target shows no noise
WISHED = 1e-3  # m, the same of wishes, which nobody means so exactly
EACH = 100.0  # independent points that an instant counts as, whatever its cloud has
GUIDES, GUIDED = 5, 0.1  # places a side of a shape between poses; its weight, where a pose has 1
HUBER, FARTHEST = 1.345, 0.020  # of the scale; m, a distance that counts less beyond


Items = TypeVar("Items", Array, list[Array])


def thinned(items: Items, count: int) -> Items:
    """Return at most so many, at even steps."""
    return items[:: -(-len(items) // count)]


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances (N,) m of one instant, and how each changes with four nodes of the mid-surface."""

    off: Array  # (N,) m
    nodes: Nodes
    weight: Array  # (N,) 1/m^2
    scale: float  # m
    noise: float  # m, of the target's points

    @cached_property
    def robust(self) -> Array:
        """Return (N,) 1/m^2: the weights where outlying distances count less (Huber 1981)."""
        scale = max(deviation_by_median(self.off), self.scale)
        return self.weight / np.maximum(1.0, np.abs(self.off) / (HUBER * scale))

    @property
    def of_noise(self) -> float:
        """Return the cost that noise alone has."""
        return float(self.weight.sum()) * self.noise**2

    @property
    def cost(self) -> float:
        """Return the sum of weighted squares, beyond FARTHEST of Huber's lines."""
        size = np.abs(self.off)
        return float(self.weight @ np.where(size < FARTHEST, size**2, FARTHEST * (2 * size - FARTHEST)))


@dataclass(frozen=True, eq=False)
class Wanted:
    """A target at each instant. times (K,) s after rest, rising, above 0. poses: shapes at a few instants, between
    which the cloth is to move smoothly."""

    times: Array
    targets: tuple[LoadedTarget, ...]
    poses: bool = False

    def guided(self, times: Array, shapes: Floats) -> "Wanted":
        """Return the same with shapes (T, 2 n, 3) m at other `times` (T,) s, which count little: the way between
        poses."""
        u, v = (share.ravel() for share in np.meshgrid(*[np.linspace(0, 1, GUIDES)] * 2))
        shares = np.stack([u, v], axis=1)
        every = dict(zip(self.times.tolist(), self.targets, strict=True))
        for time, shape in zip(times.tolist(), shapes, strict=True):
            goals = at_places(Shape.of(shape.astype(float)).middle, shares)
            marks = Landmarks(shares, goals, np.ones(goals.shape, bool), np.full(len(goals), 1 / len(goals)))
            every[time] = LoadedTarget(goals, landmarks=marks, weight=GUIDED)
        return Wanted(np.array(sorted(every)), tuple(every[time] for time in sorted(every)), self.poses)

    def distances(self, moment: int, points: Floats, side: int) -> Distances | None:
        """Return the distances of instant number `moment` to a shape (2 n, 3) m. side: nodes of the mid-surface, a
        side, by which they change. None for a shape that diverged."""
        if not np.isfinite(points).all():
            return None
        target = self.targets[moment]
        if target.landmarks is not None:
            return _of_wishes(target, points, side)
        return _of_cloud(target, self._thinned[moment], points, side)

    def thinned(self, count: int) -> "Wanted":
        """Return the same with about so many points of each cloud."""
        clouds = [one if one.landmarks else replace(one, points=thinned(one.points, count)) for one in self.targets]
        return replace(self, targets=tuple(clouds))

    def errors(self, times: Array, motion: Floats) -> Array:
        """Return (T,) m of a motion's frames (T, 2 n, 3) m: surface RMS at wanted instants, NaN at other times."""
        errors = np.full(len(times), np.nan)
        for time, target in zip(self.times, self.targets, strict=True):
            frame = int(np.argmin(np.abs(times - time)))
            shape = motion[frame].astype(np.float64)
            if target.landmarks is not None:
                errors[frame] = landmark_errors(target.landmarks, shape).surface_rms
            else:
                errors[frame] = surface_rms(target.points, shape, target.face, target.weighting)
        return errors

    def mean_distance(self, motion: Floats) -> float:
        """Return the mean over instants [m] of the RMS distance to a motion (K, 2 n, 3) m."""
        side = isqrt(motion.shape[1] // 2)
        each = [self.distances(k, points, side) for k, points in enumerate(motion)]
        return float(np.mean([np.inf if one is None else np.sqrt(np.square(one.off).mean()) for one in each]))

    @property
    def noise(self) -> float:
        """Return the mean over instants [m] of the noise."""
        return float(np.mean([0.0 if target.landmarks is not None else target.noise.sigma for target in self.targets]))

    @cached_property
    def _thinned(self) -> list[Array]:
        return [thinned(target.points, POINTS) for target in self.targets]

    def until(self, begin: float, end: float) -> Indices:
        """Return the numbers of the instants after `begin` and up to `end` s."""
        return np.flatnonzero((self.times > begin + 1e-9) & (self.times <= end + 1e-9))


def _of_cloud(target: LoadedTarget, points: Array, shape: Floats, side: int) -> Distances:
    surface = Surface.of_faces(shape, face=target.face)
    place = surface.nearest(points)
    corners, normal = surface.triangles[place.triangle], surface.normals_of(place.triangle)
    offset = points - np.einsum("nc,ncd->nd", place.weights, surface.vertices[corners])
    off = np.einsum("nd,nd->n", offset, normal)
    none = np.zeros(len(off), np.intp)
    matched = Match(off, none, none, none, normal, corners, place.weights)
    nodes = nodes_of(matched, side, isqrt(len(shape) // 2))
    counts = np.ones(len(off))
    if target.weighting is not None:
        counts = np.einsum("nc,nc->n", place.weights, target.weighting.of_points(len(shape))[corners])
    scale = max(target.noise.sigma, SCALE)
    return Distances(off, nodes, EACH * target.weight * counts / counts.sum() / scale**2, scale, target.noise.sigma)


def _of_wishes(target: LoadedTarget, shape: Floats, side: int) -> Distances:
    landmarks = target.landmarks
    assert landmarks is not None
    node, shares = bilinear((side - 1) * landmarks.shares, side, side)
    place, axis = np.nonzero(landmarks.given)
    off = (at_places(Shape.of(shape).middle, landmarks.shares) - landmarks.goals)[place, axis]
    weighted = shares[place][:, :, None] * np.eye(3)[axis][:, None]
    weight = EACH * target.weight * landmarks.weights[place] / WISHED**2
    return Distances(off, Nodes(node[place], weighted), weight, WISHED, 0.0)


def moved(distances: Distances, changes: Sequence[Floats] | Floats) -> Array:
    """Return (N, k) m: how the distances change. changes: (k, n, n, 3) m of the mid-surface."""
    flat = np.asarray(changes, np.float64).reshape(len(changes), -1, 3)
    return np.einsum("ncd,kncd->nk", distances.nodes.weighted, flat[:, distances.nodes.node], optimize=True)


KEPT = 2000  # of a frame that are kept: an error of so many is as good
NOISE_FRAMES = 5  # by which a trial's noise is estimated
LEAST = 2  # instants


def wanted_of(study: FollowStudy) -> Wanted:
    """Return the study's targets and their times; those at 0 s, where the cloth still hangs, are left out. Raises
    InputError for what cannot be read, and for fewer than LEAST instants of a motion."""
    if isinstance(study.target, tuple):
        targets = tuple(load_target(moment.target, study.design, seed=study.seed) for moment in study.target)
        for moment in study.target:
            if moment.target.free:
                where = f"{moment.target.file}: free at {moment.time:g} s"
                raise InputError(f"{where}; expected a place that is given, or fit")
        return Wanted(np.array([moment.time for moment in study.target]), targets, poses=True)
    wanted = _of_motion(study.target, study.design, study.seed)
    if len(wanted.times) < LEAST:
        raise InputError(f"{study.target.file}: {len(wanted.times)} instants after 0 s; expected {LEAST} or more")
    return wanted


def _of_motion(target: MovingTarget, design: Design, seed: int) -> Wanted:
    if target.file.is_dir():
        return _of_folder(target, design, seed)
    with open_npz(target.file, "a trial's or a motion's arrays") as arrays:
        is_trial = "offsets" in arrays
    if is_trial:
        trial = read_trial(target.file, size=max(design.fabric.width, design.fabric.height))
        times, frames = trial.time, trial.frames
    else:
        motion = read_motion(target.file)
        if motion.triangles is None:
            raise InputError(f"{target.file}: a motion without triangles; expected one of a cloth's two faces")
        rng = np.random.default_rng(seed)
        surfaces = [Surface(points.astype(np.float64), motion.triangles) for points in motion.points]
        times, frames = motion.time, tuple(surface.sample(KEPT, rng)[0] for surface in surfaces)
    require_on_cloth(frames, times, design.fabric, str(target.file))
    clouds = [thinned(frame, KEPT) for frame in frames]
    noise = estimate_noise(thinned(clouds, NOISE_FRAMES), design.fabric.thickness) if is_trial else NOISE_FREE
    targets = [
        LoadedTarget(cloud, description=target.file.name, noise=noise, face=target.face, weighting=target.weighting)
        for cloud in clouds
    ]
    return _until(times, targets, target)


def _of_folder(target: MovingTarget, design: Design, seed: int) -> Wanted:
    files = sorted(path for path in target.file.iterdir() if path.is_file() and not path.name.startswith("."))
    if not files:
        raise InputError(f"{target.file}: an empty folder; expected a cloud or mesh for each instant")
    times = np.arange(len(files)) / target.frame_rate
    targets = []
    for path in files:
        one = TargetFile(path, unit=target.unit, face=target.face, weighting=target.weighting)
        targets.append(replace(load_target(one, design, seed=seed), time=None))
    return _until(times, targets, target)


def _until(times: Array, targets: list[LoadedTarget], target: MovingTarget) -> Wanted:
    end = LONGEST if target.until is None else target.until
    kept = np.flatnonzero((times > 1e-9) & (times <= end + 1e-9))
    return Wanted(np.asarray(times[kept], np.float64), tuple(targets[int(k)] for k in kept))


def files_of(study: FollowStudy) -> list[Path]:
    """Return the files that the target is read from."""
    if isinstance(study.target, tuple):
        return [moment.target.file for moment in study.target]
    return [study.target.file]

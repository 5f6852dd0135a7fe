"""This module reads from a study's files what is wanted when."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.files.motion_file import read_motion
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.npz_file import open_npz
from fabdesign.geometry.hung_cloth import require_on_cloth
from fabdesign.geometry.sensor_noise import NOISE_FREE, SensorNoise, estimate_noise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.design import Design
from fabdesign.runtime.effort import LONGEST
from fabdesign.study_files.follow_file import FollowStudy, Moment, MovingTarget
from fabdesign.study_files.study_targets import TargetFile
from studies.follow.wanted import Wanted
from studies.layout_search.target import LoadedTarget, load_target

Array = NDArray[np.float64]
POINTS = 2000  # of a frame that are kept: an error of so many is as good
NOISE_FRAMES = 5  # by which a trial's noise is estimated
LEAST = 2  # instants


def wanted_of(study: FollowStudy) -> Wanted:
    """Return the study's targets and their times; those at 0 s, where the cloth still hangs, are left out. Raises
    InputError for what cannot be read, and for fewer than LEAST instants of a motion."""
    if isinstance(study.target, tuple):
        return _of_moments(study.target, study)
    wanted = _of_motion(study.target, study.design, study.seed)
    if len(wanted.times) < LEAST:
        raise InputError(f"{study.target.file}: {len(wanted.times)} instants after 0 s; expected {LEAST} or more")
    return wanted


def _of_moments(moments: tuple[Moment, ...], study: FollowStudy) -> Wanted:
    targets = [load_target(moment.target, study.design, seed=study.seed) for moment in moments]
    for moment in moments:
        if moment.target.free:
            raise InputError(f"{moment.target.file}: free at {moment.time:g} s; expected a place that is given, or fit")
    return Wanted(np.array([moment.time for moment in moments]), tuple(targets), poses=True)


def _of_motion(target: MovingTarget, design: Design, seed: int) -> Wanted:
    if target.file.is_dir():
        return _of_folder(target, design, seed)
    with open_npz(target.file, "a trial's or a motion's arrays") as arrays:
        is_trial = "offsets" in arrays
    if is_trial:
        trial = read_trial(target.file, size=max(design.fabric.width, design.fabric.height))
        require_on_cloth(trial.frames, trial.time, design.fabric, str(target.file))
        some = trial.frames[:: -(-len(trial.frames) // NOISE_FRAMES)]
        noise = estimate_noise([_few(frame) for frame in some], design.fabric.thickness)
        return _wanted(trial.time, trial.frames, target, noise)
    motion = read_motion(target.file)
    if motion.triangles is None:
        raise InputError(f"{target.file}: a motion without triangles; expected one of a cloth's two faces")
    rng = np.random.default_rng(seed)
    surfaces = [Surface(points.astype(np.float64), motion.triangles) for points in motion.points]
    frames = [surface.sample(POINTS, rng)[0] for surface in surfaces]
    require_on_cloth(frames, motion.time, design.fabric, str(target.file))
    return _wanted(motion.time, frames, target, NOISE_FREE)


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


def _wanted(times: Array, frames: list[Array] | tuple[Array, ...], target: MovingTarget, noise: SensorNoise) -> Wanted:
    targets = [
        LoadedTarget(
            _few(frame), description=target.file.name, noise=noise, face=target.face, weighting=target.weighting
        )
        for frame in frames
    ]
    return _until(times, targets, target)


def _until(times: Array, targets: list[LoadedTarget], target: MovingTarget) -> Wanted:
    end = LONGEST if target.until is None else target.until
    kept = np.flatnonzero((times > 1e-9) & (times <= end + 1e-9))
    return Wanted(np.asarray(times[kept], np.float64), tuple(targets[int(k)] for k in kept))


def _few(points: Array) -> Array:
    return points[:: -(-len(points) // POINTS)]


def files_of(study: FollowStudy) -> list[Path]:
    """Return the files that the target is read from."""
    if isinstance(study.target, tuple):
        return [moment.target.file for moment in study.target]
    return [study.target.file]

"""The data that a fit takes of measurement sets: trials, points of their frames, the sensor's noise, folds,
provenance."""

import importlib.metadata
import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.geometry.sensor_noise import SensorNoise, estimate_noise
from fabdesign.nouns.model import Provenance
from fabdesign.nouns.trial import Accuracy, MeasurementSet, Trial
from fabdesign.runtime.fingerprint import sha256
from fabdesign.version import SIMULATOR, __version__
from optimize.fit.clouds import Density, Sample, drawn, evenly
from studies.measured.splits import program_of
from studies.measured.used_frames import NONE_USED, UsedFrames

STROKE = 100e3  # Pa by which a channel's pressure rises in one stroke
_RATE = 0.01  # s, at which pressures are looked at for what a specimen has behind it
NOISE_FRAMES = 40  # clouds that the sensor's noise is estimated from: strays are few


class TooLittle(InputError):
    """Too few trials or frames to fit."""


@dataclass(frozen=True, eq=False)
class MeasuredData:
    """Data of a fit. trials: those that a fit looks at, of the sets, each with frames that are used. samples: one a
    trial. noise: of the sensor. accuracy: of the inputs, the worst of the sets."""

    sets: tuple[MeasurementSet, ...]
    trials: tuple[Trial, ...]
    samples: tuple[Sample, ...]
    noise: SensorNoise
    used: UsedFrames
    accuracy: Accuracy
    seed: int

    @staticmethod
    def of(
        sets: Sequence[MeasurementSet], trials: Sequence[Trial], used: UsedFrames, density: Density, *, seed: int
    ) -> "MeasuredData":
        """Return the data drawn by `seed`. Raises TooLittle where no trial has a frame that is used."""
        rng = np.random.default_rng(seed)
        samples: list[Sample] = []
        for trial in trials:
            data = trial.load()
            until = max(int(np.searchsorted(data.time, density.until + 1e-6)), 1)
            usable = np.flatnonzero(used.at(_owner(sets, trial), trial)[:until])
            if len(usable):
                frames = usable[evenly(len(usable), density.frames)]
                samples.append(drawn(trial, data, frames, density.points, rng))
        if not samples:
            raise TooLittle(f"{', '.join(trial.name for trial in trials)}: {NONE_USED}")
        alike = [t for t in trials if t.design.fabric.thickness == trials[0].design.fabric.thickness]
        return MeasuredData(
            sets=tuple(sets),
            trials=tuple(sample.trial for sample in samples),
            samples=tuple(samples),
            noise=noise_of(alike),
            used=used,
            accuracy=Accuracy.worst([measured.accuracy for measured in sets]),
            seed=seed,
        )

    @property
    def weighed(self) -> Accuracy | None:
        """Return what a fit weighs errors of the inputs by; None where these are exact."""
        return self.accuracy if self.accuracy.pressure or self.accuracy.tilt else None

    def only(self, kept: Sequence[int]) -> "MeasuredData":
        """Return some trials, by their places."""
        return replace(self, trials=tuple(self.trials[k] for k in kept), samples=tuple(self.samples[k] for k in kept))

    def spread(self, most: int) -> "MeasuredData":
        """Return up to `most` trials of the data, spread over all."""
        return self.only(evenly(len(self.trials), most).tolist())

    def used_of(self, trial: Trial) -> NDArray[np.bool_]:
        """Return (T,) which frames of a trial are used."""
        return self.used.at(_owner(self.sets, trial), trial)

    @cached_property
    def folds(self) -> tuple[int, ...]:
        """Return the fold of each trial: those with the same pressures are one fold."""
        return program_of(self.trials)

    @cached_property
    def session(self) -> NDArray[np.float64]:
        """Return (samples, 3): place in the session, and what the specimen has behind it then, Pa s of all channels and
        strokes."""
        behind: dict[Path, NDArray[np.float64]] = {}
        for measured in self.sets:
            behind |= use_before(measured.trials)
        rows = [[s.trial.order, *behind.get(s.trial.file, np.zeros(2))] for s in self.samples]
        return np.array(rows, dtype=float)

    def provenance(self) -> Provenance:
        """Return what was fitted, where every other trial counts as held out. Hashes are of the files fitted, before
        anything else."""
        named = [(measured.name, trial) for measured in self.sets for trial in measured.trials]
        files = {trial.file for trial in self.trials}
        return Provenance(
            sets=tuple(measured.name for measured in self.sets),
            fitted=tuple(f"{name}/{trial.name}" for name, trial in named if trial.file in files),
            held_out=tuple(f"{name}/{trial.name}" for name, trial in named if trial.file not in files),
            versions={"python": platform.python_version(), "fabdesign": __version__, "simulator": SIMULATOR}
            | {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "taichi")},
            hashes={f"{name}/{trial.file.name}": sha256(trial.file) for name, trial in named if trial.file in files},
            seed=self.seed,
        )


def _owner(sets: Sequence[MeasurementSet], trial: Trial) -> MeasurementSet:
    return next(one for one in sets if any(other.file == trial.file for other in one.trials))


def use_before(trials: Sequence[Trial]) -> dict[Path, NDArray[np.float64]]:
    """Return what a session's specimen has behind it when each trial begins, (2,): Pa s of all channels, and strokes
    of STROKE; by the trial's file."""
    behind, so_far = {}, np.zeros(2)
    for trial in sorted(trials, key=lambda trial: trial.order):
        behind[trial.file] = so_far
        pressure = trial.program.at(np.arange(0.0, trial.times[-1] + _RATE, _RATE))
        strokes = np.maximum(np.diff(pressure, axis=0, prepend=0.0), 0.0).sum() / STROKE
        so_far = so_far + [_RATE * pressure.sum(), strokes]
    return behind


def noise_of(trials: Sequence[Trial]) -> SensorNoise:
    """Return the noise of the sensor that saw cloths of one thickness, from frames spread over the trials, the first of
    each among them: the cloth is flattest there."""
    return estimate_noise(noise_clouds(trials), trials[0].design.fabric.thickness)


def noise_clouds(trials: Sequence[Trial]) -> list[NDArray[np.float64]]:
    """Return clouds (n_t, 3) m that the noise is estimated from."""
    chosen = [trials[i] for i in np.linspace(0, len(trials) - 1, min(len(trials), NOISE_FRAMES)).astype(int)]
    each = -(-NOISE_FRAMES // len(chosen))
    clouds = []
    for trial in chosen:
        frames = trial.load().frames
        clouds += [frames[i] for i in np.linspace(0, len(frames) - 1, min(each, len(frames))).astype(int)]
    return clouds

"""What a trace looks at: used frames of the trials, some points of each, and the noise in them."""

from collections.abc import Sequence

import numpy as np

from fabdesign.errors import InputError
from fabdesign.sensor_noise import SensorNoise, estimate_noise
from fabdesign.splits import by_program
from fabdesign.trial import Trial
from optimize.fit.clouds import Sample, evenly
from studies.used_frames import Stretch, used_mask

TRIALS = 16  # at most, spread over those allowed
FRAMES = 25  # of a trial
POINTS = 150  # of a frame
UNTIL = 6.0  # s of a trial
_NOISE_FRAMES = 16


class TooLittle(InputError):
    """Too few trials or frames to trace."""


def draw(trials: Sequence[Trial], stretches: Sequence[Stretch], *, seed: int) -> tuple[list[Sample], SensorNoise]:
    """Used frames spread over each trial, and random points of them; the sensor's noise. A trial without a used
    frame is left out. Raises TooLittle where none is left."""
    rng = np.random.default_rng(seed)
    samples: list[Sample] = []
    clouds: list[np.ndarray] = []
    for trial in trials:
        data = trial.load()
        usable = np.flatnonzero(used_mask(stretches, trial.name, data.time) & (data.time <= UNTIL))
        clouds += [data.frames[int(k)] for k in usable[evenly(len(usable), 3)]] if len(usable) else []
        if len(usable) == 0:
            continue
        chosen = usable[evenly(len(usable), FRAMES)]
        frames = (data.frames[int(k)] for k in chosen)
        drawn = tuple(c if len(c) <= POINTS else c[rng.choice(len(c), POINTS, replace=False)] for c in frames)
        samples.append(Sample(trial, data.time[chosen], drawn))
    if not samples:
        raise TooLittle("no frame to use in any trial: all of them are sensitive")
    clouds = [clouds[k] for k in evenly(len(clouds), _NOISE_FRAMES)]
    return samples, estimate_noise(clouds, trials[0].design.fabric.thickness)


def folds_of(samples: Sequence[Sample]) -> list[int]:
    """Of each sample: trials with the same pressures are one fold."""
    trials = [sample.trial for sample in samples]
    fold = {id(trial): k for k, group in enumerate(by_program(trials)) for trial in group}
    return [fold[id(trial)] for trial in trials]

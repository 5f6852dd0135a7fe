"""The model that a corrector stands on, fitted in the same command to the trials that are learned from."""

from collections.abc import Sequence
from dataclasses import replace

from fabdesign.forward import ForwardModel
from fabdesign.model import Model
from fabdesign.model_file import read_model, write_model
from fabdesign.output import WorkFolder, whole_file
from fabdesign.trial import MeasurementSet
from optimize.fit.parameters import FitVector
from studies.calibration.calibrate import calibrate
from studies.training.data import Chosen, Progress

_FILE = "base.toml"


def fitted_base(
    sets: Sequence[MeasurementSet],
    learned: Sequence[Chosen],
    vector: FitVector,
    forward: ForwardModel,
    work: WorkFolder,
    *,
    slopes: ForwardModel | None,
    points_per_side: int,
    seed: int,
    progress: Progress,
) -> Model:
    """As `calibrate` fits it, but to none of the trials that are held out; kept in the work folder once it is there."""
    file = work.folder / _FILE
    work.claim(_FILE)
    if not file.is_file():
        taking_part = {chosen.trial.file for chosen in learned}
        own = [replace(one, trials=tuple(t for t in one.trials if t.file in taking_part)) for one in sets]
        calibration = calibrate(
            [one for one in own if one.trials],
            forward,
            slopes=slopes,
            vector=vector,
            points_per_side=points_per_side,
            seed=seed,
            progress=lambda line, share: progress(f"base: {line}", round(100 * share), 100),
        )
        with whole_file(file) as unfinished:
            write_model(calibration.model, unfinished)
    return read_model(file)

"""Surface errors of used frames, before and after: of the trials fitted, and once of those of role test."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.geometry.metrics import Errors, statistics, trial_errors
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.trial import Trial
from optimize.fit.clouds import evenly
from optimize.fit.fitted import Fit
from optimize.fit.misfit import Indices
from studies.measured.fit_data import MeasuredData

FRAMES = 20  # of a trial


@dataclass(frozen=True)
class TrialError:
    """The errors of one trial's used frames, m."""

    trial: str
    design: str
    role: str
    before: Errors
    after: Errors


def errors_of_trials(
    data: MeasuredData, trials: Sequence[Trial], forward: ForwardModel, before: Fit, after: Fit
) -> list[TrialError]:
    """Return the errors of every trial that has a used frame."""
    times: list[Indices] = []
    chosen: list[Trial] = []
    for trial in trials:
        usable = np.flatnonzero(data.used.at(data.sets[0], trial))
        if len(usable):
            chosen.append(trial)
            times.append(usable[evenly(len(usable), FRAMES)])
    whens = [t.times[frames] for t, frames in zip(chosen, times, strict=True)]
    motions = forward.motions([fit.vector.case(t, fit.x) for fit in (before, after) for t in chosen], [*whens, *whens])
    errors = []
    for k, (trial, frames) in enumerate(zip(chosen, times, strict=True)):
        all_frames = trial.load().frames
        clouds = [all_frames[int(f)] for f in frames]
        pair = [trial_errors(clouds, m, data.noise, seed=trial.order) for m in (motions[k], motions[len(chosen) + k])]
        errors.append(TrialError(trial.name, trial.design.name, trial.role, pair[0], pair[1]))
    return errors


def mean_of(errors: Sequence[TrialError], role: str, which: str, error: str = "surface_rms") -> float | None:
    """Return the mean over trials of a role, m; None where there is none."""
    pairs = [getattr(e, which) for e in errors if e.role == role]
    finite = [e for e in pairs if np.isfinite(e.surface_rms)]
    return statistics(finite)[error].mean if finite else None


def other_layouts(errors: Sequence[TrialError]) -> dict[str, list[TrialError]]:
    """Return the errors by design, of the designs of which no trial was fitted."""
    fitted = {e.design for e in errors if e.role == "fit"}
    names = dict.fromkeys(e.design for e in errors if e.design not in fitted)
    return {name: [e for e in errors if e.design == name] for name in names}

"""Cross-validation by design, each of a measured set left out in turn: calibrated on the others, evaluated on it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.output import whole_file
from fabdesign.study_files.unseen_file import UnseenStudy
from fabdesign.units import in_mm
from optimize.fit.clouds import evenly
from optimize.fit.descent import Progress, parts
from optimize.fit.free_parameters import fit_vector
from studies.calibration import CalibrationOptions, calibrate_sets
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.evaluation_report import SetEvaluation
from studies.prediction.forward_model import forward_model

_FIT = 0.8  # of the work, beside the evaluation


def left_out(
    study: UnseenStudy, name: str, forward: ForwardModel, coarse: ForwardModel, picture: Path, *, progress: Progress
) -> dict[str, Any]:
    """Return errors of the data sheet and of what the other designs' trials of role `fit` gave, on at most
    `study.trials` trials of the design `name`; an overlay of one of them goes to `picture` (PNG). With effects fitted
    besides (`study.free`) the errors without them, of factors fitted alone, are said too. coarse: as `calibrate_sets`
    and `evaluate_sets` take it; sensitive stretches are neither fitted nor evaluated. What `evaluate` says of a design
    and of these stretches, the model's factors and effects, and how many trials were fitted. Raises InputError where
    nothing is left to fit or to evaluate."""
    measured = study.measured
    assert measured is not None
    others = tuple(trial for trial in measured.trials if trial.design_name != name and trial.role == "fit")
    of_design = [trial for trial in measured.trials if trial.design_name == name]
    if not others or not of_design:
        raise InputError(f"{measured.name}: without {name}, no trial is left to {'evaluate' if others else 'fit'}")
    tests = tuple(replace(of_design[i], role="test") for i in evenly(len(of_design), study.trials))
    fitting, judging = parts(progress, _FIT)
    calibration = calibrate_sets(
        replace(measured, trials=others),
        forward,
        vector=fit_vector(study.free, designs=[trial.design for trial in others]),
        progress=lambda line, share: fitting(f"without {name}: {line}", share),
        options=CalibrationOptions(coarse=coarse, points_per_side=study.points_per_side, seed=study.seed),
    )
    model = replace(calibration.model, without_effects={})  # before is the data sheet

    def evaluated(model: Model, what: str) -> SetEvaluation:
        return evaluate_sets(
            forward_model(forward, model),
            [replace(measured, trials=tests)],
            coarse=coarse,
            seed=study.seed,
            progress=lambda done, total: judging(
                f"without {name}{what}: evaluated {done} of {total} trials", done / total
            ),
        )

    evaluation = evaluated(model, "")
    _overlay(*_shown(tests, measured, evaluation), model, forward, picture)
    said = evaluation.as_json()["designs"][name] | evaluation.used.as_json()
    if model.effects:
        said["without_effects"] = evaluated(calibration.model.before, ", factors alone").as_json()["designs"][name][
            "after"
        ]
    content = calibration.as_json()
    return said | {
        "factors": {k: {key: p[key] for key in ("factor", "interval90")} for k, p in content["parameters"].items()},
        "effects": content["effects"],
        "fitted": len(calibration.model.provenance.fitted),
        "fit_unjudged": content["unjudged"],
        "doubts": content["doubts"],
    }


def _shown(trials: Sequence[Trial], measured: MeasurementSet, evaluation: SetEvaluation) -> tuple[Trial, int]:
    """Return the trial in the middle of those with a used frame, and of its used frames the one that moved farthest."""
    used = [(trial, np.flatnonzero(evaluation.used.at(measured, trial))) for trial in trials]
    sound = [(trial, kept) for trial, kept in used if len(kept)]
    trial, kept = sound[len(sound) // 2]
    clouds = trial.load().frames
    return trial, int(max(kept, key=lambda k: np.abs(clouds[k][:, 2]).mean()))


def _overlay(trial: Trial, k: int, model: Model, forward: ForwardModel, path: Path) -> None:
    """The cloud of frame k over the models before and after, from the side and from the front."""
    from matplotlib.figure import Figure

    clouds = trial.load().frames
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    for column, (said, shown) in enumerate((("before", model.before), ("after", model))):
        predictor = forward_model(forward, shown, sensing=True)
        motion = predictor.motions([Case(trial.design, trial.program, order=trial.order)], [trial.times])[0]
        for view, (axis, label) in enumerate(((2, "z"), (0, "x"))):
            panel = axes[2 * column + view]
            panel.plot(in_mm(motion[k][:, axis]), in_mm(motion[k][:, 1]), ".", color="#92c5de", markersize=2)
            panel.plot(in_mm(clouds[k][::2, axis]), in_mm(clouds[k][::2, 1]), ".", color="#1c2430", markersize=1)
            panel.set(title=f"{said}, {'side' if axis == 2 else 'front'}", xlabel=f"{label}, mm", aspect="equal")
    axes[0].set_ylabel("y, mm")
    figure.suptitle(f"{trial.design_name} {trial.name}, {trial.times[k]:.2f} s: measured (dark) over model (light)")
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, dpi=90, format="png")

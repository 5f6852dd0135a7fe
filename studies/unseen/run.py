"""A study of what is not measured yet, from its file to its report; and cross-validation by design, each of a
measured set left out in turn: calibrated on the others, evaluated on it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.json_file import of_exact, plain
from fabdesign.formats.toml_file import file_stem
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import spread_of
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.output import WorkFolder, atomic_file
from fabdesign.runtime.effort import CALIBRATION, fit_seconds, in_words, on_cores, unseen_seconds
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import Checkpoint
from fabdesign.study_files.unseen_file import FREE, UnseenStudy
from fabdesign.units import in_mm
from optimize.fit.clouds import evenly
from optimize.fit.descent import Progress, parts
from optimize.fit.free_parameters import fit_vector
from studies.calibration import CalibrationOptions, calibrate_sets
from studies.measured.used_frames import GRID
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.evaluation_report import SetEvaluation
from studies.prediction.forward_model import forward_model, sensed_model
from studies.prediction.stability import to_either_side
from studies.study import Simulated, StudyRun, kept_content, simulator
from studies.unseen import prediction
from studies.unseen.report import write_report
from studies.unseen.result import Measurement, PoseResult, UnseenResult, UnsewnResult

_UNSEWN = 0.5  # of the work, that predictions of a layout that is not sewn take beside measured designs
_DERIVATIVES = 0.3  # of it, after which measurements are compared
ALGORITHM = 17  # of what a study's folder keeps: raised where it is no longer what this code would compute


def run_unseen(
    study: UnseenStudy | Path | str,
    out: Path | str,
    *,
    progress: Callable[[str, float | None], None] = lambda line, share: None,
    **how: Unpack[Simulated],
) -> UnseenResult:
    """Evaluate what the study names and write `result.json` and `report.html` into `out`. Return what result.json
    holds. The same study goes on in its folder, piece by piece.

    coarse: finds the sensitive stretches of the measured set (studies.measured.used_frames).
    Raises InputError, and SimulationError where shapes cannot be computed.
    """
    run = StudyRun.of(study, UnseenStudy.read, how)
    study, forward, coarse = run.study, how.get("forward"), how.get("coarse")
    inputs = sorted({trial.file.parent.parent for trial in study.measured.trials}) if study.measured else []
    fit_vector(study.free, where=FREE)  # before anything is computed: it raises
    with run.folder(out, "unseen", inputs) as work:
        checkpoint = Checkpoint(work, _content(study), seconds=study.seconds)
        progress(unseen_in_words(study), None)
        if forward is None:
            forward, coarse = simulator(study.points_per_side, study), coarse or simulator(GRID)
        before = parts(progress, _UNSEWN)[0] if study.measured is not None else progress
        unsewn = unsewn_result(study, forward, checkpoint, before)
        free, designs = None, None
        if study.measured is not None:
            free, designs = study.free, _left_out(study, work, forward, coarse or forward, checkpoint, progress)
        about = study.name, study.seed, study.points_per_side
        result = UnseenResult(*about, unsewn, free, designs, checkpoint.spent)
        with work.adding() as files:
            write_report(result, files, pictures=work.folder)
    return result


def unseen_in_words(study: UnseenStudy) -> str:
    """Return what a study computes and about how long that takes."""
    seconds, what = 0.0, []
    if (unsewn := study.unsewn) is not None:
        shapes = len(unsewn.poses) * (study.samples + 1 + len(to_either_side(unsewn.design)))
        candidates = prediction.candidates_of(unsewn, study.rig)
        seconds += unseen_seconds(shapes, len(candidates), study.points_per_side)
        what += [f"{shapes} shapes", f"{len(candidates)} measurements that could be made"]
    if (measured := study.measured) is not None:
        unknowns = len(fit_vector(study.free, where=FREE).parameters)
        for name in measured.designs:
            motion = [float(trial.times[-1]) for trial in measured.trials if trial.design_name != name]
            seconds += fit_seconds(CALIBRATION, motion, unknowns, study.points_per_side)
        what.append(f"{len(measured.designs)} designs left out")
    return in_words(seconds, *what, on_cores())


def unsewn_result(
    study: UnseenStudy, engine: ForwardModel, checkpoint: Checkpoint, progress: Progress
) -> UnsewnResult | None:
    """Return what there is to say of a layout before it is sewn; None where the study has none."""
    if (unsewn := study.unsewn) is None:
        return None
    draws = prediction.Draws(unsewn.model, unsewn.design)
    forward = replace(forward_model(engine, unsewn.model), model=Model())  # a case brings all of it
    progress(f"shapes of {study.samples} models, {len(unsewn.poses)} poses", 0.0)
    poses = checkpoint.get("poses", lambda: prediction.predicted(unsewn, draws, forward, study.samples, study.seed))

    def measure() -> Measurement:
        candidates = prediction.candidates_of(unsewn, study.rig)
        progress(f"what {len(candidates)} measurements would tell", _DERIVATIVES)
        return prediction.measurement(unsewn, draws, forward, candidates)

    measured = checkpoint.get("measurement", measure)
    return UnsewnResult(
        design=unsewn.design.name,
        model_points_per_side=unsewn.model.points_per_side,
        doubted=unsewn.model.unreliable,
        poses=poses and of_exact(list[PoseResult], poses),
        unknown=draws.unknown,
        calibrated=spread_of(unsewn.model) is not None,
        intervals=prediction.intervals_statement(unsewn.model),
        corrector=prediction.corrector_reach(unsewn.model, unsewn),
        measurement=measured and of_exact(Measurement, measured),
    )


def _left_out(
    study: UnseenStudy,
    work: WorkFolder,
    forward: ForwardModel,
    coarse: ForwardModel,
    checkpoint: Checkpoint,
    progress: Progress,
) -> dict[str, Any]:
    """Return each design of the measured set as those of the others predict it, by name."""
    assert study.measured is not None
    results = {}
    names, begin = sorted(study.measured.designs), 0.0 if study.unsewn is None else _UNSEWN
    ends = np.linspace(begin, 1.0, len(names) + 1)[:-1]
    for name, part in zip(names, parts(progress, *ends.tolist())[1:], strict=True):
        piece = f"left_out_{file_stem(name)}"
        work.claim(f"{piece}.png")
        compute = partial(left_out, study, name, forward, coarse, work.folder / f"{piece}.png", progress=part)
        results[name] = checkpoint.get(piece, compute)
    return results


def _content(study: UnseenStudy) -> dict[str, str]:
    """Return what the pieces depend on, by field."""
    measured = {}
    if study.measured is not None:
        measured["unjudged"] = f"found with {GRID} points a side"
        for trial in study.measured.trials:
            measured[f"measured.{trial.file.name}"] = f"{trial.design_name}, {trial.role}, {sha256(trial.file)}"
    return kept_content(study, ("name", "seconds", "measured"), measured, ALGORITHM)


_FIT = 0.8  # of the work, beside the evaluation


def left_out(
    study: UnseenStudy, name: str, forward: ForwardModel, coarse: ForwardModel, picture: Path, *, progress: Progress
) -> dict[str, Any]:
    """Return errors of the data sheet and of what the other designs' trials of role `fit` gave, on at most
    `study.trials` trials of the design `name`; an overlay of one of them goes to `picture` (PNG). With effects fitted
    besides (`study.free`) the errors without them, of factors fitted alone, are said too. coarse: as `calibrate` and
    `evaluate` take it; sensitive stretches are neither fitted nor evaluated. What `evaluate` says of a design and of
    these stretches, the model's factors and effects, and how many trials were fitted. Raises InputError where nothing
    is left to fit or to evaluate."""
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
    row = plain(evaluation.designs[name]) | plain(evaluation.used)
    if model.effects:
        row["without_effects"] = plain(evaluated(calibration.model.before, ", factors alone").designs[name])["after"]
    content = calibration.to_json()
    return row | {
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
    """Draw the cloud of frame k over the models before and after, from the side and from the front."""
    from matplotlib.figure import Figure

    clouds = trial.load().frames
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    for column, (state, shown) in enumerate((("before", model.before), ("after", model))):
        predictor = sensed_model(forward, shown)
        motion = predictor.motions([Case(trial.design, trial.program, order=trial.order)], [trial.times])[0]
        for view, (axis, label) in enumerate(((2, "z"), (0, "x"))):
            panel = axes[2 * column + view]
            panel.plot(in_mm(motion[k][:, axis]), in_mm(motion[k][:, 1]), ".", color="#92c5de", markersize=2)
            panel.plot(in_mm(clouds[k][::2, axis]), in_mm(clouds[k][::2, 1]), ".", color="#1c2430", markersize=1)
            panel.set(title=f"{state}, {'side' if axis == 2 else 'front'}", xlabel=f"{label}, mm", aspect="equal")
    axes[0].set_ylabel("y, mm")
    figure.suptitle(f"{trial.design_name} {trial.name}, {trial.times[k]:.2f} s: measured (dark) over model (light)")
    with atomic_file(path) as unfinished:
        figure.savefig(unfinished, dpi=90, format="png")

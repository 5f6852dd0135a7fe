"""A study of what is not measured yet, from its file to its report."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from fabdesign.formats.toml_file import file_stem
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model_sampling import spread_of
from fabdesign.output import WorkFolder
from fabdesign.runtime.effort import CALIBRATION, fit_seconds, in_words, on_cores, unseen_seconds
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import Checkpoint
from fabdesign.study_files.unseen_file import FREE, UnseenStudy
from optimize.fit.descent import Progress, parts
from optimize.fit.free_parameters import fit_vector
from studies.measured.sensitive_stretches import GRID
from studies.prediction.forward_model import forward_model
from studies.prediction.stability import to_either_side
from studies.study import Simulated, StudyRun, kept_content, simulator
from studies.unseen.cross_validation import left_out
from studies.unseen.prediction import (
    Draws,
    candidates_of,
    corrector_statement,
    intervals_statement,
    measurement,
    predicted,
)
from studies.unseen.report import Measurement, UnseenResult, write_report

_UNSEWN = 0.5  # of the work, that predictions of a layout that is not sewn take beside measured designs
_DERIVATIVES = 0.3  # of it, after which measurements are compared
ALGORITHM = 13  # of what a study's folder keeps: raised where it is no longer what this code would compute


def run_unseen(
    study: UnseenStudy | Path | str,
    out: Path | str,
    *,
    progress: Callable[[str, float | None], None] = lambda line, share: None,
    **how: Unpack[Simulated],
) -> UnseenResult:
    """Evaluate what the study names and write `result.json` and `report.html` into `out`. Return what result.json
    holds. The same study goes on in its folder, piece by piece.

    coarse: finds the sensitive stretches of the measured set (studies.measured.sensitive_stretches).
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
        result: UnseenResult = {"name": study.name, "seed": study.seed, "points_per_side": study.points_per_side}
        before = parts(progress, _UNSEWN)[0] if study.measured is not None else progress
        result = _unsewn(result, study, forward, checkpoint, before)
        if study.measured is not None:
            result["free"] = list(study.free)
            result["left_out"] = _left_out(study, work, forward, coarse or forward, checkpoint, progress)
        result["wall_s"] = checkpoint.spent
        with work.adding() as files:
            write_report(result, files, pictures=work.folder)
    return result


def unseen_in_words(study: UnseenStudy) -> str:
    """Return what a study computes and about how long that takes."""
    seconds, what = 0.0, []
    if (unsewn := study.unsewn) is not None:
        shapes = len(unsewn.poses) * (study.samples + 1 + len(to_either_side(unsewn.design)))
        candidates = candidates_of(unsewn, study.rig)
        seconds += unseen_seconds(shapes, len(candidates), study.points_per_side)
        what += [f"{shapes} shapes", f"{len(candidates)} measurements that could be made"]
    if (measured := study.measured) is not None:
        unknowns = len(fit_vector(study.free, where=FREE).parameters)
        for name in measured.designs:
            motion = [float(trial.times[-1]) for trial in measured.trials if trial.design_name != name]
            seconds += fit_seconds(CALIBRATION, motion, unknowns, study.points_per_side)
        what.append(f"{len(measured.designs)} designs left out")
    return in_words(seconds, *what, on_cores())


def _unsewn(
    result: UnseenResult, study: UnseenStudy, engine: ForwardModel, checkpoint: Checkpoint, progress: Progress
) -> UnseenResult:
    """Return the result with what there is to say of a layout before it is sewn."""
    if (unsewn := study.unsewn) is None:
        return result
    draws = Draws(unsewn.model, unsewn.design)
    bare = replace(unsewn.model, parameters={}, effects=())  # a case brings all of it
    forward = replace(forward_model(engine, unsewn.model), model=bare)
    progress(f"shapes of {study.samples} models, {len(unsewn.poses)} poses", 0.0)
    poses = checkpoint.get("poses", lambda: predicted(unsewn, draws, forward, study.samples, study.seed))

    def measure() -> Measurement:
        candidates = candidates_of(unsewn, study.rig)
        progress(f"what {len(candidates)} measurements would tell", _DERIVATIVES)
        return measurement(unsewn, draws, forward, candidates)

    return {
        **result,
        "design": unsewn.design.name,
        "model_points_per_side": unsewn.model.points_per_side,
        "doubted": list(unsewn.model.unreliable),
        "poses": poses,
        "unknown": list(draws.unknown),
        "calibrated": spread_of(unsewn.model) is not None,
        "intervals": intervals_statement(unsewn.model),
        "corrector": corrector_statement(unsewn.model, unsewn),
        "measurement": checkpoint.get("measurement", measure),
    }


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

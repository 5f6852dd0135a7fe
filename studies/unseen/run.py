"""A study of what is not measured yet, from its file to its report."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.formats.toml_file import file_stem
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model_sampling import spread_of
from fabdesign.output import WorkFolder, work_folder
from fabdesign.runtime.effort import CALIBRATION, fit_seconds, in_words, on_cores, unseen_seconds
from fabdesign.runtime.fingerprint import content_of, sha256
from fabdesign.runtime.store import Checkpoint
from fabdesign.study_files.unseen_file import FREE, UnseenStudy, Unsewn, read_unseen
from fabdesign.units import in_kpa, in_mm
from fabdesign.version import SIMULATOR
from optimize.fit.descent import Progress, parts
from optimize.fit.free_parameters import fit_vector
from studies.measured.sensitive_stretches import GRID
from studies.prediction.forward_model import forward_model
from studies.prediction.stability import to_either_side
from studies.unseen.cross_validation import left_out
from studies.unseen.draws import Draws
from studies.unseen.measurement import Array, after, candidates_of, in_turn, information, pose_slopes, spread
from studies.unseen.prediction import corrector_statement, intervals_statement, predicted
from studies.unseen.report import write_report
from studies.unseen.result import CandidateResult, Measurement, PoseResult, ProposedProgram, UnseenResult

_UNSEWN = 0.5  # of the work, that predictions of a layout that is not sewn take beside measured designs
_DERIVATIVES = 0.3  # of it, after which measurements are compared
IN_TURN = 3  # measurements that are proposed together
ALGORITHM = 12  # of what a study's folder keeps: raised where it is no longer what this code would compute


def run_unseen(
    study: UnseenStudy | Path | str,
    out: Path | str,
    *,
    forward: ForwardModel | None = None,
    coarse: ForwardModel | None = None,
    seconds: float | None = None,
    force: bool = False,
    progress: Progress = lambda line, share: None,
) -> UnseenResult:
    """Evaluate what the study names and write `result.json` and `report.html` into `out`; what result.json holds.

    forward: by default the simulator with the study's grid. coarse: finds the sensitive stretches of the measured
    set (studies.measured.sensitive_stretches), by default one of its own, or `forward` where that is given. The
    same study goes on in its folder, piece by piece.
    Raises InputError, and SimulationError where shapes cannot be computed.
    """
    inputs = [] if isinstance(study, UnseenStudy) else [study]
    study = study if isinstance(study, UnseenStudy) else read_unseen(study)
    study = study if seconds is None else replace(study, seconds=seconds)
    inputs += sorted({trial.file.parent.parent for trial in study.measured.trials}) if study.measured else []
    fit_vector(study.free, where=FREE)  # before anything is computed: it raises
    with work_folder(out, made_by="unseen", force=force, inputs=inputs) as work:
        checkpoint = Checkpoint(work, _content(study), seconds=study.seconds)
        if forward is None:
            from sim import Simulator  # here: it loads and starts taichi

            forward = Simulator(study.points_per_side, rise=study.rise, hold=study.hold)
            coarse = coarse or Simulator(GRID)
        result: UnseenResult = {"name": study.name, "seed": study.seed, "points_per_side": study.points_per_side}
        before = parts(progress, _UNSEWN)[0] if study.measured is not None else progress
        if study.unsewn is not None:
            _add_unsewn(result, study, study.unsewn, forward, checkpoint, before)
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


def _add_unsewn(
    result: UnseenResult,
    study: UnseenStudy,
    unsewn: Unsewn,
    simulator: ForwardModel,
    checkpoint: Checkpoint,
    progress: Progress,
) -> None:
    draws = Draws(unsewn.model, unsewn.design)
    bare = replace(unsewn.model, parameters={}, effects=())  # a case brings all of it
    forward = replace(forward_model(simulator, unsewn.model), model=bare)
    progress(f"shapes of {study.samples} models, {len(unsewn.poses)} poses", 0.0)
    poses: list[PoseResult] | None = checkpoint.get(
        "poses", lambda: predicted(unsewn, draws, forward, study.samples, study.seed)
    )

    def measurement() -> Measurement:
        b = pose_slopes(unsewn, draws, forward)
        candidates = candidates_of(unsewn, study.rig)
        progress(f"what {len(candidates)} measurements would tell", _DERIVATIVES)
        left: dict[str, CandidateResult] = {}
        told: dict[str, Array] = {}
        for candidate, gained in zip(candidates, information(candidates, draws, forward), strict=True):
            if np.isfinite(gained).all():
                left[candidate.name] = {"design": candidate.design.name, "left_mm": in_mm(after(b, gained))}
                told[candidate.name] = gained
        ranked = dict(sorted(left.items(), key=lambda item: item[1]["left_mm"]))
        now = in_mm(spread(b, np.eye(len(draws.names))))
        best = next((c for c in candidates if ranked and c.name == next(iter(ranked))), None)
        program: ProposedProgram | None = None if best is None else {
            "time_s": best.program.time.tolist(),
            "pressure_kpa": in_kpa(best.program.pressure).round(3).tolist(),
            "duration_s": best.program.duration,
        }  # fmt: skip
        shares = {name: in_mm(spread(b[:, k : k + 1], np.eye(1))) for k, name in enumerate(draws.names)}
        several = {name: in_mm(value) for name, value in in_turn(b, told, IN_TURN).items()}
        return {"spread_mm": now, "due_to_mm": shares, "candidates": ranked, "program": program, "in_turn_mm": several}

    result["design"] = unsewn.design.name
    result["model_points_per_side"] = unsewn.model.points_per_side
    result["doubted"] = list(unsewn.model.unreliable)
    result["poses"] = poses
    result["unknown"] = list(draws.unknown)
    result["calibrated"] = spread_of(unsewn.model) is not None
    result["intervals"] = intervals_statement(unsewn.model)
    result["corrector"] = corrector_statement(unsewn.model, unsewn)
    result["measurement"] = checkpoint.get("measurement", measurement)


def _left_out(
    study: UnseenStudy,
    work: WorkFolder,
    forward: ForwardModel,
    coarse: ForwardModel,
    checkpoint: Checkpoint,
    progress: Progress,
) -> dict[str, Any]:
    measured = study.measured
    assert measured is not None
    results = {}
    names, begin = sorted(measured.designs), 0.0 if study.unsewn is None else _UNSEWN
    ends = np.linspace(begin, 1.0, len(names) + 1)[:-1]
    for name, own in zip(names, parts(progress, *ends.tolist())[1:], strict=True):
        picture = f"left_out_{file_stem(name)}.png"
        work.claim(picture)

        def compute(name: str = name, picture: str = picture, own: Progress = own) -> dict[str, Any]:
            return left_out(
                measured,
                name,
                forward,
                coarse=coarse,
                trials=study.trials,
                free=study.free,
                points_per_side=study.points_per_side,
                seed=study.seed,
                picture=work.folder / picture,
                progress=own,
            )

        results[name] = checkpoint.get(f"left_out_{file_stem(name)}", compute)
    return results


def _content(study: UnseenStudy) -> dict[str, str]:
    """What the pieces depend on, by field."""
    measured = {}
    if study.measured is not None:
        measured["unjudged"] = f"found with {GRID} points a side"
        for trial in study.measured.trials:
            measured[f"measured.{trial.file.name}"] = f"{trial.design_name}, {trial.role}, {sha256(trial.file)}"
    content = content_of(study, ("name", "seconds", "measured"), measured)
    return {"simulator": str(SIMULATOR), "algorithm": str(ALGORITHM)} | content

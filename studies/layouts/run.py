"""A target cloud becomes a layout with pressures: one study from its file to its report."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Unpack

import numpy as np

from fabdesign.errors import SimulationError
from fabdesign.nouns.array import Array
from fabdesign.nouns.model_sampling import half_widths, spread_of
from fabdesign.nouns.predictor import Predictor
from fabdesign.output import WorkFolder, write_text
from fabdesign.runtime import working_time
from fabdesign.study_files.study_file import Study, read_study, require_searchable
from fabdesign.units import in_kpa, in_mm
from optimize.search.best import MARGIN
from optimize.search.evaluations import FINALISTS, Evaluations
from optimize.search.history import History
from optimize.search.margins import constraint_margins
from optimize.search.multistart import INTERRUPTED, search
from optimize.search.objective import MEASURES, Objective
from optimize.search.starts import Start
from studies.intervals.draws import drawn_models, region_terms
from studies.layout_search.first_layouts import first_starts, forward_models, further_starts, stages_of
from studies.layout_search.target import LoadedTarget, load_target, target_errors
from studies.layouts.loading_path import LoadingPath, loading_path
from studies.layouts.reach import helps_of, lacking_of, missed_at, reach_of
from studies.layouts.refinement import POOL, ROBUST_MARGIN, made_robust, search_seconds, shrunk
from studies.layouts.report import render_report
from studies.layouts.result import StudyResult, Verification, answer, keep, study_content, write_best
from studies.layouts.robustness import robustness_of
from studies.layouts.scatter import Scattering
from studies.prediction.forward_model import forward_model, without_resistance
from studies.study import Simulated, StudyRun

HISTORY = "history.sqlite"
FOLLOWING = 20.0  # s after the limit, from which on no further layout is moved from rest
TENTH = 0.1  # of its limits, after which a search says how far it is
ROUNDING = 1e-6  # m: a floor of less is that of markers, which have none
FILES = "result.json", "design.toml", "pressures.csv", "report.html"  # of every result


def run_study(
    study: Study | Path | str,
    out: Path | str,
    *,
    starts: Sequence[Start] | None = None,
    verification: Verification = "motion",
    progress: Callable[[Evaluations], None] = lambda _: None,
    **how: Unpack[Simulated],
) -> StudyResult:
    """Search, and write `result.json`, `design.toml`, `pressures.csv` and `report.html` into `out`.

    The search runs on `coarse` and ends on `forward` (by default the simulator with 21 points a side and with the
    study's model's or 41; `forward` alone serves for both). While it runs, `out` always has the best so far; the same
    call on the same folder goes on after an interruption, and does not search again what is finished. Further poses'
    pressures are `pressures_2.csv` and so on. starts: where the search begins, the same in every call on a folder; by
    default what `first_starts` gives. verification: comes after the search. Ctrl-C ends the search with a result;
    searched anew by `force`, the same call goes on.

    A folder of another study (OtherContent) or of other files, and one where another search runs, are refused:
    InputError, like other bad input before anything is computed.
    """
    run = StudyRun.of(study, read_study, how)
    study = run.study
    require_searchable(study, study.name)
    targets = tuple(load_target(target, study.design, seed=study.seed) for target in study.targets)
    begun = first_starts(study) if starts is None else [*starts]
    with run.folder(out, "optimize", [t.file for t in study.targets if t.points is None]) as work:
        with History.of_work(work, HISTORY, study_content(study, targets)) as history:
            if (kept := answer(history, study, targets, verification)) is not None:
                if not all((work.folder / name).is_file() for name in FILES):
                    _write(work, kept)
                return kept
            report = _reporting(work, study, targets, progress)
            result = searched(study, targets, begun, history, report, verification, how)
            if not result.interrupted:
                keep(history, result)
        if work.anew and result.interrupted:
            work.complete = False
            result = replace(result, stop_reason=f"{result.stop_reason}; {out} holds the earlier result until then")
        _write(work, result)
    return result


def _write(work: WorkFolder, result: StudyResult) -> None:
    with work.adding() as files:
        result.write(files)
        name = result.study.name
        write_text(files / "report.html", render_report(name, {name: result}))


def searched(
    study: Study,
    targets: tuple[LoadedTarget, ...],
    starts: list[Start],
    history: History,
    progress: Callable[[Evaluations], None],
    verification: Verification,
    how: Simulated,
) -> StudyResult:
    follow = verification == "motion"
    objective = Objective(targets, study.objective, study.order, [t.weight for t in targets])
    fine, quick = (forward_model(engine, study.model) for engine in forward_models(how, study, targets))
    evaluations = Evaluations(
        objective,
        starts,
        stages_of(study, quick, fine, objective),
        history,
        seconds=search_seconds(study),
        evaluations=study.limits.evaluations,
        on_progress=progress,
    )
    evaluations.reached.margin, evaluations.limit = ROBUST_MARGIN if study.robust else MARGIN, study.limits.seconds
    floor = partial(_floor, study, targets)
    stop_reason, fewer = search(evaluations, further=further_starts(study), floor=floor), None
    try:
        fewer = None if stop_reason == INTERRUPTED else shrunk(study, evaluations)
    except KeyboardInterrupt:
        stop_reason = INTERRUPTED
    if follow:
        evaluations.message = (
            "following the motions that lead to the result; this comes after the limit of seconds, some 20 s"
        )
        progress(evaluations)
    scattering = Scattering(study, study.robust, objective, quick) if follow and study.robust else None
    doubled = 0
    smaller = [] if fewer is None or fewer.ended else [fewer.start]
    points = [*smaller, *evaluations.finalists(FINALISTS if scattering is None else POOL)]
    if scattering is not None:
        try:
            points, doubled = made_robust(scattering, evaluations, points)
        except KeyboardInterrupt:
            stop_reason = INTERRUPTED
    chosen = points if follow and scattering is None else points[: FINALISTS if follow else 1]
    result = study_result(study, targets, evaluations, fine, stop_reason, chosen, verification)
    result = replace(result, fewer=fewer)
    if not follow:
        return result
    result = replace(result, within=expected_within(result, objective, quick))
    if scattering is None:
        return result
    nearest = evaluations.best.value if evaluations.best else result.objective
    outcome = robustness_of(scattering, (result.design, result.pressure), fine, nominal=nearest)
    same_count = len(result.design.muscles) == len(points[0][0].design.muscles)
    return replace(result, robust=replace(outcome, doubled=doubled if same_count else 0))


def _reporting(
    work: WorkFolder, study: Study, targets: tuple[LoadedTarget, ...], progress: Callable[[Evaluations], None]
) -> Callable[[Evaluations], None]:
    """Return progress that also writes the best so far, as often as it changes, and tells, after a tenth of the
    search's limits, how far it is."""
    written: list[float] = []

    def report(evaluations: Evaluations) -> None:
        best, shape = evaluations.best, evaluations.reached.shape
        if best is not None and written[-1:] != [best.value]:
            written.append(best.value)
            space, x = evaluations.best_point()
            design, pressures = space.decode(x)
            unfinished = {
                "objective_mm": in_mm(best.value),
                "evaluations": evaluations.history.evaluations,
                "wall_s": evaluations.elapsed,
                "muscles": design.muscles,
                "pressures_kpa": in_kpa(pressures if len(pressures) > 1 else pressures[0]),
                "stop_reason": f"unfinished: the best so far, in stage {evaluations.stages[best.stage].name}",
            }
            with work.adding() as files:
                write_best(files, design, pressures, unfinished, [target.time for target in targets], study.rise)
        if not evaluations.message and evaluations.share >= TENTH and best is not None and shape is not None:
            least = _floor(study, targets, shape)
            over = f", {best.value / least:.2f} times the noise floor" if least > ROUNDING else ""
            evaluations.message = (
                f"after a tenth of its time {in_mm(best.value):.2f} mm{over}, in stage {evaluations.stage}"
            )
        progress(evaluations)

    return report


def _floor(study: Study, targets: tuple[LoadedTarget, ...], shapes: Array) -> float:
    """Return the floor [m] of a result's shapes (poses, 2 n, 3) m, in the measure that is searched."""
    return MEASURES[study.objective].errors(target_errors(targets, shapes, study.design, seed=study.seed))[1]


def study_result(
    study: Study,
    targets: tuple[LoadedTarget, ...],
    evaluations: Evaluations,
    forward: Predictor,
    stop_reason: str,
    points: Sequence[Start] = (),
    verification: Verification = "motion",
) -> StudyResult:
    """Return the result of the first of `points` whose loading path is not sensitive, else of the first: where its
    motion leads, valued once more on the full model, and the resting cloth. By default points are what is as near as
    the best."""
    objective, searched_s, follow = evaluations.objective, evaluations.elapsed, verification == "motion"
    points = [*points] or evaluations.finalists()
    layouts = [space.decode(x) for space, x in points]
    resting = [(design, np.zeros_like(pressures)) for design, pressures in layouts]
    every = objective.shapes(forward, [*layouts, *resting])
    shapes, rests = every[: len(points)], every[len(points) :]
    if not (np.all(np.isfinite(shapes[0])) and np.all(np.isfinite(rests[0]))):
        raise SimulationError(f"{study.name}: the best design diverges on the full model; {stop_reason}")
    paths: list[LoadingPath] = []
    begun = working_time.seconds()
    for layout, at, still in zip(layouts, shapes, rests, strict=True) if follow else ():
        paths.append(loading_path(objective, forward, layout, at, still, rise=study.rise))
        if not paths[-1].sensitive or working_time.seconds() - begun > FOLLOWING:
            break
    chosen = next((k for k, one in enumerate(paths) if not one.sensitive), 0)
    (design, pressures), shape, rest = layouts[chosen], shapes[chosen], rests[chosen]
    path = paths[chosen] if follow else None
    if path is not None and not path.reached and np.all(np.isfinite(path.shape)):
        shape = path.shape
    errors = target_errors(targets, shape, design, seed=study.seed)
    targets = tuple(target.beside(one) for target, one in zip(targets, shape, strict=True))
    margins = constraint_margins(design, pressures, study.limits, shape)
    reach = reach_of(study, design, pressures, shape, errors, margins, lacking_of(evaluations))
    if reach.out_of_reach and follow:
        size = design.fabric.width, design.fabric.height
        missed = tuple(missed_at(one, t, size) for one, t in zip(shape, targets, strict=True))
        helps = helps_of(study, points[chosen], objective, without_resistance(forward) or forward)
        reach = replace(reach, missed=missed, helps=helps)
    return StudyResult(
        study=study,
        design=design,
        pressure=pressures,
        targets=targets,
        points=shape,
        rest=rest[0],
        errors=errors,
        rest_errors=target_errors(targets, rest, design, seed=study.seed, draws=1),
        constraints=margins,
        history=tuple(evaluations.history.entries()),
        wall_s=searched_s,
        stop_reason=stop_reason,
        reach=reach,
        loading_path=path,
    )


def expected_within(result: StudyResult, objective: Objective, coarse: Predictor) -> float | None:
    """Return half the width [m] of the 90 % intervals along the cloth's normal, mean over poses and regions. None of a
    model without. coarse: moves the drawn models."""
    spread = spread_of(coarse.model)
    if spread is None:
        return None
    models, layout = drawn_models(coarse.model) if spread.covariance else [], (result.design, result.pressure)
    others = [objective.shapes(replace(coarse, model=model), [layout])[0] for model in models]
    terms = region_terms(result.rest, result.points, others, result.design.fabric)
    return float(half_widths(spread, *terms).mean())

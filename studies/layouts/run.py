"""A target cloud becomes a layout with pressures: one study from its file to its report."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import SimulationError
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.output import WorkFolder, work_folder, write_text
from fabdesign.study_files.study_file import Study, read_study, require_searchable
from fabdesign.units import in_mm
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import FINALISTS, NEAR, Evaluations
from optimize.search.history import History
from optimize.search.margins import constraint_margins
from optimize.search.multistart import INTERRUPTED, search
from optimize.search.objective import Objective
from optimize.search.starts import Start
from optimize.search.thinning import Fewer
from studies.layout_search.first_layouts import first_starts, further_starts, limits_of
from studies.layout_search.progress import saying_a_tenth
from studies.layout_search.stages import coarse_hold_of, forward_models, stages_of
from studies.layout_search.target import LoadedTarget, load_target, target_errors
from studies.layouts.kept_result import answer, keep, study_content
from studies.layouts.loading_path import loading_paths
from studies.layouts.out_of_reach import helps_of, missed_at
from studies.layouts.reach import lacking_of, reach_of
from studies.layouts.refinement import NEAR as NEAR_ENOUGH
from studies.layouts.refinement import POOL, made_robust, points_of, search_seconds, shrunk
from studies.layouts.report import Section, render_report
from studies.layouts.result import StudyResult, expected_within, pressures_kpa, write_best
from studies.layouts.robustness import robustness_of
from studies.prediction.forward_model import forward_model, without_resistance

HISTORY = "history.sqlite"
FILES = "result.json", "design.toml", "pressures.csv", "report.html"  # of every result


def run_study(
    study: Study | Path | str,
    out: Path | str,
    *,
    forward: ForwardModel | None = None,
    coarse: ForwardModel | None = None,
    seconds: float | None = None,
    force: bool = False,
    starts: Sequence[Start] | None = None,
    follow: bool = True,
    progress: Callable[[Evaluations], None] = lambda _: None,
) -> StudyResult:
    """Search, and write `result.json`, `design.toml`, `pressures.csv` and `report.html` into `out`.

    The search runs on `coarse` and ends on `forward` (by default the simulator with 21 points a side and with the
    study's model's or 41; `forward` alone serves for both). While it runs, `out` always has the best so far; the same
    call on the same folder goes on after an interruption, and does not search again what is finished. Further poses'
    pressures are `pressures_2.csv` and so on. `seconds` takes the place of the limit of the study. starts: where the
    search begins, the same in every call on a folder; by default what `first_starts` gives. follow: whether the
    motion that leads to the result is computed too, after the search. Ctrl-C ends the search with a result.

    A folder of another study (OtherContent) or of other files, and one where another search runs, are refused:
    InputError, like other bad input before anything is computed. force: search anew in such a folder of another or of
    the same study; its old content stays until the search has ended, or, interrupted, goes on by the
    same call.
    """
    out, given = Path(out), study
    study = study if isinstance(study, Study) else read_study(study)
    if seconds is not None:
        study = replace(study, limits=replace(study.limits, seconds=seconds))
    require_searchable(study, study.name)
    targets = tuple(load_target(target, study.design, seed=study.seed) for target in study.targets)
    objective = Objective(
        [t.sought for t in targets],
        study.objective,
        study.order,
        [t.weight for t in targets],
    )
    begun = first_starts(study) if starts is None else [*starts]
    inputs = [*([] if isinstance(given, Study) else [given]), *(target.file for target in study.targets)]
    with work_folder(out, made_by="optimize", force=force, inputs=inputs) as work:
        with History.of_work(work, HISTORY, study_content(study, targets)) as history:
            if (kept := answer(history, study, targets, follow=follow)) is not None:
                if not all((work.folder / name).is_file() for name in FILES):
                    _write(work, kept)
                return kept
            result = _search_in(work, study, targets, objective, begun, forward, coarse, follow, progress, history)
            if not result.interrupted:
                keep(history, result, follow=follow)
        if work.anew and result.interrupted:
            work.complete = False
            result = replace(result, stop_reason=f"{result.stop_reason}; {out} holds the earlier result until then")
        _write(work, result)
    return result


def _write(work: WorkFolder, result: StudyResult) -> None:
    with work.adding() as files:
        result.write(files)
        name = result.study.name
        write_text(files / "report.html", render_report(name, [Section(name, result)]))


def _search_in(
    work: WorkFolder,
    study: Study,
    targets: tuple[LoadedTarget, ...],
    objective: Objective,
    starts: list[Start],
    forward: ForwardModel | None,
    coarse: ForwardModel | None,
    follow: bool,
    progress: Callable[[Evaluations], None],
    history: History,
) -> StudyResult:
    given = forward_models(
        forward,
        coarse,
        points_per_side=(study.model or Model()).points_per_side,
        rise=study.rise,
        hold=study.hold,
        coarse_hold=coarse_hold_of(study, targets),
    )
    floor = _floor(study, targets)
    fine, quick = (forward_model(simulator, study.model) for simulator in given)
    evaluations = Evaluations(
        objective,
        starts,
        stages_of(study, quick, fine, objective),
        history,
        seconds=search_seconds(study),
        evaluations=study.limits.evaluations,
        on_progress=_keeping_best(work, targets, study.rise, saying_a_tenth(floor, progress)),
    )
    evaluations.near, evaluations.limit = NEAR_ENOUGH if study.robust else NEAR, study.limits.seconds
    stop_reason, fewer = search(evaluations, further=further_starts(study), floor=floor), None
    try:
        fewer = None if stop_reason == INTERRUPTED else shrunk(study, evaluations)
    except KeyboardInterrupt:
        stop_reason = INTERRUPTED
    if follow:
        evaluations.told = "following the motions that lead to the result; this comes after the limit of seconds"
        progress(evaluations)
    if study.robust is None or not follow:
        points = [*points_of(fewer), *evaluations.finalists()][: None if follow else 1]
        result = _result(study, targets, evaluations, fine, stop_reason, points, follow=follow, fewer=fewer)
        return replace(result, within=expected_within(result, objective, quick)) if follow else result
    points = [*points_of(fewer), *evaluations.finalists(POOL)]
    doubled = 0
    try:
        points, doubled = made_robust(study, study.robust, evaluations, points, quick)
    except KeyboardInterrupt:
        stop_reason = INTERRUPTED
    result = _result(study, targets, evaluations, fine, stop_reason, points[:FINALISTS], fewer=fewer)
    result = replace(result, within=expected_within(result, objective, quick))
    nearest = evaluations.best.value if evaluations.best else result.objective
    layout = (result.design, result.pressures)
    robust = robustness_of(study, study.robust, layout, objective, quick, fine, nominal=nearest)
    same_count = len(result.design.muscles) == len(points[0][0].design.muscles)
    return replace(result, robust=replace(robust, doubled=doubled if same_count else 0))


def _keeping_best(
    work: WorkFolder, targets: tuple[LoadedTarget, ...], rise: float, progress: Callable[[Evaluations], None]
) -> Callable[[Evaluations], None]:
    """Return progress that also writes the best so far, as often as it changes."""
    written: list[float] = []

    def report(evaluations: Evaluations) -> None:
        if evaluations.best is not None and written[-1:] != [evaluations.best.value]:
            written.append(evaluations.best.value)
            space, x = evaluations.best_point()
            design, pressures = space.decode(x)
            stage = evaluations.stages[evaluations.best.stage]
            unfinished = {
                "objective_mm": in_mm(evaluations.best.value),
                "evaluations": evaluations.history.evaluations,
                "wall_s": evaluations.elapsed,
                "muscles": [asdict(muscle) for muscle in design.muscles],
                "pressures_kpa": pressures_kpa(pressures),
                "stop_reason": f"unfinished: the best so far, in stage {stage.name}",
            }
            with work.adding() as files:
                write_best(files, design, pressures, unfinished, [target.time for target in targets], rise)
        progress(evaluations)

    return report


def _floor(study: Study, targets: tuple[LoadedTarget, ...]) -> Callable[[NDArray[np.float64]], float]:
    """Return the floor [m] of a result's shapes (poses, 2 n, 3) m, in the measure that is searched."""

    def floor(shapes: NDArray[np.float64]) -> float:
        errors = target_errors(targets, shapes, study.design, seed=study.seed)
        return errors.chamfer_floor if study.objective == "chamfer" else errors.surface_floor

    return floor


def _result(
    study: Study,
    targets: tuple[LoadedTarget, ...],
    evaluations: Evaluations,
    forward: Predictor,
    stop_reason: str,
    points: Sequence[Start] = (),
    *,
    follow: bool = True,
    fewer: Fewer | None = None,
) -> StudyResult:
    """Return the result of the first of `points` whose loading path is not sensitive, else of the first: where its
    motion leads, valued once more on the full model, and the resting cloth. By default points are what is as near as
    the best."""
    objective, searched_s = evaluations.objective, evaluations.elapsed
    points = [*points] or evaluations.finalists()
    layouts = [space.decode(x) for space, x in points]
    still = [
        (DesignSpace(design, limits_of(study), np.zeros_like(pressures), vary_pressures=False), np.empty(0))
        for design, pressures in layouts
    ]
    every = objective.shapes(forward, [*points, *still])
    shapes, rests = every[: len(points)], every[len(points) :]
    if not (np.all(np.isfinite(shapes[0])) and np.all(np.isfinite(rests[0]))):
        raise SimulationError(f"{study.name}: the best design diverges on the full model; {stop_reason}")
    paths = loading_paths(objective, forward, layouts, shapes, rests, rise=study.rise) if follow else []
    chosen = next((k for k, one in enumerate(paths) if not one.sensitive), 0)
    (design, pressures), shape, rest = layouts[chosen], shapes[chosen], rests[chosen]
    path = paths[chosen] if follow else None
    if path is not None and not path.reached and np.all(np.isfinite(path.shape)):
        shape = path.shape
    errors = target_errors(targets, shape, design, seed=study.seed)
    targets = tuple(target.beside(one) for target, one in zip(targets, shape, strict=True))
    margins = constraint_margins(design, pressures, limits_of(study), shape)
    reach = reach_of(study, design, pressures, shape, errors, margins, lacking_of(evaluations))
    if reach.out_of_reach and follow:
        size = design.fabric.width, design.fabric.height
        missed = tuple(missed_at(one, t, size) for one, t in zip(shape, targets, strict=True))
        reach = replace(
            reach,
            missed=missed,
            helps=helps_of(study, points[chosen], objective, without_resistance(forward) or forward),
        )
    return StudyResult(
        study=study,
        design=design,
        pressures=pressures,
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
        fewer=fewer,
    )

"""`fabdesign loop STUDY`: from a target and a start design to one that was measured, turn by turn."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Unpack

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, write_design
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.runtime.effort import CALIBRATION, TRACE, cores, fit_seconds, in_words, on_cores, rig_seconds
from fabdesign.runtime.store import Checkpoint
from fabdesign.study_files.loop_file import Laboratory, LoopStudy, VirtualRig
from fabdesign.units import from_mm
from studies.layout_search.first_layouts import first_starts
from studies.layout_search.target import LoadedTarget, load_target
from studies.loop.learning import MODEL, Simulators
from studies.loop.measuring import ASKED, Waiting
from studies.loop.record import LoopOutcome, Turn, loop_content, stop_reason, write_report
from studies.loop.turn import SEARCH, Loop, TurnSteps
from studies.study import Running, StudyRun, simulator

_FACTORS, _EFFECTS = 7, 45  # unknowns of a calibration, and about of a trace


def run_loop(
    study: LoopStudy | Path | str,
    out: Path | str,
    *,
    simulators: Simulators | None = None,
    progress: Callable[[str, float | None], None] = lambda line, share: None,
    **how: Unpack[Running],
) -> LoopOutcome:
    """Run turn after turn, until the study's rule ends it or a laboratory is waited for; writes `result.json`,
    `report.html`, the folders of the turns and, of the turn that came nearest as measured, `design.toml` and
    `pressures.csv` into `out`, and the last `model.toml`.

    The same study goes on where it stood. simulators: by points a side, for tests. seconds: of each search, in place of
    the study's. Raises InputError for bad input and for a laboratory's set that is not what was asked for.
    """
    run = StudyRun.of(study, LoopStudy.read, how)
    study = run.study
    targets = open_study(study)
    measured = study.source.folder if isinstance(study.source, Laboratory) else study.source.truth
    inputs = [*(target.file for target in study.search.targets), *([] if measured is None else [measured])]
    with run.folder(out, "loop", inputs) as work:
        checkpoint = Checkpoint(work, loop_content(study, targets))
        progress(loop_in_words(study), None)
        made = simulators or lru_cache(partial(simulator, study=study.search))
        outcome = _turns(Loop(study, targets, work, checkpoint, made, progress))
        outcome = replace(outcome, wall_s=checkpoint.spent)
        if work.anew and outcome.waiting_for is not None:
            work.complete = False
        with work.adding() as files:
            write_report(outcome, study, targets, work.folder, files)
    return outcome


def loop_in_words(study: LoopStudy) -> str:
    """Return what a loop does at most and about how long that takes, a laboratory's own time aside."""
    trials, design = study.trials, study.search.design
    turns, search = study.stop.turns + 1, study.search.limits.seconds
    motion = [trials.seconds] * (trials.number + 1)
    measuring = 0.0
    if isinstance(study.source, VirtualRig):
        cloth = design.fabric.width * design.fabric.height
        measuring = sum(rig_seconds(one, cloth) for one in motion) / cores()
    fits = 0.0
    for turn in range(1, turns):  # of all that was measured so far
        fits += fit_seconds(CALIBRATION, motion * turn, _FACTORS, study.points_per_side)
        fits += fit_seconds(TRACE, motion * turn, _EFFECTS, study.learning.trace_grid) if study.learning.trace else 0.0
    what = f"at most {turns} designs", f"{search:g} s of search and {len(motion)} trials for each", on_cores()
    return in_words(turns * (search + measuring) + fits, *what)


def open_study(study: LoopStudy) -> tuple[LoadedTarget, ...]:
    """Return the study's targets. Raises InputError where they, the start, or the rig's ground truth are not sound."""
    search = study.search
    targets = tuple(load_target(target, search.design, seed=search.seed) for target in search.targets)
    if study.rig_limits.rate < float("inf") and any(target.time is not None for target in targets):
        raise InputError(
            f"{search.name}: a target is a frame of a motion under steps, which a rig with a rate cannot run; expected "
            "a shape at rest, or rig_limits without a rate"
        )
    first_starts(search)
    if isinstance(study.source, VirtualRig) and study.source.truth is not None:
        from studies.rig import read_ground_truth

        read_ground_truth(study.source.truth)
    return targets


def _turns(loop: Loop) -> LoopOutcome:
    """Choose, measure, calibrate, trace, train, choose again."""
    study, sets, done = loop.study, list[MeasurementSet](), list[Turn]()
    model, earlier, synthetic = study.search.model, None, False

    def outcome(**more: Any) -> LoopOutcome:
        source = "rig" if isinstance(study.source, VirtualRig) else "laboratory"
        name, seed = study.search.name, study.search.seed
        return LoopOutcome(name, tuple(done), seed=seed, source=source, synthetic=synthetic, **more)

    for number in range(study.stop.turns + 1):
        turn = TurnSteps(loop, number)
        chosen = turn.choose(model, earlier)
        try:
            measured = turn.measure()
        except Waiting:
            assert isinstance(study.source, Laboratory)
            done.append(Turn(number, turn.name, chosen))
            return outcome(waiting_for=str(study.source.folder / turn.name), asked=str(turn.folder / ASKED))
        sets.append(measured)
        synthetic = synthetic or "synthetic" in measured.description
        device = turn.evaluate(measured)
        before = [from_mm(one.device["excess"]) for one in done if one.device]
        if ended := stop_reason(study.stop, [*before, from_mm(device["excess"])]):
            done.append(Turn(number, turn.name, chosen, device))
            break
        done.append(Turn(number, turn.name, chosen, device, turn.learn(sets, model)))
        model, earlier = turn.model, turn.chosen
        _keep_best(loop, outcome())
    assert ended is not None  # the rule ends the last turn
    _keep_best(loop, outcome())
    return outcome(stop_reason=ended)


def _keep_best(loop: Loop, outcome: LoopOutcome) -> None:
    """Copy the nearest turn's design and pressures, and the model that was learned last, up."""
    best, learned = outcome.best, [turn.name for turn in outcome.turns if turn.learned]
    assert best is not None
    source = loop.work.folder / best.name / SEARCH
    files = {file.name: file for file in source.glob("pressures*.csv")}
    if learned:
        last = loop.work.folder / learned[-1]
        files |= {file.name: file for file in (last / MODEL, *last.glob("*.safetensors"))}
    with loop.work.adding() as place:
        write_design(read_design(source / "design.toml"), place / "design.toml")
        for name, file in files.items():
            (place / name).write_bytes(file.read_bytes())

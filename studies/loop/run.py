"""`fabdesign loop STUDY`: from a target and a start design to one that was measured, turn by turn."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.measurement_set import read_set
from fabdesign.formats.json_file import write_json
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import WorkFolder, work_folder
from fabdesign.runtime.effort import CALIBRATION, TRACE, cores, fit_seconds, in_words, on_cores, rig_seconds
from fabdesign.runtime.store import Checkpoint
from fabdesign.study_files.loop_file import Laboratory, LoopStudy, VirtualRig, read_loop
from fabdesign.study_files.study_file import require_searchable
from fabdesign.units import from_mm, in_mm
from optimize.search.evaluations import Evaluations
from studies.layout_search.first_layouts import first_starts
from studies.layout_search.target import LoadedTarget, load_target
from studies.loop.learning import MODEL, Simulators, learn, model_of
from studies.loop.measuring import ASKED, MEASURED, measured, programs_for
from studies.loop.record import (
    ChosenDesign,
    DeviceErrors,
    Learned,
    LoopOutcome,
    Turn,
    loop_content,
    stop_reason,
    write_report,
)
from studies.loop.turn import SEARCH, Choice, choose, chosen, errors_on_device, turn_name

Progress = Callable[[str, float], None]  # what is done, and about what share of all


_FACTORS, _EFFECTS = 7, 45  # unknowns of a calibration, and about of a trace


class _Waiting(Exception):
    """A turn that waits for a laboratory."""


@dataclass(frozen=True)
class _Loop:
    """The study, the record and the rig that all turns share."""

    study: LoopStudy
    targets: tuple[LoadedTarget, ...]
    work: WorkFolder
    checkpoint: Checkpoint
    simulators: Simulators
    progress: Progress

    def say(self, number: int, line: str, part: float) -> None:
        """part: of the turn, done."""
        share = min(1.0, (number + part) / (self.study.stop.turns + 1))
        self.progress(f"{turn_name(number).replace('_', ' ')}, {line}", share)


def run_loop(
    study: LoopStudy | Path | str,
    out: Path | str,
    *,
    simulators: Simulators | None = None,
    seconds: float | None = None,
    force: bool = False,
    progress: Progress = lambda line, share: None,
) -> LoopOutcome:
    """Run turn after turn, until the study's rule ends it or a laboratory is waited for; writes `result.json`,
    `report.html`, the folders of the turns and, of the turn that came nearest as measured, `design.toml` and
    `pressures.csv` into `out`, and the last `model.toml`.

    The same study goes on where it stood. simulators: by points a side, for tests. seconds: of each search, in place of
    the study's. Raises InputError for bad input and for a laboratory's set that is not what was asked for.
    """
    inputs = [] if isinstance(study, LoopStudy) else [Path(study)]
    study = study if isinstance(study, LoopStudy) else read_loop(study)
    if seconds is not None:
        limits = replace(study.search.limits, seconds=seconds)
        study = replace(study, search=replace(study.search, limits=limits))
    targets = open_study(study)
    inputs += [target.file for target in study.search.targets]
    if isinstance(study.source, VirtualRig) and study.source.truth is not None:
        inputs.append(study.source.truth)
    if isinstance(study.source, Laboratory):
        inputs.append(study.source.folder)
    with work_folder(out, made_by="loop", force=force, inputs=inputs) as work:
        checkpoint = Checkpoint(work, loop_content(study, targets))
        loop = _Loop(study, targets, work, checkpoint, simulators or _simulators(study), progress)
        outcome = _turns(loop)
        outcome = replace(outcome, wall_s=checkpoint.spent)
        if work.anew and outcome.waiting_for is not None:
            work.complete = False
        with work.adding() as files:
            write_json(files / "result.json", outcome.as_json())
            write_report(outcome, study, targets, work.folder, files)
    return outcome


def loop_in_words(study: LoopStudy, seconds: float | None = None) -> str:
    """Return what a loop does at most and about how long that takes, a laboratory's own time aside. seconds: of each
    search, in place of the study's."""
    trials, design = study.trials, study.search.design
    turns, search = study.stop.turns + 1, seconds or study.search.limits.seconds
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
    require_searchable(search, search.name)
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


def _simulators(study: LoopStudy) -> Simulators:
    made: dict[int, ForwardModel] = {}

    def simulator(points_per_side: int) -> ForwardModel:
        if points_per_side not in made:
            from sim import Simulator  # here: it loads and starts taichi

            made[points_per_side] = Simulator(points_per_side, rise=study.search.rise, hold=study.search.hold)
        return made[points_per_side]

    return simulator


def _turns(loop: _Loop) -> LoopOutcome:
    study = loop.study
    turns: list[Turn] = []
    sets: list[MeasurementSet] = []
    model: Model | None = study.search.model
    earlier: Choice | None = None
    outcome = LoopOutcome(
        name=study.search.name,
        turns=(),
        seed=study.search.seed,
        source="rig" if isinstance(study.source, VirtualRig) else "laboratory",
    )
    for number in range(study.stop.turns + 1):
        name = turn_name(number)
        kept, choice = _chosen(loop, number, model, earlier)
        measured = _measured(loop, number, choice)
        if measured is None:
            assert isinstance(study.source, Laboratory)
            return replace(
                outcome,
                turns=(*turns, Turn(number, name, kept)),
                waiting_for=str(study.source.folder / name),
                asked=str(loop.work.folder / name / ASKED),
            )
        sets.append(measured)
        outcome = replace(outcome, synthetic=outcome.synthetic or "synthetic" in measured.description)
        device = _measured_errors(loop, number, choice, measured)
        reason = stop_reason(
            study.stop, [*(from_mm(t.device["excess"]) for t in turns if t.device), from_mm(device["excess"])]
        )
        if reason is not None:
            turns.append(Turn(number, name, kept, device))
            outcome = replace(outcome, turns=tuple(turns), stop_reason=reason)
            _keep_best(loop, outcome, number)
            return outcome
        learned = _learned(loop, number, sets, model)
        turns.append(Turn(number, name, kept, device, learned))
        model, earlier = model_of(loop.work, name), choice
        _keep_best(loop, replace(outcome, turns=tuple(turns)), number + 1)
    raise AssertionError  # the rule ends the last turn


def _chosen(loop: _Loop, number: int, model: Model | None, earlier: Choice | None) -> tuple[ChosenDesign, Choice]:
    name = turn_name(number)
    folder = loop.work.folder / name / SEARCH

    def told(evaluations: Evaluations) -> None:
        best = "none yet" if evaluations.best is None else f"{in_mm(evaluations.best.value):.2f} mm"
        loop.say(number, f"choosing a design: best {best}", 0.3 * evaluations.share)

    loop.work.claim(f"{name}/shapes.npz")
    kept = loop.checkpoint.get(
        f"{name}_choice",
        lambda: choose(loop.study, model, earlier, folder, loop.simulators, progress=told),
        files=lambda value: chosen(value, folder),
    )
    return kept, chosen(kept, folder)


def _measured(loop: _Loop, number: int, choice: Choice) -> MeasurementSet | None:
    name = turn_name(number)
    last = number == loop.study.stop.turns
    times = [target.time for target in loop.targets]
    asked = programs_for(loop.study, choice.design, choice.pressures, times, seed=number, last=last)

    def counted(done: int, total: int) -> None:
        loop.say(number, f"measuring: {done} of {total} trials", 0.3 + 0.3 * done / total)

    def measure() -> dict[str, int]:
        loop.say(number, "measuring", 0.3)
        if measured(loop.study, name, asked, loop.work, progress=counted) is None:
            raise _Waiting
        return {"trials": len(asked.programs)}

    try:
        loop.checkpoint.get(
            f"{name}_measurement",
            measure,
            files=lambda _: [trial.load() for trial in read_set(loop.work.folder / name / MEASURED).trials],
        )
    except _Waiting:
        return None
    return read_set(loop.work.folder / name / MEASURED)


def _measured_errors(loop: _Loop, number: int, choice: Choice, measured: MeasurementSet) -> DeviceErrors:
    loop.say(number, "evaluating the shape on the device", 0.6)
    kept: DeviceErrors = loop.checkpoint.get(
        f"{turn_name(number)}_device", lambda: errors_on_device(loop.study, choice, measured, loop.targets, loop.work)
    )
    return kept


def _learned(loop: _Loop, number: int, sets: Sequence[MeasurementSet], model: Model | None) -> Learned:
    def teach() -> Learned:
        return learn(
            loop.study,
            sets,
            model or Model(points_per_side=loop.study.points_per_side),
            loop.work,
            turn_name(number),
            loop.simulators,
            say=lambda line: loop.say(number, line, 0.7),
        )

    name = turn_name(number)
    kept: Learned = loop.checkpoint.get(f"{name}_model", teach, files=lambda _: model_of(loop.work, name))
    return kept


def _keep_best(loop: _Loop, outcome: LoopOutcome, learned: int) -> None:
    """Copy the nearest turn's design and pressures, and the last turn's model, up."""
    best = outcome.best
    assert best is not None
    source = loop.work.folder / best.name / SEARCH
    files = {file.name: file for file in source.glob("pressures*.csv")}
    if learned:
        last = loop.work.folder / turn_name(learned - 1)
        files |= {file.name: file for file in (last / MODEL, *last.glob("*.safetensors"))}
    with loop.work.adding() as place:
        write_design(read_design(source / "design.toml"), place / "design.toml")
        for name, file in files.items():
            (place / name).write_bytes(file.read_bytes())

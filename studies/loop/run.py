"""`fabdesign loop STUDY`: from a target and a start design to one that was measured, turn by turn.

In a turn a design is chosen with what is known, measured, evaluated on the device, and learned from. Each step is kept
as a piece of the loop's folder, by which it goes on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar, Unpack

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import WorkFolder
from fabdesign.runtime.effort import CALIBRATION, TRACE, cores, fit_seconds, in_words, on_cores, rig_seconds
from fabdesign.runtime.store import Checkpoint, read_arrays, write_arrays
from fabdesign.study_files.loop_file import Laboratory, LoopStudy, VirtualRig
from fabdesign.study_files.study_file import EarlierResult, result_in
from fabdesign.units import from_mm, in_mm
from optimize.fit.descent import Progress
from optimize.search.evaluations import Evaluations
from studies.layout_search.first_layouts import COARSE, first_starts
from studies.layout_search.target import LoadedTarget, load_target, target_errors
from studies.layouts import run_study
from studies.loop.learning import MODEL, Lesson, Simulators
from studies.loop.measuring import ASKED, MEASURED, Waiting, measure, programs_for
from studies.loop.record import (
    ChosenDesign,
    Learned,
    LoopOutcome,
    ShapeErrors,
    Turn,
    loop_content,
    shape_errors,
    stop_reason,
    write_report,
)
from studies.loop.resting_shape import measured_shapes
from studies.study import Running, StudyRun, simulator

SEARCH = "search"  # the folder of the turn's search, what `optimize` writes
SHAPES = "shapes.npz"  # believed and device, (poses, 2 n, 3) m
_FACTORS, _EFFECTS = 7, 45  # unknowns of a calibration, and about of a trace
Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Loop:
    """The study, the record and the rig that all turns share."""

    study: LoopStudy
    targets: tuple[LoadedTarget, ...]
    work: WorkFolder
    checkpoint: Checkpoint
    simulators: Simulators
    progress: Progress


@dataclass(frozen=True)
class TurnSteps:
    """The steps of one turn."""

    loop: Loop
    number: int

    @property
    def name(self) -> str:
        return f"turn_{self.number}"

    @property
    def folder(self) -> Path:
        return self.loop.work.folder / self.name

    def _say(self, line: str, part: float) -> None:
        """Say how far the turn is. part: of it, done."""
        share = min(1.0, (self.number + part) / (self.loop.study.stop.turns + 1))
        self.loop.progress(f"{self.name.replace('_', ' ')}, {line}", share)

    def _kept(self, piece: str, compute: Callable[[], Kept], files: Callable[[Any], object] | None = None) -> Kept:
        """Return a piece of the turn. files: reads what belongs to it and lies in files."""
        kept: Kept = self.loop.checkpoint.get(f"{self.name}_{piece}", compute, files=files)
        return kept

    def choose(self, model: Model | None, earlier: EarlierResult | None) -> ChosenDesign:
        """Search with `model`, from the design of the turn before besides all else; goes on where it was killed. What
        the record keeps of it, mm and kPa. Raises KeyboardInterrupt where it is interrupted."""
        study, simulators = self.loop.study, self.loop.simulators
        fine = min(study.points_per_side, POINTS_PER_SIDE)
        if model is not None and model.parameters:  # factors belong to their grid
            fine = model.points_per_side

        def show(evaluations: Evaluations) -> None:
            best = "none yet" if evaluations.best is None else f"{in_mm(evaluations.best.value):.2f} mm"
            self._say(f"choosing a design: best {best}", 0.3 * evaluations.share)

        def search() -> ChosenDesign:
            result = run_study(
                replace(study.search, model=model, earlier=earlier or study.search.earlier),
                self.folder / SEARCH,
                forward=simulators(fine),
                coarse=simulators(min(COARSE, study.points_per_side)),
                progress=show,
            )
            if result.interrupted:
                raise KeyboardInterrupt
            write_arrays(self.folder / SHAPES, {"believed": result.points.astype(np.float32)})
            return {
                "believed": shape_errors(result.errors),
                "stop_reason": result.stop_reason,
                "evaluations": len(result.history),
                "reach": result.reach.sentences,
                "muscles": len(result.design.muscles),
            }

        self.loop.work.claim(f"{self.name}/{SHAPES}")
        return self._kept("choice", search, files=lambda _: (self.chosen, self._believed))

    @property
    def chosen(self) -> EarlierResult:
        """Return the chosen design with its pressures."""
        return result_in(self.folder / SEARCH)

    @property
    def _believed(self) -> Array:
        """Return the shapes (poses, 2 n, 3) m that the search predicted."""
        return read_arrays(self.folder / SHAPES)["believed"].astype(np.float64)

    def measure(self) -> MeasurementSet:
        """Return what was measured of the chosen design. Raises Waiting where a laboratory was asked for it."""
        loop, chosen = self.loop, self.chosen
        times, last = [target.time for target in loop.targets], self.number == loop.study.stop.turns
        asked = programs_for(loop.study, chosen.design, chosen.pressures, times, seed=self.number, last=last)

        def counted(done: int, total: int) -> None:
            self._say(f"measuring: {done} of {total} trials", 0.3 + 0.3 * done / total)

        def ask() -> dict[str, int]:
            self._say("measuring", 0.3)
            measure(loop.study, self.name, asked, loop.work, progress=counted)
            return {"trials": len(asked.programs)}

        place = self.folder / MEASURED
        self._kept("measurement", ask, files=lambda _: [trial.load() for trial in read_set(place).trials])
        return read_set(place)

    def evaluate(self, measured: MeasurementSet) -> ShapeErrors:
        """Return errors of the measured shapes against the targets, mm: the same measures, with the same floors, as of
        the predicted shapes; and how far they are from those. Raises InputError where no shape was found."""
        loop, believed = self.loop, self._believed
        seed = loop.study.search.seed

        def compute() -> ShapeErrors:
            shapes = measured_shapes(measured, loop.targets, believed, seed=seed)
            if not np.isfinite(shapes).all():
                raise InputError(f"{measured.name}: no cloth lies through its points; expected measured clouds of one")
            errors = target_errors(loop.targets, shapes, measured.trials[0].design, seed=seed)
            apart = np.sqrt(np.square(shapes - believed).sum(axis=-1).mean())
            loop.work.claim(f"{self.name}/{SHAPES}")
            both = {"believed": believed.astype(np.float32), "device": shapes.astype(np.float32)}
            write_arrays(self.folder / SHAPES, both)
            return shape_errors(errors, from_believed=in_mm(float(apart)))

        self._say("evaluating the shape on the device", 0.6)
        return self._kept("device", compute)

    def learn(self, sets: Sequence[MeasurementSet], known: Model | None) -> Learned:
        """Learn from the sets of all turns so far. known: the model that the design was chosen with."""
        loop = self.loop
        known = known or Model(points_per_side=loop.study.points_per_side)
        lesson = Lesson(loop.study, sets, loop.work, self.name, loop.simulators, lambda line: self._say(line, 0.7))
        return self._kept("model", lambda: lesson.learn(known), files=lambda _: self.model)

    @property
    def model(self) -> Model:
        """Return what was learned in the turn."""
        return read_model(self.folder / MODEL)


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
    files = [*source.glob("pressures*.csv")]
    if learned:
        last = loop.work.folder / learned[-1]
        files += [last / MODEL, *last.glob("*.safetensors")]
    with loop.work.adding() as place:
        write_design(read_design(source / "design.toml"), place / "design.toml")
        for file in files:
            (place / file.name).write_bytes(file.read_bytes())

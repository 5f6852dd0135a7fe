"""One turn of a loop: a design is chosen with what is known, measured, evaluated on the device, and learned from. Each
step is kept as a piece of the loop's folder, by which it goes on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import WorkFolder
from fabdesign.runtime.store import Checkpoint, read_arrays, write_arrays
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.study_files.study_file import EarlierResult, result_in
from fabdesign.units import in_mm
from optimize.fit.descent import Progress
from optimize.search.evaluations import Evaluations
from studies.layout_search.first_layouts import COARSE
from studies.layout_search.target import LoadedTarget, target_errors
from studies.layouts import run_study
from studies.loop.learning import MODEL, Lesson, Simulators
from studies.loop.measuring import MEASURED, measure, programs_for
from studies.loop.record import ChosenDesign, Learned, ShapeErrors, shape_errors
from studies.loop.resting_shape import resting_faces

AT_REST = 0.5  # s, the last of a trial in which a cloth counts as at rest
SEARCH = "search"  # the folder of the turn's search, what `optimize` writes
SHAPES = "shapes.npz"  # believed and device, (poses, 2 n, 3) m
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

    def _kept(self, piece: str, compute: Callable[[], Kept], files: Callable[[], object] | None = None) -> Kept:
        """Return a piece of the turn. files: reads what belongs to it and lies in files."""
        kept: Kept = self.loop.checkpoint.get(f"{self.name}_{piece}", compute, files=files and (lambda _: files()))
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
        return self._kept("choice", search, files=lambda: (self.chosen, self._believed))

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
        self._kept("measurement", ask, files=lambda: [trial.load() for trial in read_set(place).trials])
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
        return self._kept("model", lambda: lesson.learn(known), files=lambda: self.model)

    @property
    def model(self) -> Model:
        """Return what was learned in the turn."""
        return read_model(self.folder / MODEL)


def measured_shapes(measured: MeasurementSet, targets: Sequence[LoadedTarget], predicted: Array, *, seed: int) -> Array:
    """Return (poses, 2 n, 3) m: the cloth's faces in the trials of orders 0, 1, ..., one a target: at rest in the last
    half second, or in the frame at the target's time. predicted: (poses, 2 n, 3) m, as the search had them."""
    by_order = {trial.order: trial for trial in measured.trials}
    shapes = []
    for pose, target in enumerate(targets):
        trial = by_order[pose]
        data = trial.load()
        if target.time is None:
            frames = np.flatnonzero(data.time > data.time[-1] - AT_REST)
        else:
            frames = np.array([np.abs(data.time - target.time).argmin()])
        points = np.concatenate([data.frames[int(k)] for k in frames])
        shapes.append(resting_faces(points, trial.design.fabric, predicted[pose], seed=seed))
    return np.array(shapes)

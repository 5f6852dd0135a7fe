"""A study of a target that moves, from its file to its folder."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import read_csv, write_pressures
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import require_pressures
from fabdesign.output import WorkFolder, work_folder
from fabdesign.runtime import working_time
from fabdesign.runtime.effort import in_words, on_cores
from fabdesign.runtime.fingerprint import content_of, sha256
from fabdesign.runtime.store import Arrays, Checkpoint
from fabdesign.study_files.follow_file import FollowStudy, read_follow
from fabdesign.units import in_mm
from fabdesign.version import SIMULATOR
from optimize.fit.descent import Progress
from optimize.search.evaluations import Evaluations
from sim import Simulator
from studies.follow.layout import chosen_layout
from studies.follow.measured import MeasuredRun, displacements, read_run
from studies.follow.programs import Regulator, case_of, regulator_of
from studies.follow.report import write_report
from studies.follow.result import FollowResult
from studies.follow.scatter import copies_of
from studies.follow.start import quasi_static
from studies.follow.target import files_of, wanted_of
from studies.follow.wanted import Wanted
from studies.follow.windows import Effort, FollowTask, solve
from studies.layout_search.target import pose_errors
from studies.prediction.forward_model import forward_model, without_resistance

Array = NDArray[np.float64]
ALGORITHM = 1  # of what a study's folder keeps: raised where it is no longer what this code would compute
PRESSURES = "pressures.csv"
COARSE = 21  # points a side of the first pass
STEPS = 4, 4  # of Gauss-Newton, of a window, in each pass
DRAWS = 4  # of a noise floor, at each instant
SECONDS = 9.0  # of one core, that a pass takes for a second of motion and a channel at COARSE points


class _Used(Exception):
    """The time limit."""


def run_follow(
    study: FollowStudy | Path | str,
    out: Path | str,
    *,
    measured: Path | str | None = None,
    seconds: float | None = None,
    force: bool = False,
    progress: Callable[[str, float | None], None] = lambda line, share: None,
) -> FollowResult:
    """Find the study's pressures over time and write `result.json`, `pressures.csv` and `report.html` into `out`.

    measured: of the folder's last program, run on the device: a set or a trial. Then the program is corrected by what
    was measured; the one before becomes `pressures_K.csv`. The same study goes on in its folder, window by window.
    Raises InputError, and SimulationError where no motion can be computed.
    """
    inputs = [] if isinstance(study, FollowStudy) else [study]
    study = study if isinstance(study, FollowStudy) else read_follow(study)
    study = study if seconds is None else replace(study, seconds=seconds)
    wanted, regulator = wanted_of(study), regulator_of(study)
    file = os.path.relpath(inputs[0], out).replace(os.sep, "/") if inputs else None
    if measured is not None and not (Path(out) / PRESSURES).is_file():
        raise InputError(f"{out}: no {PRESSURES}; expected the folder of a study whose program was run")
    inputs += [*files_of(study), *([measured] if measured is not None else [])]
    with work_folder(out, made_by="follow", force=force, inputs=inputs) as work:
        checkpoint = Checkpoint(work, _content(study))
        progress(follow_in_words(study, wanted), None)
        if study.layout is not None:
            study = _with_layout(study, wanted, regulator, work, progress)
            regulator = regulator_of(study)
        run = None if measured is None else _last_run(work, Path(measured), study)
        solver = _Solver(study, wanted, regulator, checkpoint, progress)
        result = solver.found() if run is None else solver.corrected(*run)
        with work.adding() as files:
            if study.layout is not None:
                write_design(study.design, files / "design.toml")
            if run is not None:
                write_pressures(regulator.program(run[2]), files / f"pressures_{result.run}.csv")
            write_pressures(result.program, files / PRESSURES)
            write_report(result, files, file)
    return result


def _with_layout(
    study: FollowStudy, wanted: Wanted, regulator: Regulator, work: WorkFolder, progress: Progress
) -> FollowStudy:
    """Return the study with the design that a search finds, as the rig can drive it."""

    def show(at: Evaluations) -> None:
        best = "none yet" if at.best is None else f"{in_mm(at.best.value):.3f} mm"
        progress(f"a layout for shapes at rest: best {best}", 0.0)

    design = chosen_layout(study, wanted, regulator, work, show)
    if study.rig.channels is not None and design.channels > study.rig.channels:
        raise InputError(f"{study.name}: the layout has {design.channels} channels; the rig has {study.rig.channels}")
    return replace(study, design=design)


def follow_in_words(study: FollowStudy, wanted: Wanted) -> str:
    """Return what a study computes and about how long that takes."""
    length = float(wanted.times[-1]) * study.design.channels
    fine = (study.points_per_side / COARSE) ** 1.2
    what = f"{float(wanted.times[-1]):.3g} s of motion, {len(wanted.times)} instants, {study.design.channels} channels"
    return in_words(SECONDS * length * (1 + fine), what, on_cores())


class _Solver:
    """A study at work: passes over its windows, and what comes of them."""

    def __init__(
        self, study: FollowStudy, wanted: Wanted, regulator: Regulator, checkpoint: Checkpoint, progress: Progress
    ) -> None:
        self._study, self._wanted, self._regulator = study, wanted, regulator
        self._checkpoint, self._progress = checkpoint, progress
        self._begun = working_time.seconds()
        self._model = study.model or Model()
        self._cycles = regulator.cycles(float(wanted.times[-1]))
        self._case = case_of(study, regulator.program(np.zeros((self._cycles, regulator.channels))))

    def found(self) -> FollowResult:
        """Return the study's own answer."""
        self._progress("pressures of shapes at rest", 0.0)
        start = self._checkpoint.arrays("start", lambda: {"pressures": self._start()})["pressures"]
        begun = float(np.mean([own.surface_rms for own in self._errors(self._motion(start))]))
        program, complete = start, True
        try:
            for number, grid in enumerate((COARSE, self._study.points_per_side)):
                program = self._pass(f"pass_{number}", program, grid, STEPS[number], None)
        except _Used as used:
            program, complete = used.args[0], False
        return self._result(program, begun, complete)

    def corrected(self, run: MeasuredRun, number: int, program: Array) -> FollowResult:
        """Return the answer to a measured motion of `program`, in which the model's own changes are asked of it
        (iterative learning control: Bristow et al. 2006)."""
        motion = self._motion(program)
        beside, seen = displacements(run, motion, self._wanted.times, face=self._wanted.targets[0].face)
        if not seen.any():
            raise InputError(f"{run.file}: no frame at a wanted instant; expected the motion of this study")
        measured = self._errors(motion + beside)
        off = float(np.mean([own.surface_rms for own, there in zip(measured, seen, strict=True) if there]))
        name = f"run_{number}_{sha256(run.file)[:12]}"
        corrected = self._pass(name, program, self._study.points_per_side, STEPS[1], beside)
        result = self._result(corrected, off, complete=True, beside=beside)
        return replace(result, run=number, measured_error=off)

    def _start(self) -> Array:
        if self._study.start is not None:
            return self._regulator.kept(self._regulator.rows(self._study.start, self._cycles))
        predictor = self._predictor(COARSE)
        easy = without_resistance(predictor) or predictor
        case = replace(self._case, effects=())
        return quasi_static(easy, case, self._wanted, self._regulator, self._cycles)

    def _pass(self, name: str, program: Array, grid: int, steps: int, beside: Array | None) -> Array:
        """Return the program after all windows. Raises _Used, with the program so far, where the time is used."""
        predictor = self._predictor(grid)
        lacks = self._lacks(program, grid)
        if beside is not None:
            lacks = beside if lacks is None else lacks + beside
        task = FollowTask(predictor.case(self._case), self._wanted, self._regulator, lacks)
        so_far = program.copy()

        def keep(window: str, compute: Callable[[], Array]) -> Array:
            piece = f"{name}_{window}"
            if not self._checkpoint.has(piece) and self._is_over():
                raise _Used(self._regulator.kept(so_far))
            rows: Arrays = self._checkpoint.arrays(piece, lambda: {"pressures": compute()})
            first = int(window)
            so_far[first : first + len(rows["pressures"])] = rows["pressures"]
            return rows["pressures"]

        line = f"windows at {grid} points a side"
        solved = solve(
            task, program, Effort(Simulator(grid), steps), keep=keep,
            progress=lambda share: self._progress(line, share),
        )  # fmt: skip
        return self._regulator.kept(solved)

    def _is_over(self) -> bool:
        return self._study.seconds is not None and working_time.seconds() - self._begun >= self._study.seconds

    def _lacks(self, program: Array, grid: int) -> Array | None:
        """(K, 2 n, 3) m that a corrector adds to the motion of a program; None without one."""
        if self._model.corrector is None:
            return None
        case, times = self._driven(program), self._wanted.times
        corrected, simulated = (
            forward_model(Simulator(grid), model).motions([case], [times])[0]
            for model in (self._model, self._model.without(["corrector"]))
        )
        return corrected.astype(float) - simulated

    def _driven(self, program: Array) -> Case:
        return replace(self._case, program=self._regulator.program(program))

    def _predictor(self, grid: int) -> Predictor:
        return forward_model(Simulator(grid), self._model)

    def _motion(self, program: Array) -> Array:
        predictor = self._predictor(self._study.points_per_side)
        [motion] = predictor.motions([self._driven(program)], [self._wanted.times])
        if not np.isfinite(motion).all():
            raise SimulationError(f"design {self._study.design.name}: the motion diverges under the program found")
        return motion.astype(float)

    def _errors(self, motion: Array) -> list[Errors]:
        return pose_errors(self._wanted.targets, motion, seed=self._study.seed, draws=DRAWS)

    def _result(self, program: Array, begun: float, complete: bool, beside: Array | None = None) -> FollowResult:
        motion = self._motion(program)
        self._progress("copies with other pressures and models", 1.0)
        copies = copies_of(
            Simulator(COARSE),
            self._study.model,
            self._driven(program),
            self._wanted,
            self._study.scatter,
            self._study.seed,
        )
        shown = motion if beside is None else motion + beside
        seconds = working_time.seconds() - self._begun
        return FollowResult(
            self._study, self._wanted, self._regulator, program, shown, self._errors(shown), begun, copies, complete,
            seconds,
        )  # fmt: skip


def _last_run(work: WorkFolder, path: Path, study: FollowStudy) -> tuple[MeasuredRun, int, Array]:
    """Return the measured motion, its number, and the folder's program, which was run. Raises InputError."""
    file = work.folder / PRESSURES
    program = read_csv(file)
    require_pressures(program, study.design, str(file))
    number = 1
    while (work.folder / f"pressures_{number}.csv").is_file():
        number += 1
    regulator = regulator_of(study)
    return read_run(path, study.design), number, regulator.rows(program, regulator.cycles(program.duration))


def _content(study: FollowStudy) -> dict[str, str]:
    """What the pieces depend on, by field."""
    files = {f"target.{path.name}": sha256(path) for path in files_of(study) if path.is_file()}
    content = content_of(study, ("name", "seconds", "scatter", "target"), files)
    return {"simulator": str(SIMULATOR), "algorithm": str(ALGORITHM), "target": repr(study.target)} | content

"""A study of a target that moves, from its file to its folder."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Unpack

import numpy as np

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import read_csv, write_pressures
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.nouns.pressure import require_pressures
from fabdesign.output import WorkFolder
from fabdesign.runtime import working_time
from fabdesign.runtime.effort import in_words, on_cores
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import Arrays, Checkpoint
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.units import in_mm
from optimize.fit.descent import Progress
from sim import Simulator
from studies.follow.measured import MeasuredRun, displacements, read_run
from studies.follow.programs import case_of, regulator_of
from studies.follow.result import FollowResult, copies_of, write_report
from studies.follow.start import between_poses, quasi_static, with_layout
from studies.follow.wanted import GUIDED, Wanted, files_of, wanted_of
from studies.follow.windows import FollowTask, solve
from studies.layout_search.target import pose_errors
from studies.prediction.forward_model import forward_model, without_resistance
from studies.study import Running, StudyRun, kept_content

ALGORITHM = 3  # of what a study's folder keeps: raised where it is no longer what this code would compute
PRESSURES = "pressures.csv"
COARSE = 21  # points a side, with which a pass begins
QUICK = 1 / 960  # s, the time step of the simulator: twice its own
# of each pass: steps of Gauss-Newton of a window, time steps in one far from jumps, s of a window
PASSES = (2, 8, 0.3), (3, 4, 0.4), (3, 4, 0.4), (3, 4, 0.4)
NOISY = 1.02  # of the noise: an error so small is not lowered further
GAINED = 0.03  # of the error: a pass that gains less is the last one on its grid
DRAWS = 4  # of a noise floor, at each instant
SECONDS = 5.0  # of one core, that all takes for a second of motion and a channel at COARSE points


def run_follow(
    study: FollowStudy | Path | str,
    out: Path | str,
    *,
    measured: Path | str | None = None,
    progress: Callable[[str, float | None], None] = lambda line, share: None,
    **how: Unpack[Running],
) -> FollowResult:
    """Find the study's pressures over time and write `result.json`, `pressures.csv` and `report.html` into `out`.

    measured: of the folder's last program, run on the device: a set or a trial. Then the program is corrected by what
    was measured; the one before becomes `pressures_K.csv`. The same study goes on in its folder, window by window.
    Raises InputError, and SimulationError where no motion can be computed.
    """
    asked = StudyRun.of(study, FollowStudy.read, how)
    study = asked.study
    wanted = wanted_of(study)
    file = os.path.relpath(asked.inputs[0], out).replace(os.sep, "/") if asked.inputs else None
    if measured is not None and not (Path(out) / PRESSURES).is_file():
        raise InputError(f"{out}: no {PRESSURES}; expected the folder of a study whose program was run")
    with asked.folder(out, "follow", [*files_of(study), *([] if measured is None else [measured])]) as work:
        hashes = {f"target.{path.name}": sha256(path) for path in files_of(study) if path.is_file()}
        content = kept_content(study, ("name", "seconds", "scatter", "target"), hashes, ALGORITHM)
        checkpoint = Checkpoint(work, content | {"target": repr(study.target)})
        progress(follow_in_words(study, wanted), None)
        if study.layout is not None:
            study = with_layout(study, wanted, work, progress)
        last = None if measured is None else _last_program(work, study)
        run = None if measured is None else read_run(Path(measured), study.design)
        solver = _Solver(study, wanted, checkpoint, progress)
        result = solver.solution() if run is None or last is None else solver.corrected(run, *last)
        with work.adding() as files:
            if study.layout is not None:
                write_design(study.design, files / "design.toml")
            if last is not None:
                write_pressures(result.regulator.program(last[1]), files / f"pressures_{result.run}.csv")
            write_pressures(result.program, files / PRESSURES)
            write_report(result, files, file)
    return result


def follow_in_words(study: FollowStudy, wanted: Wanted) -> str:
    """Return what a study computes and about how long that takes."""
    length = float(wanted.times[-1]) * study.design.channels
    what = f"{float(wanted.times[-1]):.3g} s of motion, {len(wanted.times)} instants, {study.design.channels} channels"
    return in_words(SECONDS * length * max(1.0, study.points_per_side / COARSE), what, on_cores())


class _Solver:
    """A study at work: passes over its windows, and what comes of them."""

    def __init__(self, study: FollowStudy, wanted: Wanted, checkpoint: Checkpoint, progress: Progress) -> None:
        self._study, self._wanted, self._regulator = study, wanted, regulator_of(study)
        self._checkpoint, self._progress = checkpoint, progress
        self._begun, self._complete = working_time.seconds(), True
        self._model, self._path = study.model or Model(), wanted
        self._asked = np.ones(len(wanted.times), dtype=bool)  # which instants of the path are wanted
        self._cycles = self._regulator.cycles(float(wanted.times[-1]))
        self._case = case_of(study, self._regulator.program(np.zeros((self._cycles, self._regulator.channels))))

    def solution(self) -> FollowResult:
        """Return the study's own answer."""
        start = self._begin()
        best = self._improved("pass", start)
        begin = self._driven(start)  # not before: a first answer does not wait for it
        return self._result(min(best, begin, key=lambda motion: motion.cost), begin.error)

    def corrected(self, run: MeasuredRun, number: int, program: Array) -> FollowResult:
        """Return the answer to a measured motion of `program`, in which the model's own changes are asked of it
        (iterative learning control: Bristow et al. 2006)."""
        if self._wanted.poses:  # the way between them is asked of it too
            self._begin()
        motion, times = self._motion(program), self._path.times
        beside, seen = displacements(run, motion, times, face=self._wanted.targets[0].face)
        if not (seen := seen & self._asked).any():
            raise InputError(f"{run.file}: no frame at a wanted instant; expected the motion of this study")
        begin = self._driven(program, beside)
        off = float(self._wanted.errors(times, begin.motion)[seen].mean())
        best = self._improved(f"run_{number}_{sha256(run.file)[:12]}", program, begin)
        return replace(self._result(best, off), run=number, measured_error=off)

    def _begin(self) -> Array:
        """Return the program to begin with, and take the way between poses from it."""
        self._progress("pressures of shapes at rest", 0.0)
        predictor = forward_model(Simulator(COARSE), self._model)
        case, easy = replace(self._case, effects=()), without_resistance(predictor) or predictor

        def begin() -> Arrays:
            if self._study.start is not None:
                return {"pressures": self._regulator.kept(self._regulator.rows(self._study.start, self._cycles))}
            return {"pressures": quasi_static(easy, case, self._wanted, self._regulator, self._cycles)}

        start = self._checkpoint.arrays("start", begin)["pressures"]
        self._path = between_poses(easy, case, self._wanted, self._regulator.program(start))
        self._asked = np.isin(self._path.times, self._wanted.times)
        return start

    def _improved(self, name: str, program: Array, best: "_Driven | None" = None) -> "_Driven":
        """Return the best program of some passes, as far as the time goes. Once a pass gains little, those that follow
        go on the study's own grid. best: how `program` moves the cloth, where that is known."""
        finest = self._study.points_per_side
        grid, beside = min(COARSE, finest), 0.0 if best is None else best.beside
        for number, (steps, calm, length) in enumerate(PASSES):
            if best is not None and (not self._complete or best.error <= NOISY * self._wanted.noise):
                break
            quick = Simulator(grid, time_step=QUICK, calm_steps=calm)
            program = program if best is None else best.program
            solved = self._pass(f"{name}_{number}", program, best, quick, steps, length)
            trial = self._driven(solved, beside)
            gained = 1.0 if best is None else 1 - trial.cost / best.cost
            best = trial if best is None or gained > 0 else best
            if gained < GAINED:
                if grid == finest:
                    break
                grid = finest
        assert best is not None
        return best

    def _pass(
        self, name: str, program: Array, at: "_Driven | None", simulator: Simulator, steps: int, length: float
    ) -> Array:
        """Return the program after all windows, as far as the time goes. at: how it moves the cloth, where that is
        known; what the quick motion lacks of it is added to all that follow."""
        predictor = forward_model(simulator, self._model.without(["corrector"]))
        lacks, line = None, f"windows at {simulator.points_per_side} points a side"
        if at is not None:
            [quick] = predictor.motions([self._case_of(program)], [self._path.times])
            lacks, line = np.nan_to_num(at.motion - quick), f"{in_mm(at.error):.3f} mm; {line}"
        task = FollowTask(predictor.case(self._case), self._path, self._regulator, simulator, lacks)
        until = np.inf if self._study.seconds is None else self._study.seconds

        def keep(window: str, compute: Callable[[], Array]) -> Array | None:
            piece = f"{name}_{window}"
            if not self._checkpoint.has(piece) and working_time.seconds() - self._begun >= until:
                self._complete = False
                return None
            return self._checkpoint.arrays(piece, lambda: {"pressures": compute()})["pressures"]

        show = partial(self._progress, line)
        return self._regulator.kept(solve(task, program, steps=steps, length=length, keep=keep, progress=show))

    def _case_of(self, program: Array) -> Case:
        return replace(self._case, program=self._regulator.program(program))

    def _motion(self, program: Array) -> Array:
        predictor = forward_model(Simulator(self._study.points_per_side), self._model)
        [motion] = predictor.motions([self._case_of(program)], [self._path.times])
        if not np.isfinite(motion).all():
            raise SimulationError(f"design {self._study.design.name}: the motion diverges under the program found")
        return motion.astype(float)

    def _driven(self, program: Array, beside: Array | float = 0.0) -> "_Driven":
        motion = self._motion(program) + beside
        errors, asked = self._path.errors(self._path.times, motion), self._asked
        cost = float(np.average(errors, weights=np.where(asked, 1.0, GUIDED)))
        return _Driven(program, motion, beside, float(errors[asked].mean()), cost)

    def _result(self, best: "_Driven", begun: float) -> FollowResult:
        self._progress("copies with other pressures and models", 1.0)
        study, wanted = self._study, self._wanted
        driven, motion = self._case_of(best.program), best.motion[self._asked]
        copies = copies_of(study, Simulator(COARSE), driven, wanted)
        errors = pose_errors(wanted.targets, motion, seed=study.seed, draws=DRAWS)
        seconds = working_time.seconds() - self._begun
        return FollowResult(
            study, wanted, self._regulator, best.program, motion, errors, begun, copies, self._complete, seconds
        )


@dataclass(frozen=True, eq=False)
class _Driven:
    """A program and its motion (K, 2 n, 3) m, to which what was measured `beside` it is added. error: m, the mean over
    what is wanted; cost: m, with the way between poses, by which programs are compared."""

    program: Array
    motion: Array
    beside: Array | float
    error: float
    cost: float


def _last_program(work: WorkFolder, study: FollowStudy) -> tuple[int, Array]:
    """Return the number of the run of the folder's program, and that program. Raises InputError."""
    file = work.folder / PRESSURES
    program = read_csv(file)
    require_pressures(program, study.design, str(file))
    number = next(k for k in count(1) if not (work.folder / f"pressures_{k}.csv").is_file())
    regulator = regulator_of(study)
    return number, regulator.rows(program, regulator.cycles(program.duration))

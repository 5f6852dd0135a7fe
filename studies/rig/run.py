"""The rig's one public way in: designs and pressure programs become a measurement set, and a recording."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError, SimulationError, note
from fabdesign.files.design_file import read_design
from fabdesign.files.measurement_set import NewTrial, write_set
from fabdesign.files.pressure_file import read_pressures
from fabdesign.files.trial_file import TrialData, program_of
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, require_pressures
from fabdesign.nouns.trial import Role
from fabdesign.output import new_file, new_folder
from fabdesign.runtime.cluster import current
from fabdesign.runtime.effort import LONGEST, MEMORY, in_words, on_cores, rig_seconds
from fabdesign.runtime.supervisor import uninterrupted
from studies.rig.cameras import measure, record
from studies.rig.scene import DEFAULT, Resolution, control_counts
from studies.rig.specimen import GroundTruth, TrialTask, control_points, prepare, read_ground_truth, with_effects_of

GUARD = 'in a script, call this under `if __name__ == "__main__":`'
WORKING_STRAIN = 0.02  # up to which a membrane curve's slope is the stiffness of the rig's linear cloth
THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Given = Path | str | Design
Program = Path | str | PressureProgram


@dataclass(frozen=True)
class RigSession:
    """A session of the rig: designs in their order, each with its pressure programs, a trial each. truth: of the
    specimen, or its file. The last `test_trials` trials of each design get role "test"."""

    designs: Sequence[tuple[Given, Sequence[Program]]]
    truth: Path | str | GroundTruth | None = None
    test_trials: int = 0
    resolution: Resolution = DEFAULT


def run_rig(
    session: RigSession,
    out: Path | str,
    *,
    recording: Path | str | None = None,
    workers: int | None = None,
    force: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
    say: Callable[[str], None] = lambda line: None,
) -> None:
    """Measure a session on the virtual rig into the set `out`.

    `recording`: a folder for the raw clouds of four virtual depth cameras of the first program; their true poses go
    beside it, to RECORDING.truth.json. force: replace folders that this program made, and that file. progress(done, of)
    is called after each trial; say with an estimate before. Raises InputError; studies.rig.motion.RigDiverged where a
    motion has no solution.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # what it is while a script is read again
        raise InputError(f"{out}: its trials are computed by processes that read the script again; {GUARD}")
    truth, test_trials, resolution = session.truth, session.test_trials, session.resolution
    inputs = [g for g in (truth, *(x for d, ps in session.designs for x in (d, *ps))) if isinstance(g, Path | str)]
    out, recording = Path(out), None if recording is None else Path(recording)
    truth = truth if isinstance(truth, GroundTruth) else GroundTruth() if truth is None else read_ground_truth(truth)
    read = [_read(*part, test_trials) for part in session.designs]
    for given in (design for design, _ in read if design.fabric.membrane_curve is not None):
        k1, k2 = linear_membrane(given).fabric.membrane_stiffness
        name, to = given.name, f"up to {WORKING_STRAIN:.0%} of strain"
        note(f"design {name}: the rig's cloth is linear; it takes {k1:.4g} N/m across and {k2:.4g} N/m down, {to}")
    designs = {design.name: design for design, _ in read}
    if len(designs) < len(read):
        twice = next(name for name in designs if sum(design.name == name for design, _ in read) > 1)
        raise InputError(f"design {twice}: two of this name; expected one of its own for each in a session")
    roles: list[Role] = [
        "test" if k >= len(programs) - test_trials else "fit" for _, programs in read for k in range(len(programs))
    ]
    pairs = [(design, program) for design, programs in read for program in programs]
    tasks = [_task(*pair, order, truth, resolution) for order, pair in enumerate(pairs)]
    workers = min(workers or os.cpu_count() or 1, require_room(tasks, resolution))

    def trials() -> Generator[NewTrial, None, None]:
        seconds = sum(rig_seconds(float(t.times[-1]), t.design.fabric.width * t.design.fabric.height) for t in tasks)
        say(in_words(seconds / workers, f"{len(tasks)} trials", on_cores()))
        with closing(shapes_of(tasks, workers)) as motions:
            for task, role, shapes in zip(tasks, roles, motions, strict=True):
                scene, rng = prepare(task), np.random.default_rng([task.truth.seed, task.order, 1])
                clouds = tuple(measure(scene, x, task.truth.sensing, rng) for x in shapes)
                data = TrialData(task.times, task.program.at(task.times - 1e-6), clouds)
                yield NewTrial(f"{task.order:03d}", task.design.name, task.order, role, data)
                progress(task.order + 1, len(tasks))

    name, rate = out.resolve().name, truth.sensing.frame_rate
    with (  # opened before anything is computed
        new_folder(out, made_by="rig", force=force, inputs=inputs) as unfinished,
        _recording_places(recording, out, force, inputs) as recorded,
        closing(trials()) as measured,
    ):
        description = "virtual rig; synthetic"
        write_set(unfinished, designs, measured, name=name, description=description, frame_rate=rate)
        if recorded is not None:
            record(tasks[0], *recorded)


def _read(given: Given, pressures: Sequence[Program], test_trials: int) -> tuple[Design, list[PressureProgram]]:
    design = given if isinstance(given, Design) else read_design(given)
    if not pressures:
        raise InputError(f"design {design.name}: no pressures; expected at least one program")
    if not 0 <= test_trials <= len(pressures):
        raise InputError(f"test_trials = {test_trials}; expected 0 to {len(pressures)}, the number of programs")
    return design, [p if isinstance(p, PressureProgram) else read_pressures(p, design) for p in pressures]


@contextmanager
def _recording_places(
    recording: Path | None, out: Path, force: bool, inputs: Sequence[Path | str]
) -> Iterator[tuple[Path, Path] | None]:
    """Yield where the recording, if any, and the true poses are to be written."""
    if recording is None:
        yield None
        return
    one, other = recording.resolve(), out.resolve()
    if one == other or one in other.parents or other in one.parents:
        raise InputError(f"recording {recording}: not apart from the set, {out}; expected folders beside each other")
    poses = recording.with_name(recording.name + ".truth.json")
    with (
        new_folder(recording, made_by="rig", force=force, inputs=inputs) as clouds,
        new_file(poses, force=force, inputs=inputs) as truth,
    ):
        yield clouds, truth


def _task(
    design: Design, program: PressureProgram, order: int, truth: GroundTruth, resolution: Resolution
) -> TrialTask:
    """Return the trial's frames, and the program as the trial's file will state it: a set point a frame interval."""
    require_pressures(program, design, f"program {order}")
    rate = truth.sensing.frame_rate
    if program.duration > LONGEST:
        raise InputError(f"program {order}: lasts {program.duration:g} s; expected at most {LONGEST:g} s")
    times = np.arange(1, max(1, round(program.duration * rate)) + 1) / rate
    rows = program.at(times - 1e-6)
    truth = with_effects_of(design, truth)
    return TrialTask(linear_membrane(design), program_of(times, rows), times, order, truth, resolution)


def linear_membrane(design: Design) -> Design:
    """Return a design without a membrane curve: in its place stands its stiffness from 0 to 2 % of strain."""
    curve = design.fabric.membrane_curve
    if curve is None:
        return design
    k1, k2 = (
        float(np.interp(WORKING_STRAIN, strain, tension) - np.interp(0.0, strain, tension)) / WORKING_STRAIN
        if strain
        else declared
        for strain, tension, declared in zip(curve.strain, curve.tension, design.fabric.membrane_stiffness, strict=True)
    )
    return replace(design, fabric=replace(design.fabric, membrane_curve=None, membrane_stiffness=(k1, k2)))


def shapes_of(tasks: Sequence[TrialTask], workers: int) -> Generator[Array, None, None]:
    """Yield control points of every task, in order; on a cluster, or on several cores where there are several tasks."""
    if (cluster := current()) is not None:
        yield from cluster.map(control_points, tasks, lambda task: f"trial {task.order} of {task.design.name}")
        return
    count = min(workers, len(tasks))
    if count == 1:
        yield from map(control_points, tasks)
        return
    with (
        _single_threaded_children(),
        ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=end_with_parent) as pool,
    ):
        try:
            with uninterrupted():
                shapes = pool.map(control_points, tasks)
            yield from shapes
        except BrokenProcessPool as error:
            raise SimulationError(f"a process that computed a trial was ended, or could not begin; {GUARD}") from error
        except BaseException:  # the pool would wait for the motions under way
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def end_with_parent() -> None:
    """End this worker with its parent, which it would outlive, waiting for ever. Ctrl-C is the parent's to answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _single_threaded_children() -> Iterator[None]:
    """Return a process a core: linear algebra threads of their own would only get in each other's way."""
    before = {name: os.environ.get(name) for name in THREAD_SETTINGS}
    os.environ.update(dict.fromkeys(THREAD_SETTINGS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_STEP = 48  # bytes of a control point and a step: position and velocity
_CONTROL = 360  # bytes of a control point and another in reach: the matrix, its factor and what they are made from
_FRAME, _POINT = 48, 120  # bytes of a frame: of each control point, and of each measured one


def require_room(tasks: Sequence[TrialTask], resolution: Resolution) -> int:
    """Return how many of the trials fit into memory at once. Raises InputError where one alone does not."""
    most = 0.0
    for task in tasks:
        controls, pairs = control_counts(task.design, resolution)
        kept = len(task.times) * (_FRAME * controls + _POINT * task.truth.sensing.points)
        steps = float(task.times[-1]) / resolution.step
        needed = steps * controls * _STEP + pairs * _CONTROL + kept  # bytes at the peak of the trial
        if needed > MEMORY:
            cloth = task.design.fabric
            raise InputError(
                f"program {task.order}: {task.times[-1]:g} s of a cloth of {cloth.width:g} by {cloth.height:g} m, "
                f"{len(task.times)} frames of {task.truth.sensing.points} points, take {needed / 1e9:.2g} GB on the "
                f"rig; expected at most {MEMORY / 1e9:g} GB"
            )
        most = max(most, needed)
    return max(1, int(2 * MEMORY / most))

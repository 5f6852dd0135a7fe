"""Motions on demand: one design under given pressures, or every trial of a set, as npz files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.measurement_set import Trial, read_set
from fabdesign.files.motion_file import Motion, write_motion
from fabdesign.formats.toml_file import file_stem
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import new_folder
from fabdesign.runtime.effort import batches, require_motion
from fabdesign.units import in_mm
from studies.intervals.calibrate import bands
from studies.prediction.forward_model import forward_model, laced_motions, sensed_model

AT_ONCE = 32  # motions in memory
_DIVERGED = "the motion diverged at {:.3f} s"


def frame_times(
    program: PressureProgram,
    *,
    frame_rate: float,
    duration: float | None = None,
    points_per_side: int = POINTS_PER_SIDE,
) -> NDArray[np.float64]:
    """Return (T,) s: k / frame_rate from rest (k = 0) to `duration` s, by default the program's. Raises InputError
    where a motion on a grid of `points_per_side` would take too much."""
    last = program.duration if duration is None else duration
    if not (0 < frame_rate < np.inf and 0 <= last < np.inf):
        raise InputError(f"duration = {last:g} s at frame rate {frame_rate:g} Hz; expected numbers above 0")
    require_motion(last, last * frame_rate + 1, points_per_side, channels=program.pressure.shape[1])
    return np.arange(int(last * frame_rate + 1e-6) + 1) / frame_rate


def require_motions(
    forward: ForwardModel,
    cases: Sequence[Case],
    times: Sequence[NDArray[np.float64]] | None,
    *,
    model: Model | None = None,
) -> list[Motion]:
    """Return the motion of each case with its muscles, without sensing effects; without times its shape at rest, as a
    motion of one frame. Raises InputError for a model with a part that cannot be used, SimulationError where a motion
    diverges, or no shape was found."""
    motions = laced_motions(forward_model(forward, model), cases, times)
    lost = "no shape at rest was found" if times is None else _DIVERGED
    for case, motion in zip(cases, motions, strict=True):
        _require_finite(motion, case.design.name, lost, _on_grid(forward, case.design))
    return motions


def predict(
    forward: ForwardModel,
    model: Model,
    trials: Sequence[Trial],
    out: Path,
    *,
    coarse: ForwardModel | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write `out/trials/NAME.npz` for every trial, as `predicted` gives it. `progress` is told trials done and in all.

    Raises InputError and SimulationError; then nothing is written.
    """
    with new_folder(out, made_by="predict") as unfinished:
        for done, (trial, motion) in enumerate(predicted(forward, model, trials, coarse=coarse), start=1):
            file = unfinished / "trials" / trial.file.name
            file.parent.mkdir(exist_ok=True)
            write_motion(file, motion.time, motion.points, size=motion.size, muscles=motion.muscles, band=motion.band)
            progress(done, len(trials))


def predicted(
    forward: ForwardModel, model: Model, trials: Sequence[Trial], *, coarse: ForwardModel | None = None
) -> Iterator[tuple[Trial, Motion]]:
    """Yield every trial with its motion at its own times, sensing effects included, and with its band where the model
    has intervals. coarse: a cheap simulator for the drawn models, by default `forward`. Raises InputError and
    SimulationError."""
    full = sensed_model(forward, model)
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    for part in batches([len(trial.times) for trial in trials], AT_ONCE):
        batch = trials[part]
        times = [trial.times for trial in batch]
        motions = laced_motions(full, cases[part], times)
        for trial, motion in zip(batch, motions, strict=True):
            _require_finite(motion, str(trial.file), _DIVERGED, _on_grid(forward, trial.design))
        around = bands(full, coarse or forward, cases[part], times, [motion.points for motion in motions])
        for trial, motion, band in zip(batch, motions, around, strict=True):
            yield trial, replace(motion, band=band)


def trials_of(source: MeasurementSet | Path, design: Design | None) -> tuple[str, tuple[Trial, ...]]:
    """Return the name and trials of a set, or of an npz, one trial, which needs its `design`. Raises InputError."""
    if isinstance(source, MeasurementSet):
        return source.name, source.trials
    if source.suffix == ".npz":
        if design is None:
            raise InputError(f"{source}: a lone trial; expected --design with its design file")
        return source.stem, (Trial(source, design.name, design, order=0, role="fit"),)
    if design is not None:
        raise InputError(f"{source}: a set names its own designs; expected no --design")
    measured = read_set(source)
    return measured.name, measured.trials


def folders_of(sources: Sequence[tuple[str, tuple[Trial, ...]]]) -> dict[str, tuple[Trial, ...]]:
    """Return where the motions of each source (name, trials) go: of a lone one to ".", else under its name.

    Raises InputError where two have one name.
    """
    if len(sources) == 1:
        return {".": sources[0][1]}
    folders: dict[str, tuple[Trial, ...]] = {}
    for name, trials in sources:
        if name in folders or file_stem(name) != name:
            raise InputError(f"set {name}: expected sets with a name of their own, good for a folder")
        folders[name] = trials
    return folders


def _require_finite(motion: Motion, what: str, lost: str, grid: str) -> None:
    """Raise SimulationError for a motion that holds NaN. lost: what that means, by the first such time [s]."""
    sound = np.isfinite(motion.points).all(axis=(1, 2))
    if not sound.all():
        raise SimulationError(f"{what}: {lost.format(motion.time[np.argmin(sound)])}{grid}; nothing written")


def _on_grid(forward: ForwardModel, design: Design) -> str:
    """Return the grid in words, with one that would follow the lacing where this one is wider; nothing of a forward
    model that has none."""
    side = getattr(forward, "points_per_side", None)
    if side is None:
        return ""
    size = max(design.fabric.width, design.fabric.height)
    pitch = min((muscle.fixed_point_pitch for muscle in design.muscles), default=size)
    grid, wide = f" on a grid of {side} points a side", size / (side - 1)
    if wide <= pitch * (1 + 1e-6):
        return grid
    enough = int(np.ceil(size / pitch - 1e-6)) + 1
    apart = f"{in_mm(wide):.3g} mm apart, wider than the fixed points' {in_mm(pitch):.3g} mm"
    return f"{grid}, {apart}; expected --grid {enough} or more"

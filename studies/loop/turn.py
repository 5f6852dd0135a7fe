"""One turn: a design is chosen with what is known, measured, and evaluated on the device."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design
from fabdesign.files.pressure_file import read_pressures
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.design import Design
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import WorkFolder
from fabdesign.runtime.store import read_arrays, write_arrays
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.study_files.study_file import EarlierResult
from fabdesign.units import from_mm, in_mm
from optimize.search.evaluations import Evaluations
from studies.layout_search.first_layouts import COARSE
from studies.layout_search.target import LoadedTarget, target_errors
from studies.layouts.run import run_study
from studies.loop.learning import Simulators
from studies.loop.record import ChosenDesign, DeviceErrors, ShapeErrors
from studies.loop.resting_shape import resting_faces

Array = NDArray[np.float64]


AT_REST = 0.5  # s, the last of a trial in which a cloth counts as at rest


def measured_shapes(measured: MeasurementSet, targets: Sequence[LoadedTarget], predicted: Array, *, seed: int) -> Array:
    """Return (poses, 2 n, 3) m: the cloth's faces in the trials of orders 0, 1, ..., one a target: at rest in the last
    half second, or in the frame at the target's time. predicted: (poses, 2 n, 3) m, as the search had them."""
    by_order = {trial.order: trial for trial in measured.trials}
    shapes = []
    for pose, target in enumerate(targets):
        trial = by_order[pose]
        data = trial.load()
        if target.time is None:
            chosen = np.flatnonzero(data.time > data.time[-1] - AT_REST)
        else:
            chosen = np.array([np.abs(data.time - target.time).argmin()])
        points = np.concatenate([data.frames[int(k)] for k in chosen])
        shapes.append(resting_faces(points, trial.design.fabric, predicted[pose], seed=seed))
    return np.array(shapes)


def device_errors(targets: Sequence[LoadedTarget], shapes: Array, measured: MeasurementSet, *, seed: int) -> Errors:
    """Return the errors of the measured shapes (poses, 2 n, 3) m against the targets: the same measures, with the same
    floors, as of the shapes that the search predicted. Raises InputError where no shape was found."""
    if not np.isfinite(shapes).all():
        raise InputError(f"{measured.name}: no cloth lies through its points; expected measured clouds of one")
    return target_errors(targets, shapes, measured.trials[0].design, seed=seed)


SEARCH = "search"  # the folder of the turn's search, what `optimize` writes
SHAPES = "shapes.npz"


@dataclass(frozen=True, eq=False)
class Choice:
    """The result of a turn's search. predicted: against the target, m; shapes (poses, 2 n, 3) m."""

    folder: Path
    design: Design
    pressures: Array  # (poses, channels) Pa
    predicted: Errors
    shapes: Array
    stop_reason: str


def turn_name(number: int) -> str:
    return f"turn_{number}"


def choose(
    study: LoopStudy,
    model: Model | None,
    earlier: Choice | None,
    folder: Path,
    simulators: Simulators,
    *,
    progress: Callable[[Evaluations], None],
) -> ChosenDesign:
    """Search with `model`, from the design of the turn before besides all else; goes on where it was killed. What the
    record keeps of it, mm and kPa. Raises KeyboardInterrupt where it is interrupted."""
    search = replace(study.search, model=model)
    if earlier is not None:
        search = replace(search, earlier=EarlierResult(earlier.folder, earlier.design, earlier.pressures))
    result = run_study(
        search,
        folder,
        forward=simulators(_fine(study, model)),
        coarse=simulators(min(COARSE, study.points_per_side)),
        progress=progress,
    )
    if result.interrupted:
        raise KeyboardInterrupt
    write_arrays(folder.parent / SHAPES, {"believed": result.points.astype(np.float32)})
    return {
        "believed": as_millimetres(result.errors),
        "stop_reason": result.stop_reason,
        "evaluations": len(result.history),
        "reach": result.reach.sentences,
        "muscles": len(result.design.muscles),
    }


def chosen(kept: ChosenDesign, folder: Path) -> Choice:
    """Return a search's result from its folder and what the record kept."""
    design = read_design(folder / "design.toml")
    files = sorted(folder.glob("pressures*.csv"), key=lambda file: (len(file.name), file.name))
    shapes = read_arrays(folder.parent / SHAPES)["believed"].astype(np.float64)
    return Choice(
        folder=folder,
        design=design,
        pressures=np.array([read_pressures(file, design).pressure[-1] for file in files]),
        predicted=of_millimetres(kept["believed"]),
        shapes=shapes,
        stop_reason=kept["stop_reason"],
    )


def errors_on_device(
    study: LoopStudy, choice: Choice, measured: MeasurementSet, targets: Sequence[LoadedTarget], work: WorkFolder
) -> DeviceErrors:
    """Return errors of the measured shapes against the targets, mm, and how far those are from the predicted ones."""
    seed = study.search.seed
    shapes = measured_shapes(measured, targets, choice.shapes, seed=seed)
    errors = device_errors(targets, shapes, measured, seed=seed)
    apart = np.sqrt(np.square(shapes - choice.shapes).sum(axis=-1).mean())
    name = f"{choice.folder.parent.name}/{SHAPES}"
    work.claim(name)
    parts = {"believed": choice.shapes, "device": shapes}
    write_arrays(work.folder / name, {part: points.astype(np.float32) for part, points in parts.items()})
    return {**as_millimetres(errors), "from_believed": in_mm(float(apart))}


def as_millimetres(errors: Errors) -> ShapeErrors:
    """Return the errors in mm, `beyond` as a share, with the `excess`."""
    return {
        "chamfer": in_mm(float(errors.chamfer)),
        "chamfer_floor": in_mm(float(errors.chamfer_floor)),
        "surface_rms": in_mm(float(errors.surface_rms)),
        "surface_floor": in_mm(float(errors.surface_floor)),
        "surface_beyond": float(errors.beyond),
        "excess": in_mm(errors.excess),
    }


def of_millimetres(kept: ShapeErrors) -> Errors:
    """Return the same turned back."""
    return Errors(
        chamfer=from_mm(kept["chamfer"]),
        chamfer_floor=from_mm(kept["chamfer_floor"]),
        surface_rms=from_mm(kept["surface_rms"]),
        surface_floor=from_mm(kept["surface_floor"]),
        beyond=kept["surface_beyond"],
    )


def _fine(study: LoopStudy, model: Model | None) -> int:
    """Return points a side: a model's factors belong to their grid."""
    if model is None or not model.parameters:
        return min(study.points_per_side, POINTS_PER_SIDE)
    return model.points_per_side

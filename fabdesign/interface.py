"""What a user does, in Python: `import fabdesign`, then `fabdesign.simulate`, `equilibrium`, `calibrate`, `evaluate`,
`optimize`. Each does what the command of that name does; files are read where paths are given.

The only file here that knows the other packages (sim, studies); `fabdesign` loads it when it is asked for.
Pressures are typed in kPa; all else is SI, points in metres.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.design import Design
from fabdesign.design_file import read_design
from fabdesign.measurement_set import read_set
from fabdesign.model import Model
from fabdesign.model_file import read_model
from fabdesign.pressure import PressureProgram, require_pressures
from fabdesign.pressure_file import constant_program, read_pressures
from fabdesign.trial import MeasurementSet
from optimize.fit.parameters import fit_vector
from sim import Simulator
from studies.calibration.calibrate import Calibration
from studies.calibration.calibrate import calibrate as calibrate_sets
from studies.calibration.fitted_model import muscle_scope
from studies.evaluate import Evaluation, evaluate_sets
from studies.judged_search import GRID as JUDGING
from studies.layouts.result import StudyResult
from studies.layouts.run import run_study
from studies.predict import FRAME_RATE, frame_times, rest
from studies.predict import simulate as simulate_motion

DesignLike = Design | Path | str
ModelLike = Model | Path | str | None
Pressures = PressureProgram | Path | str | Sequence[float]


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated motion: time (T,) s after rest, points (T, 3362, 3) m (front face, then back face)."""

    time: NDArray[np.float64]
    points: NDArray[np.float32]

    @property
    def faces(self) -> NDArray[np.float32]:
        """(T, face, row, column, 3) m: face 0 in front, 1 behind; rows from the top edge, columns from the left."""
        return faces_of(self.points)


def faces_of(points: ArrayLike) -> NDArray[np.float32]:
    """(..., face, row, column, 3) m of points (..., 2 n n, 3) m in a motion's order.

    >>> import numpy as np
    >>> faces_of(np.zeros((5, 3362, 3))).shape
    (5, 2, 41, 41, 3)
    """
    array = np.asarray(points, dtype=np.float32)
    side = round(float(np.sqrt(array.shape[-2] / 2)))
    return array.reshape(*array.shape[:-2], 2, side, side, 3)


def simulate(
    design: DesignLike,
    pressures: Pressures,
    *,
    model: ModelLike = None,
    duration: float | None = None,
    frame_rate: float = FRAME_RATE,
    order: int = 0,
    grid: int | None = None,
) -> Simulated:
    """The motion of a design under pressures, from rest.

    pressures: kPa of every channel, held for 1.5 s; or a program, or a file of one. duration: s; by default the
    pressures'. frame_rate: Hz. order: the motion's place in the specimen's session. grid: points a side, by default the
    model's or 41. Raises InputError for what does not fit together, SimulationError where the motion diverges.

    >>> import fabdesign
    >>> from fabdesign.catalogue import build
    >>> motion = fabdesign.simulate(build("cross", muscles=2), [200, 0], duration=0.1, grid=21)
    >>> motion.time.shape, motion.faces.shape
    ((7,), (7, 2, 41, 41, 3))
    """
    loaded, fitted = _design(design), _model(model)
    program = _program(pressures, loaded)
    side = grid or (fitted or Model()).points_per_side
    times = frame_times(program, duration=duration, frame_rate=frame_rate, points_per_side=side)
    return Simulated(times, simulate_motion(Simulator(side), loaded, program, times, model=fitted, order=order))


def equilibrium(
    design: DesignLike,
    pressures: Pressures,
    *,
    model: ModelLike = None,
    order: int = 0,
    grid: int | None = None,
) -> NDArray[np.float32]:
    """(face, row, column, 3) m: the shape at rest after pressures [kPa of every channel] rose linearly within 1 s.

    Other arguments and errors are those of `simulate`.

    >>> import fabdesign
    >>> from fabdesign.catalogue import build
    >>> shape = fabdesign.equilibrium(build("vertical", muscles=2), [300, 300], grid=21)
    >>> bool(shape[0, -1, :, 2].mean() > 0.01)  # m: muscles in front pull the lower edge towards the viewer
    True
    """
    loaded, fitted = _design(design), _model(model)
    simulator = Simulator(grid or (fitted or Model()).points_per_side)
    return faces_of(rest(simulator, loaded, _program(pressures, loaded), model=fitted, order=order))


def calibrate(
    measured: MeasurementSet | Path | str | Sequence[MeasurementSet | Path | str],
    *,
    fit: Sequence[int] | None = None,
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    grid: int = 61,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda line, share: None,
) -> Calibration:
    """Declared parameters, and what `free` adds, fitted to measurement sets together; `.model` is what came out.

    fit: orders of the trials to fit in each set, by default all of role `fit`. free: effects, as in `calibrate --free`;
    fix: declared parameters that are held. progress is told what is done, and about what share of it all. Raises
    InputError for an unsound set, SimulationError where all motions diverge.
    """
    sets = _sets(measured)
    return calibrate_sets(
        sets,
        Simulator(grid),
        slopes=Simulator(min(grid, 41)),
        coarse=Simulator(JUDGING),
        vector=fit_vector(free, fix, scope=muscle_scope([design for one in sets for design in one.designs.values()])),
        points_per_side=grid,
        orders=fit,
        seed=seed,
        progress=progress,
    )


def evaluate(
    model: Model | Path | str,
    measured: MeasurementSet | Path | str | Sequence[MeasurementSet | Path | str],
    *,
    all_trials: bool = False,
    grid: int | None = None,
) -> Evaluation:
    """How far a model's motions are from the measured ones, before and after, on the trials of role `test`.

    all_trials: those of role `fit` too, in a table of their own. Raises InputError where no trial is left.
    """
    sets = _sets(measured)
    fitted = model if isinstance(model, Model) else read_model(model)
    forward = Simulator(grid or fitted.points_per_side)
    return evaluate_sets(fitted, sets, forward, coarse=Simulator(JUDGING), all_trials=all_trials)


def optimize(study: Path | str, out: Path | str, *, seconds: float | None = None, force: bool = False) -> StudyResult:
    """The layout and pressures that come closest to a study's target; `out` gets the files that the command writes.

    seconds: of search, in place of the study's. Raises InputError for a bad study, or where `out` holds other files.
    """
    return run_study(study, out, seconds=seconds, force=force)


def _design(design: DesignLike) -> Design:
    return design if isinstance(design, Design) else read_design(design)


def _sets(measured: MeasurementSet | Path | str | Sequence[MeasurementSet | Path | str]) -> list[MeasurementSet]:
    many = [measured] if isinstance(measured, MeasurementSet | Path | str) else measured
    return [one if isinstance(one, MeasurementSet) else read_set(one) for one in many]


def _model(model: ModelLike) -> Model | None:
    return model if model is None or isinstance(model, Model) else read_model(model)


def _program(pressures: Pressures, design: Design) -> PressureProgram:
    if isinstance(pressures, Path | str):
        return read_pressures(pressures, design)
    if not isinstance(pressures, PressureProgram):
        pressures = constant_program(1e3 * np.asarray(pressures, dtype=float))
    require_pressures(pressures, design, "pressures")
    return pressures

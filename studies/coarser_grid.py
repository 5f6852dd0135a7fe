"""Whether a model's motions need the fine grid that it was calibrated on."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import Case, ForwardModel
from fabdesign.model import POINTS_PER_SIDE, Model
from fabdesign.trial import Trial
from studies.forward_model import forward_model

NEAR = 1e-4  # m RMS over the points and frames of a motion, under which the coarser grid is as good
_FEWEST = 6  # trials for each that is tried: below, trying costs more than it spares


def enough_points(
    model: Model,
    trials: Sequence[Trial],
    forward: Callable[[int], ForwardModel],
    *,
    tell: Callable[[str], None] = lambda line: None,
) -> int:
    """Grid points a side for `trials`: the model's, or 41 where that moves the points by under 0.1 mm RMS.

    Tried on the most strongly driven trial of each design, with the simulators `forward(points a side)`: cloth that
    snaps goes another way on another grid, and it is there that it snaps. `tell` hears a line on what was found. Raises
    InputError.
    """
    fine, coarse = model.points_per_side, POINTS_PER_SIDE
    tried = _driven(trials)
    if fine <= coarse or len(trials) < _FEWEST * len(tried):
        return fine
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in tried]
    times = [trial.times for trial in tried]
    both = (forward_model(forward(side), model).motions(cases, times) for side in (coarse, fine))
    apart = [_rms(a, b) for a, b in zip(*both, strict=True)]
    worst = int(np.argmax(apart))
    near = apart[worst] < NEAR
    tell(
        f"grid: {coarse if near else fine} points a side; with {coarse} instead of the model's {fine}, "
        f"{tried[worst].design_name} {tried[worst].name} moves by {1e3 * apart[worst]:.2f} mm RMS, "
        f"{'under' if near else 'not under'} {1e3 * NEAR:g}"
    )
    return coarse if near else fine


def _driven(trials: Sequence[Trial]) -> list[Trial]:
    """Of each design, the trial with the highest pressures: the mean over channels of the highest of each."""
    chosen: dict[str, tuple[float, Trial]] = {}
    for trial in trials:
        drive = float(trial.program.pressure.max(axis=0).mean()) if trial.design.channels else 0.0
        if trial.design_name not in chosen or drive > chosen[trial.design_name][0]:
            chosen[trial.design_name] = drive, trial
    return [trial for _, trial in chosen.values()]


def _rms(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """m; infinite where a motion diverged."""
    square = float(np.mean(np.square(a - b).sum(axis=2)))
    return float(np.sqrt(square)) if np.isfinite(square) else float("inf")

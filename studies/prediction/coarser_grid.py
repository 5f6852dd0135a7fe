"""Whether a model's motions need the fine grid that it was calibrated on: decided for each design."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from studies.prediction.forward_model import forward_model

NEAR = 1e-4  # m RMS over the points and frames of a motion, under which the coarser grid is as good
_FEWEST = 6  # trials of a design, for it to be tried: below, trying costs more than it spares


@dataclass(frozen=True)
class ByDesign:
    """A simulator for each design: `coarse` where it is as good, else `fine`. Implements
    fabdesign.nouns.forward.ForwardModel."""

    fine: ForwardModel
    coarse: ForwardModel
    calm: tuple[Design, ...]  # for which the coarse one is as good

    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        """Return what the simulator of each case's design gives."""
        return self._asked(
            cases, lambda of, numbers: of.motions([cases[i] for i in numbers], [times[i] for i in numbers])
        )

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """Return what the simulator of each case's design gives."""
        return self._asked(cases, lambda of, numbers: of.equilibria([cases[i] for i in numbers]))

    def _asked(
        self, cases: Sequence[Case], ask: Callable[[ForwardModel, list[int]], list[NDArray[np.float32]]]
    ) -> list[NDArray[np.float32]]:
        by_case: dict[int, NDArray[np.float32]] = {}
        for simulator, calm in ((self.fine, False), (self.coarse, True)):
            if numbers := [i for i, case in enumerate(cases) if (case.design in self.calm) is calm]:
                by_case |= dict(zip(numbers, ask(simulator, numbers), strict=True))
        return [by_case[i] for i in range(len(cases))]


def enough_points(
    model: Model,
    trials: Sequence[Trial],
    forward: Callable[[int], ForwardModel],
    *,
    tell: Callable[[str], None] = lambda line: None,
) -> ForwardModel:
    """Return the simulator for `trials`: of the model's grid, and for designs whose points that moves by under 0.1 mm
    RMS, of 41 points a side.

    Tried on the most strongly driven trial of each design, with the simulators `forward(points a side)`: cloth that
    snaps goes another way on another grid, and it is there that it snaps. `tell` hears a line on what was found. Raises
    InputError.
    """
    fine = forward(model.points_per_side)
    tried = _driven(trials) if model.points_per_side > POINTS_PER_SIDE else []
    if not tried:
        return fine
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in tried]
    times = [trial.times for trial in tried]
    coarse = forward(POINTS_PER_SIDE)
    # the fine one first: room is then made once
    both = [forward_model(simulator, model).motions(cases, times) for simulator in (fine, coarse)]
    apart = [_rms(a, b) for a, b in zip(*both, strict=True)]
    calm = tuple(trial.design for trial, off in zip(tried, apart, strict=True) if off < NEAR)
    for trial, off in zip(tried, apart, strict=True):
        tell(
            f"grid: {POINTS_PER_SIDE if off < NEAR else model.points_per_side} points a side for {trial.design_name}; "
            f"with {POINTS_PER_SIDE} instead of the model's {model.points_per_side}, {trial.name} moves by "
            f"{in_mm(off):.2f} mm RMS, {'under' if off < NEAR else 'not under'} {in_mm(NEAR):g}"
        )
    return ByDesign(fine, coarse, calm) if calm else fine


def _driven(trials: Sequence[Trial]) -> list[Trial]:
    """Return for each design that many trials have the trial with the highest pressures: the mean over channels of the
    highest of each."""
    designs: list[tuple[Design, list[Trial]]] = []
    for trial in trials:
        trials_of = next((trials_of for design, trials_of in designs if design == trial.design), None)
        if trials_of is None:
            designs.append((trial.design, [trial]))
        else:
            trials_of.append(trial)

    def drive(trial: Trial) -> float:
        return float(trial.program.pressure.max(axis=0).mean()) if trial.design.channels else 0.0

    return [max(trials_of, key=drive) for _, trials_of in designs if len(trials_of) >= _FEWEST]


def _rms(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Return the RMS [m]; infinite where a motion diverged."""
    square = float(np.mean(np.square(a - b).sum(axis=2)))
    return float(np.sqrt(square)) if np.isfinite(square) else float("inf")

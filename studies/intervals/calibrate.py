"""A model's `Spread`, calibrated on trials that it was not fitted to."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model, Spread
from fabdesign.nouns.model_sampling import TWO_SIDED, spread_hash
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from optimize.fit.clouds import evenly
from studies.intervals.draws import Used, looked_at, residuals
from studies.intervals.widths import LEAST, START, IntervalScore, RegionResiduals, calibrated, combined, left_out
from studies.measured.splits import by_program
from studies.prediction.forward_model import forward_model

MOST = 10  # of a design


def chosen(trials: Sequence[Trial], most: int = MOST) -> list[Trial]:
    """Return at most so many trials of a design, spread over the session."""
    selected = []
    for name in sorted({trial.design_name for trial in trials}):
        of_design = [trial for trial in trials if trial.design_name == name]
        selected += [of_design[k] for k in evenly(len(of_design), most)]
    return selected


def with_spread(
    model: Model,
    trials: Sequence[Trial],
    simulator: ForwardModel,
    *,
    coarse: ForwardModel | None = None,
    used: Used | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Model, str]:
    """Return the model with its spread, or without one, and a line that says how good it is, or why there is none.

    trials: that the model was not fitted to. coarse: a cheap simulator for the drawn models, by default `simulator`.
    """
    bare = replace(model, spread=None)
    predictor = forward_model(simulator, bare, sensing=True)
    if predictor.corrector is not None and not predictor.corrector.ordered:
        return bare, "intervals of motions are not calibrated: the corrector's points have no order"
    usable = [trial for trial in chosen(trials) if len(looked_at(trial, used))]
    every: list[RegionResiduals] = []
    if len(usable) >= LEAST:
        every = residuals(usable, predictor, coarse or simulator, used=used, progress=progress)
    kept = [k for k, one in enumerate(every) if len(one.residual)]
    if len(kept) < LEAST:
        count = len(kept) if every else len(usable)
        return (
            bare,
            f"intervals of motions are not calibrated: {count} trials of role fit are left for it; expected {LEAST}",
        )
    spread, score = spread_from([every[k] for k in kept], _folds([usable[k] for k in kept]), bare)
    return replace(bare, spread=spread), (
        f"90 % intervals calibrated on {spread.trials} trials that were not fitted: mean width "
        f"{in_mm(score.width):.2f} mm; {spread.held:.0%} inside where each trial is left out in turn"
    )


def spread_from(every: Sequence[RegionResiduals], folds: Sequence[int], model: Model) -> tuple[Spread, IntervalScore]:
    """Return the spread of trials' residuals, and how good it is where each fold is left out in turn."""
    widths = calibrated(every, combined, START)
    constant, covariance, motion = TWO_SIDED * widths.factor * np.exp(widths.shape)
    if not any(one.deviation.any() for one in every):
        covariance = 0.0  # nothing says how much
    sigma = np.concatenate(left_out(every, folds, combined, START))
    score = IntervalScore.of(np.concatenate([one.residual for one in every]), sigma)
    return Spread(
        float(constant), float(covariance), float(motion), len(every), score.inside, spread_hash(model), widths.designs
    ), score


def spread_json(model: Model) -> dict[str, Any] | None:
    """Return what commands print of it: mm."""
    spread = model.spread
    if spread is None:
        return None
    shape = {"constant_mm": in_mm(spread.constant), "covariance": spread.covariance, "motion": spread.motion}
    return shape | {"trials": spread.trials, "held": spread.held, "designs": dict(spread.designs)}


def _folds(trials: Sequence[Trial]) -> list[int]:
    """Return trials with the same pressures are one fold; of a single program each trial is one."""
    groups = by_program(trials)
    if len(groups) < 2:
        return [*range(len(trials))]
    fold = {id(trial): k for k, group in enumerate(groups) for trial in group}
    return [fold[id(trial)] for trial in trials]

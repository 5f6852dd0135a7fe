"""A model's intervals against measured trials."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Spread
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.spread import TWO_SIDED, half_widths, spread_of
from fabdesign.nouns.trial import Trial
from studies.intervals.draws import Motion, drawn_motions, looked_at, residuals_of, rests
from studies.intervals.widths import IntervalScore

# of a trial's clouds and the frames that are used
IntervalJudge = Callable[[Sequence[NDArray[np.float64]], NDArray[np.intp]], IntervalScore | None]


def interval_judges(
    trials: Sequence[Trial], predictor: Predictor, coarse: ForwardModel, motions: Sequence[Motion]
) -> list[IntervalJudge]:
    """Of each trial, what judges the model's intervals at every sixth frame; None of a model without. motions:
    `predictor`'s own, at the trials' times; coarse: moves the drawn models."""
    spread = spread_of(predictor.model)
    if spread is None:
        return [lambda clouds, used: None for _ in trials]
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    frames = [looked_at(trial) for trial in trials]
    times = [trial.times[own] for trial, own in zip(trials, frames, strict=True)]
    others = drawn_motions(predictor, coarse, cases, times) if spread.covariance else [[]] * len(trials)
    rows = zip(trials, frames, rests(predictor, cases), motions, others, strict=True)
    return [_Judge(spread, *row) for row in rows]


@dataclass(frozen=True, eq=False)
class _Judge:
    """Of one trial: frames looked at, where its motion begins, the model's motion and those of drawn models."""

    spread: Spread
    trial: Trial
    frames: NDArray[np.intp]
    rest: Motion
    motion: Motion
    others: Sequence[Motion]

    def __call__(self, clouds: Sequence[NDArray[np.float64]], used: NDArray[np.intp]) -> IntervalScore | None:
        own = np.isin(self.frames, used)
        kept = self.frames[own]
        taken, others = [clouds[k] for k in kept.tolist()], [other[own] for other in self.others]
        found = residuals_of(self.trial, taken, self.rest, self.motion[kept], others)
        if not len(found.residual):
            return None
        widths = half_widths(self.spread, found.deviation, found.moved, found.design)
        return IntervalScore.of(found.residual, widths / TWO_SIDED)

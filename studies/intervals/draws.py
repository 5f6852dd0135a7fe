"""Motions and shapes of models drawn from a model's joint covariance, and what they leave of measured trials."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.effort import batches
from studies.intervals.regions import region_residuals, region_terms
from studies.intervals.widths import RegionResiduals

Array = NDArray[np.float64]
Motion = NDArray[np.float32]
Used = Callable[[Trial], NDArray[np.bool_]]
DRAWS = 8
FIRST, EVERY = 5, 6  # frames
_AT_ONCE = 16  # trials, whose drawn motions are in memory
_SEED = 0  # the same draws wherever a model is asked: what a few of them miss is in the calibrated factor


def drawn_models(model: Model, draws: int = DRAWS) -> list[Model]:
    """None without a covariance."""
    return Ensemble(model).drawn(draws, _SEED)


def drawn_motions(
    predictor: Predictor,
    coarse: ForwardModel,
    cases: Sequence[Case],
    times: Sequence[Array],
    *,
    draws: int = DRAWS,
) -> list[list[Motion]]:
    """Of each case, the motions of the drawn models on a cheap simulator. The corrector stays the one trained at the
    centre."""
    models = [replace(predictor, model=model) for model in drawn_models(predictor.model, draws)]
    together = replace(predictor, simulator=coarse, model=Model())  # the cases bring all of it
    own = [model.case(case) for case in cases for model in models]
    motions = iter(together.motions(own, [t for t in times for _ in models]) if own else [])
    return [[next(motions) for _ in models] for _ in cases]


def rests(predictor: Predictor, cases: Sequence[Case]) -> list[Motion]:
    """(2 n^2, 3) m of each case, where its motion begins."""
    return [motion[0] for motion in predictor.motions(cases, [np.zeros(1)] * len(cases))]


def looked_at(trial: Trial, used: Used | None = None) -> NDArray[np.intp]:
    """Frames of a trial by which intervals are calibrated and judged: every sixth, of those used."""
    count = len(trial.times)
    frames = np.arange(min(FIRST, count - 1), count, EVERY)
    return frames if used is None else frames[used(trial)[frames]]


def residuals(
    trials: Sequence[Trial],
    predictor: Predictor,
    coarse: ForwardModel,
    *,
    used: Used | None = None,
    draws: int = DRAWS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[RegionResiduals]:
    """Of each trial, which has frames that are used; empty where its motion diverged. predictor: with sensing, as data
    are. progress is told trials done and in all."""
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    frames = [looked_at(trial, used) for trial in trials]
    times = [trial.times[own] for trial, own in zip(trials, frames, strict=True)]
    found: list[RegionResiduals] = []
    for part in batches([draws * len(t) for t in times], _AT_ONCE):
        motions = predictor.motions(cases[part], [np.concatenate([[0.0], t]) for t in times[part]])
        others = drawn_motions(predictor, coarse, cases[part], times[part], draws=draws)
        for trial, own, motion, drawn_ones in zip(trials[part], frames[part], motions, others, strict=True):
            clouds = trial.load().frames
            taken = [clouds[k] for k in own.tolist()]
            found.append(residuals_of(trial, taken, motion[0], motion[1:], drawn_ones))
        progress(len(found), len(trials))
    return found


def residuals_of(
    trial: Trial, clouds: Sequence[Array], rest: Motion, predicted: Motion, others: Sequence[Motion]
) -> RegionResiduals:
    """clouds: T of (n, 3) m; rest: (2 n^2, 3) m; predicted, and of the drawn models others: (T, 2 n^2, 3) m."""
    if not clouds or not (np.isfinite(predicted).all() and np.isfinite(rest).all()):
        return RegionResiduals(trial.design_name, *np.empty((3, 0)))
    deviation, moved = region_terms(rest, predicted, others, trial.design.fabric)
    residual = region_residuals(predicted, clouds, trial.design.fabric)
    seen = np.isfinite(residual)
    return RegionResiduals(trial.design_name, residual[seen], deviation[seen], moved[seen])

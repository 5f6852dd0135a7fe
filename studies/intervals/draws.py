"""Motions and shapes of models drawn from a model's joint covariance, and what they leave of measured trials.

Regions that intervals are said of: the mean height of the cloth over the predicted one in each of nine regions,
along the normal of the predicted mid-surface.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from corrector.field import offsets
from corrector.shape import FINE, LocalFrames
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import SIDE, Case, ForwardModel
from fabdesign.nouns.model import NORMAL90, Model, Spread
from fabdesign.nouns.model_sampling import Ensemble, half_widths
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.effort import batches

REGIONS = 3  # a side


@dataclass(frozen=True, eq=False)
class RegionResiduals:
    """The residuals of one trial, (n,) each, a region at a frame."""

    design: str
    residual: Array  # m, measured less predicted
    deviation: Array  # m, standard deviation over draws of the joint covariance
    moved: Array  # m since rest

    def sigma(self, spread: Spread) -> Array:
        """Return (n,) m, the standard deviations that a model's intervals have."""
        return half_widths(spread, self.deviation, self.moved, self.design) / NORMAL90


def region_terms(rest: Floats, predicted: Floats, drawn: Sequence[Floats], fabric: Fabric) -> tuple[Array, Array]:
    """Return (T, REGIONS, REGIONS) m each: the standard deviation over the drawn models' motions, 0 without two of
    them, and how far a region has moved since rest. rest: (2 n^2, 3) m; predicted and drawn: (T, 2 n^2, 3) m."""
    middle = Shape(predicted).middle
    nodes = _nodes(middle)
    per_region = by_region(np.ones((1, *nodes.shape[1:3])))[0]
    moved = by_region(np.linalg.norm(nodes - _nodes(Shape(rest).middle[None]), axis=-1)) / per_region
    sound = [other for other in drawn if np.isfinite(other).all()]
    if len(sound) < 2:
        return np.zeros_like(moved), np.asarray(moved)
    normal = LocalFrames.of(middle, fabric.width, fabric.height, FINE).normal  # (T, FINE, FINE, 3), off the front
    along = [np.einsum("tabi,tabi->tab", _nodes(Shape(other).middle) - nodes, normal) for other in sound]
    return np.array([by_region(one) for one in np.array(along)]).std(axis=0, ddof=1) / per_region, np.asarray(moved)


def region_residuals(predicted: Floats, clouds: Sequence[Array], fabric: Fabric) -> Array:
    """Return (T, REGIONS, REGIONS) m from the predicted cloth to the measured one; NaN where no point was measured."""
    middle = Shape(predicted).middle
    pairs = [offsets(one, cloud, fabric.thickness) for one, cloud in zip(middle, clouds, strict=True)]
    heights, counts = (np.array([pair[k] for pair in pairs], dtype=float) for k in (0, 1))
    weight = by_region(counts)
    mean = by_region(heights * counts) / np.maximum(weight, 1e-9)
    return np.asarray(np.where(weight > 0, mean, np.nan))


def _nodes(middle: Floats) -> Floats:
    """Return (T, FINE, FINE, 3) m."""
    every = (SIDE - 1) // (FINE - 1)
    return middle[:, ::every, ::every]


def by_region(values: Floats) -> Array:
    """Return (T, REGIONS, REGIONS) sums of (T, n, n)."""
    edges = np.linspace(0, values.shape[1], REGIONS + 1).astype(int)[:-1]
    return np.asarray(np.add.reduceat(np.add.reduceat(values, edges, axis=1), edges, axis=2))


Motion = NDArray[np.float32]
Used = Callable[[Trial], NDArray[np.bool_]]
DRAWS = 8
EVERY = 6  # frames: the sixth, and every sixth from there on
_AT_ONCE = 16  # trials, whose drawn motions are in memory


def drawn_models(model: Model, draws: int = DRAWS) -> list[Model]:
    """Return the drawn models; None without a covariance."""
    return Ensemble(model).drawn(draws, seed=0)  # what a few of them miss is in the calibrated factor


def drawn_motions(
    predictor: Predictor, coarse: ForwardModel, cases: Sequence[Case], times: Sequence[Array], *, draws: int = DRAWS
) -> list[list[Motion]]:
    """Return of each case the motions of the drawn models on a cheap simulator. The corrector stays the one trained at
    the centre."""
    models = [replace(predictor, model=model) for model in drawn_models(predictor.model, draws)]
    together = replace(predictor, simulator=coarse, model=Model())  # the cases bring all of it
    some = [model.case(case) for case in cases for model in models]
    motions = iter(together.motions(some, [t for t in times for _ in models]) if some else [])
    return [[next(motions) for _ in models] for _ in cases]


def rests(predictor: Predictor, cases: Sequence[Case]) -> list[Motion]:
    """Return (2 n^2, 3) m of each case, where its motion begins."""
    return [motion[0] for motion in predictor.motions(cases, [np.zeros(1)] * len(cases))]


def looked_at(trial: Trial, used: Used | None = None) -> NDArray[np.intp]:
    """Return frames of a trial by which intervals are calibrated and judged: every sixth, of those used."""
    count = len(trial.times)
    frames = np.arange(min(EVERY, count) - 1, count, EVERY)
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
    """Return the residuals of each trial, which has frames that are used; empty where its motion diverged. predictor:
    with sensing, as data are. progress is told trials done and in all."""
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    frames = [looked_at(trial, used) for trial in trials]
    times = [trial.times[some] for trial, some in zip(trials, frames, strict=True)]
    results: list[RegionResiduals] = []
    for part in batches([draws * len(t) for t in times], _AT_ONCE):
        motions = predictor.motions(cases[part], [np.concatenate([[0.0], t]) for t in times[part]])
        others = drawn_motions(predictor, coarse, cases[part], times[part], draws=draws)
        for trial, some, motion, drawn_ones in zip(trials[part], frames[part], motions, others, strict=True):
            clouds = trial.load().frames
            taken = [clouds[k] for k in some.tolist()]
            results.append(residuals_of(trial, taken, motion[0], motion[1:], drawn_ones))
        progress(len(results), len(trials))
    return results


def residuals_of(
    trial: Trial, clouds: Sequence[Array], rest: Motion, predicted: Motion, others: Sequence[Motion]
) -> RegionResiduals:
    """Return the residuals of a trial. clouds: T of (n, 3) m; rest: (2 n^2, 3) m; predicted, and of the drawn models
    others: (T, 2 n^2, 3) m."""
    if not clouds or not (np.isfinite(predicted).all() and np.isfinite(rest).all()):
        return RegionResiduals(trial.design_name, *np.empty((3, 0)))
    deviation, moved = region_terms(rest, predicted, others, trial.design.fabric)
    residual = region_residuals(predicted, clouds, trial.design.fabric)
    seen = np.isfinite(residual)
    return RegionResiduals(trial.design_name, residual[seen], deviation[seen], moved[seen])

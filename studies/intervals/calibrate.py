"""A model's `Spread`, calibrated on trials that it was not fitted to: least CRPS, then scaled so that 90 % of the
residuals are inside; and the score of such intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from fabdesign.formats.schema import Key, Millimetre
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import INSIDE, NORMAL90, Model, Spread
from fabdesign.nouns.model_sampling import spread_hash
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from studies.intervals.draws import RegionResiduals, Used, looked_at, residuals
from studies.measured.splits import of_each_design, program_of
from studies.prediction.forward_model import sensed_model

MOST = 10  # of a design
Width = Callable[[Array, RegionResiduals], Array]  # of what shapes it: (n,) m, standard deviations
LEAST = 5  # trials, under which nothing is calibrated, and no design for itself
START = np.log([0.5e-3, 1.0, 0.01])  # of `combined`


def combined(shape: Array, one: RegionResiduals) -> Array:
    """Return in quadrature the constant, what the covariance says, and a share of the motion."""
    least, times, share = np.exp(shape)
    return np.asarray(np.sqrt(least**2 + (times * one.deviation) ** 2 + (share * one.moved) ** 2))


def crps(residual: Array, sigma: Array) -> Array:
    """Return (n,) m, of a normal distribution about nothing (Gneiting and Raftery 2007, eq. 21)."""
    z = residual / sigma
    density = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    return np.asarray(sigma * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi)))


@dataclass(frozen=True, eq=False)
class Widths:
    """Standard deviations: a width's shape, and what puts 90 % of the residuals inside, of all and of a design."""

    width: Width
    shape: Array
    factor: float
    designs: Mapping[str, float]  # times that, of designs with enough trials

    def of(self, one: RegionResiduals) -> Array:
        """Return (n,) m."""
        return self.designs.get(one.design, 1.0) * self.factor * self.width(self.shape, one)


def calibrated(others: Sequence[RegionResiduals], width: Width, start: Array) -> Widths:
    """Return the shape by least CRPS, then the factors."""

    def mean(shape: Array) -> float:
        return float(np.concatenate([crps(one.residual, width(shape, one)) for one in others]).mean())

    shape = minimize(mean, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-9}).x
    ratios: dict[str, list[Array]] = {}
    for one in others:
        ratios.setdefault(one.design, []).append(np.abs(one.residual) / width(shape, one))
    overall = float(np.quantile(np.concatenate([r for parts in ratios.values() for r in parts]), INSIDE))
    factors = {name: float(np.quantile(np.concatenate(r), INSIDE)) for name, r in ratios.items() if len(r) >= LEAST}
    return Widths(width, shape, overall / NORMAL90, {name: value / overall for name, value in factors.items()})


def left_out(every: Sequence[RegionResiduals], folds: Sequence[int], width: Width, start: Array) -> list[Array]:
    """Return (n,) m of each trial, standard deviations calibrated on the trials of the other folds."""
    widths = {
        fold: calibrated([one for one, other in zip(every, folds, strict=True) if other != fold], width, start)
        for fold in sorted(set(folds))
    }
    return [widths[fold].of(one) for one, fold in zip(every, folds, strict=True)]


@dataclass(frozen=True)
class IntervalScore:
    """The score of 90 % intervals, over regions and frames. width: m, from end to end; crps: m."""

    count: Annotated[int, Key("")]
    inside: float
    width: Annotated[Millimetre, Key("width_mm")]
    crps: Annotated[Millimetre, Key("crps_mm")]

    @property
    def shown(self) -> tuple[float, float, float]:
        """Return the share inside, width and CRPS in mm."""
        return self.inside, in_mm(self.width), in_mm(self.crps)

    @staticmethod
    def of(residual: Array, sigma: Array) -> "IntervalScore":
        """Return the score of intervals. residual, sigma: (n,) m, n > 0."""
        sigma = np.maximum(sigma, 1e-9)
        inside = float((np.abs(residual) <= NORMAL90 * sigma).mean())
        width, score = (float(x.mean()) for x in (2 * NORMAL90 * sigma, crps(residual, sigma)))
        return IntervalScore(len(residual), inside, width, score)

    @staticmethod
    def pooled(scores: Sequence["IntervalScore"]) -> "IntervalScore | None":
        """Return the score of all of their regions together; None where there are none."""
        counts = np.array([score.count for score in scores])
        if not counts.sum():
            return None
        inside, width, score = (
            float(np.average([getattr(one, name) for one in scores], weights=counts))
            for name in ("inside", "width", "crps")
        )
        return IntervalScore(int(counts.sum()), inside, width, score)


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
    predictor = sensed_model(simulator, bare)
    if predictor.corrector is not None and not predictor.corrector.ordered:
        return bare, "intervals of motions are not calibrated: the corrector's points have no order"
    usable = [trial for trial in of_each_design(trials, MOST) if len(looked_at(trial, used))]
    enough = len(usable) >= LEAST
    every = residuals(usable, predictor, coarse or simulator, used=used, progress=progress) if enough else []
    kept = [k for k, one in enumerate(every) if len(one.residual)]
    if len(kept) < LEAST:
        count = len(kept) if every else len(usable)
        return (
            bare,
            f"intervals of motions are not calibrated: {count} trials of role fit are left for it; expected {LEAST}",
        )
    folds: Sequence[int] = program_of([usable[k] for k in kept])
    if len(set(folds)) < 2:  # of a single program each trial is one
        folds = range(len(kept))
    spread, score = spread_from([every[k] for k in kept], folds, bare)
    return replace(bare, spread=spread), (
        f"90 % intervals calibrated on {spread.trials} trials that were not fitted: mean width "
        f"{in_mm(score.width):.2f} mm; {spread.held:.0%} inside where each trial is left out in turn"
    )


def spread_from(every: Sequence[RegionResiduals], folds: Sequence[int], model: Model) -> tuple[Spread, IntervalScore]:
    """Return the spread of trials' residuals, and how good it is where each fold is left out in turn."""
    widths = calibrated(every, combined, START)
    constant, covariance, motion = NORMAL90 * widths.factor * np.exp(widths.shape)
    if not any(one.deviation.any() for one in every):
        covariance = 0.0  # nothing says how much
    sigma = np.concatenate(left_out(every, folds, combined, START))
    score = IntervalScore.of(np.concatenate([one.residual for one in every]), sigma)
    return Spread(
        float(constant), float(covariance), float(motion), len(every), score.inside, spread_hash(model), widths.designs
    ), score

"""A model's `Spread`, calibrated on trials that it was not fitted to: least CRPS, then scaled so that 90 % of the
residuals are inside; the score of such intervals against measured trials; and the band of a predicted motion, their
half-widths by frame and region, and of shapes at rest."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtr

from corrector.shape import LocalFrames, interpolation
from fabdesign.formats.schema import Key, Millimetre
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import SIDE, Case, ForwardModel
from fabdesign.nouns.model import INSIDE, NORMAL90, Model, Spread
from fabdesign.nouns.model_sampling import half_widths, spread_hash, spread_of
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from studies.intervals.draws import (
    REGIONS,
    Motion,
    RegionResiduals,
    Used,
    drawn_motions,
    looked_at,
    region_terms,
    residuals,
    residuals_of,
    rests,
)
from studies.measured.splits import of_each_design, program_of
from studies.prediction.forward_model import sensed_model

MOST = 10  # of a design
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


def calibrated(others: Sequence[RegionResiduals]) -> Spread:
    """Return the shape by least CRPS, then the factors that put 90 % of the residuals inside, of all and of each design
    with enough trials. It is of no model yet."""

    def mean(shape: Array) -> float:
        return float(np.concatenate([crps(one.residual, combined(shape, one)) for one in others]).mean())

    shape = minimize(mean, START, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-9}).x
    ratios: dict[str, list[Array]] = {}
    for one in others:
        ratios.setdefault(one.design, []).append(np.abs(one.residual) / combined(shape, one))
    overall = float(np.quantile(np.concatenate([r for parts in ratios.values() for r in parts]), INSIDE))
    factors = {name: float(np.quantile(np.concatenate(r), INSIDE)) for name, r in ratios.items() if len(r) >= LEAST}
    constant, covariance, motion = (overall * np.exp(shape)).tolist()
    if not any(one.deviation.any() for one in others):
        covariance = 0.0  # nothing says how much
    designs = {name: value / overall for name, value in factors.items()}
    return Spread(constant, covariance, motion, len(others), INSIDE, "", designs)


def left_out(every: Sequence[RegionResiduals], folds: Sequence[int]) -> list[Array]:
    """Return (n,) m of each trial, standard deviations calibrated on the trials of the other folds."""
    spreads = {
        fold: calibrated([one for one, other in zip(every, folds, strict=True) if other != fold])
        for fold in sorted(set(folds))
    }
    return [one.sigma(spreads[fold]) for one, fold in zip(every, folds, strict=True)]


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
    residual = np.concatenate([one.residual for one in every])
    score = IntervalScore.of(residual, np.concatenate(left_out(every, folds)))
    return replace(calibrated(every), held=score.inside, trained_on=spread_hash(model)), score


def bands(
    predictor: Predictor, coarse: ForwardModel, cases: Sequence[Case], times: Sequence[Array], motions: Sequence[Motion]
) -> list[Array | None]:
    """Return (T, REGIONS, REGIONS) m of each case: 90 % of motions lie within so much of `motions` along their normal,
    in the mean of a region. None of a model without intervals. motions: `predictor`'s own, at `times` [s]; coarse:
    moves the drawn models."""
    spread = spread_of(predictor.model)
    if spread is None:
        return [None] * len(cases)
    results: list[Array | None] = []
    for case, at, motion, rest in zip(cases, times, motions, rests(predictor, cases), strict=True):
        others = drawn_motions(predictor, coarse, [case], [at])[0] if spread.covariance else []
        results.append(half_widths(spread, *region_terms(rest, motion, others, case.design.fabric), case.design.name))
    return results


def shapes_with_error(
    drawn: Array,
    rest: Array,
    predicted: Array,
    spread: Spread,
    fabric: Fabric,
    rng: np.random.Generator,
    *,
    least: float,
) -> Array:
    """Return (models, 2 n^2, 3) m: shapes of drawn models, spread as the calibrated intervals are: their scatter by its
    factor (at least `least`), and what the model lacks, along the normal of the shape `predicted` (2 n^2, 3) m. One
    draw of it moves the whole cloth to one side: how its parts go together is not known. rest: (2 n^2, 3) m, without
    pressure."""
    factor = max(spread.covariance / NORMAL90, least)
    mean = drawn.mean(axis=0)
    _, moved = region_terms(rest, predicted[None], [], fabric)
    sigma = over_nodes(half_widths(replace(spread, covariance=0.0), moved, moved)[0], SIDE) / NORMAL90
    normal = LocalFrames.of(Shape(predicted).middle, fabric.width, fabric.height, SIDE).normal
    error = np.tile((sigma[..., None] * normal).reshape(-1, 3), (2, 1))
    return np.asarray(mean + factor * (drawn - mean) + rng.standard_normal((len(drawn), 1, 1)) * error)


def over_nodes(values: Array, side: int) -> Array:
    """Return (side, side) of (REGIONS, REGIONS), linear between the regions' middles."""
    at = np.clip(np.linspace(0, REGIONS, side) - 0.5, 0, REGIONS - 1)
    line = interpolation(at, REGIONS)
    return np.asarray(line @ values @ line.T)


def mean_width(widths: Sequence[Array]) -> float:
    """Return the mean width [m] from end to end, over motions, frames and regions. widths: m, half."""
    return 2 * float(np.concatenate([each.ravel() for each in widths]).mean())


def width_in_words(widths: Sequence[Array]) -> str:
    return (
        f"90 % intervals along the cloth's normal: mean width {in_mm(mean_width(widths)):.2f} mm (band90 of each file)"
    )


# of a trial's clouds and the frames that are used
IntervalJudge = Callable[[Sequence[Array], NDArray[np.intp]], IntervalScore | None]


def interval_judges(
    trials: Sequence[Trial], predictor: Predictor, coarse: ForwardModel, motions: Sequence[Motion]
) -> list[IntervalJudge]:
    """Return of each trial what judges the model's intervals at every sixth frame; None of a model without. motions:
    `predictor`'s own, at the trials' times; coarse: moves the drawn models."""
    spread = spread_of(predictor.model)
    if spread is None:
        return [lambda clouds, used: None for _ in trials]
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    frames = [looked_at(trial) for trial in trials]
    times = [trial.times[looked] for trial, looked in zip(trials, frames, strict=True)]
    others = drawn_motions(predictor, coarse, cases, times) if spread.covariance else [[]] * len(trials)

    def judge(
        trial: Trial, frames: NDArray[np.intp], rest: Motion, motion: Motion, others: Sequence[Motion],
        clouds: Sequence[Array], used: NDArray[np.intp],
    ) -> IntervalScore | None:  # fmt: skip
        seen = np.isin(frames, used)
        kept = frames[seen]
        taken, drawn = [clouds[k] for k in kept.tolist()], [other[seen] for other in others]
        one = residuals_of(trial, taken, rest, motion[kept], drawn)
        return IntervalScore.of(one.residual, one.sigma(spread)) if len(one.residual) else None

    rows = zip(trials, frames, rests(predictor, cases), motions, others, strict=True)
    return [partial(judge, *row) for row in rows]

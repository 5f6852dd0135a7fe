"""The band of a predicted motion, half-widths of its 90 % intervals by frame and region, and of shapes at rest; and a
model's intervals against measured trials."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from corrector.shape import LocalFrames
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import SIDE, Case, ForwardModel
from fabdesign.nouns.model import NORMAL90, Spread
from fabdesign.nouns.model_sampling import half_widths, spread_of
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from studies.intervals.calibrate import IntervalScore
from studies.intervals.draws import REGIONS, Motion, drawn_motions, looked_at, region_terms, residuals_of, rests


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
    line = np.array([np.interp(at, np.arange(REGIONS), row) for row in np.eye(REGIONS)]).T
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
        residuals = residuals_of(trial, taken, rest, motion[kept], drawn)
        if not len(residuals.residual):
            return None
        widths = half_widths(spread, residuals.deviation, residuals.moved, residuals.design)
        return IntervalScore.of(residuals.residual, widths / NORMAL90)

    rows = zip(trials, frames, rests(predictor, cases), motions, others, strict=True)
    return [partial(judge, *row) for row in rows]

"""Other branches: cloth that buckles goes one way or another at factors a hair apart, and a descent stays on its side.

What a trial in the wrong branch says counts little in a fit, as little as strays do, so that nothing leads back. Of
factors drawn around those found, along what the other frames leave open, many lie in other branches; the best of them
is a new start.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from studies.calibrate_clouds import Array, Match, Motion, Sample, frames_of, match
from studies.calibrate_normal import FAR

ASTRAY = 0.03  # share of frames astray from which on other branches are tried
_REACH = (2.0, 5.0, 15.0)  # standard deviations
_DRAWS = 16  # of each reach, times trials
_CAP = 0.005  # m: a residual counts no more than this
_FRAMES = 3  # of so many frames one is looked at


def thinned(samples: Sequence[Sample]) -> list[Sample]:
    return [replace(s, times=s.times[::_FRAMES], clouds=s.clouds[::_FRAMES]) for s in samples]


def share_astray(found: Match) -> float:
    """Share of frames whose median residual is over FAR times the usual one, or lost."""
    size = np.where(np.isfinite(found.residual), np.abs(found.residual), np.inf)
    medians = np.array([np.median(size[points]) for points in frames_of(found)[1]])
    return float(np.mean(medians > FAR * np.median(medians)))


def misfit(found: Match) -> float:
    """m, RMS of the residuals, each capped; one that is lost counts as the cap."""
    return float(np.sqrt(np.mean(np.square(np.minimum(np.abs(np.nan_to_num(found.residual, nan=_CAP)), _CAP)))))


def better_branch(
    samples: Sequence[Sample],
    simulate: Callable[[Sequence[Array]], list[list[Motion]]],
    x: Array,
    spread: Array,
    rng: np.random.Generator,
) -> Array | None:
    """(7,) factors around `x` that leave less than it does; None where no draw does.

    simulate: motions of the samples for each of some factors, all in one batch. spread: (7, 7), its columns standard
    deviations along independent directions.
    """
    reach = np.repeat(_REACH, max(1, _DRAWS // len(samples)))
    aim = rng.standard_normal((len(reach), len(x)))
    aim *= reach[:, None] / np.linalg.norm(aim, axis=1, keepdims=True)
    tried = [x, *(x + aim @ spread.T)]
    left = [misfit(match(samples, motions)) for motions in simulate(tried)]
    best = int(np.argmin(left))
    return None if best == 0 else tried[best]

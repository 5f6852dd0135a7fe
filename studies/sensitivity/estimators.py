"""Morris' and Sobol's measures from computed samples, with bootstrap intervals.

scipy.stats.sobol_indices has the same Sobol estimators (the tests compare), but only for complete designs of 2^k rows:
here rows with a failed sample are left out, and a sweep may end early. SALib has the same too, but no input both alone
and in a group, and it would bring pandas and multiprocess.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

Array = NDArray[np.float64]


LEVELS = 4  # of Morris' grid
STEP = LEVELS / (2 * (LEVELS - 1))  # of an elementary effect: 2/3, which makes all levels equally likely
_EDGE = 1e-6  # of the cube, where a normal distribution has no value


def trajectories(inputs: int, count: int, seed: int) -> Array:
    """Return (count, inputs + 1, inputs): one input a step, in a random order, up or down (Morris 1991)."""
    rng = np.random.default_rng([seed, 1])
    low = np.arange(LEVELS // 2) / (LEVELS - 1)  # from where a step up stays within the cube
    paths = np.empty((count, inputs + 1, inputs))
    for path in paths:
        up = rng.random(inputs) < 0.5
        start = rng.choice(low, inputs)
        moved = rng.permutation(inputs)  # the step at which each input does
        on = np.arange(inputs + 1)[:, None] > moved
        path[:] = start + STEP * np.where(up, on, ~on)
    return paths


def saltelli_rows(inputs: int, groups: Sequence[Sequence[int]], count: int, seed: int) -> Array:
    """Return (count, 2 + groups, inputs): a, b, and a with each group's inputs from b (Saltelli et al. 2010), where (a,
    b) are scrambled Sobol points."""
    points = qmc.Sobol(2 * inputs, rng=np.random.default_rng([seed, 2])).random_base2(int(np.ceil(np.log2(count))))
    a, b = np.clip(points[:count, :inputs], _EDGE, 1 - _EDGE), np.clip(points[:count, inputs:], _EDGE, 1 - _EDGE)
    rows = np.stack([a, b, *[a] * len(groups)], axis=1)
    for k, group in enumerate(groups):
        rows[:, 2 + k, list(group)] = b[:, list(group)]
    return rows


RESAMPLES = 500
INTERVAL = 5.0, 95.0  # percentiles of a 90 % interval


@dataclass(frozen=True, eq=False)
class Screening:
    """Morris: elementary effects, changes of the output over an input's whole range. (inputs,) each."""

    mean: Array
    mu_star: Array  # mean of their absolute values (Campolongo et al. 2007)
    sigma: Array  # their standard deviation: from interactions and curvature
    mu_star90: Array  # (inputs, 2)


@dataclass(frozen=True, eq=False)
class Indices:
    """Sobol indices, (groups,) each: shares of the output's variance."""

    first: Array
    total: Array
    first90: Array  # (groups, 2)
    total90: Array


def screening(paths: Array, values: Array, *, seed: int = 0) -> Screening:
    """Return the screening by two trajectories or more (count, inputs + 1, inputs) and their outputs (count, inputs +
    1), all finite."""
    steps = np.diff(paths, axis=1)
    moved = np.abs(steps).argmax(axis=2)  # (count, inputs): which input
    sign = np.sign(np.take_along_axis(steps, moved[..., None], axis=2)[..., 0])
    effects = np.empty(moved.shape)
    np.put_along_axis(effects, moved, np.diff(values, axis=1) * sign / STEP, axis=1)
    size = np.abs(effects)
    resampled = np.array([size[pick].mean(axis=0) for pick in _picks(len(size), seed)])
    return Screening(effects.mean(axis=0), size.mean(axis=0), effects.std(axis=0, ddof=1), _interval(resampled))


def indices(values: Array, *, seed: int = 0) -> Indices:
    """Return the indices by the outputs (rows, 2 + groups) of `saltelli_rows`, all finite and not all equal."""
    first, total = _indices(values)
    resampled = np.array([_indices(values[pick]) for pick in _picks(len(values), seed)])
    return Indices(first, total, _interval(resampled[:, 0]), _interval(resampled[:, 1]))


def _indices(values: Array) -> tuple[Array, Array]:
    """Return the first order by Saltelli et al. 2010, total by Jansen 1999 (their table 2, b and f)."""
    centred = values - values[:, :2].mean()
    a, b, mixed = centred[:, :1], centred[:, 1:2], centred[:, 2:]
    variance = max(float(centred[:, :2].var()), np.finfo(float).tiny)
    return np.mean(b * (mixed - a), axis=0) / variance, 0.5 * np.mean((a - mixed) ** 2, axis=0) / variance


def _picks(count: int, seed: int) -> NDArray[np.int_]:
    return np.random.default_rng([seed, 3]).integers(count, size=(RESAMPLES, count))


def _interval(resampled: Array) -> Array:
    return np.percentile(resampled, INTERVAL, axis=0).T

"""Designs of experiments on the unit cube: Morris' trajectories and Saltelli's rows for Sobol indices.

Both are made from their first sample on, so that a longer design begins with the shorter one.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

Array = NDArray[np.float64]
LEVELS = 4  # of Morris' grid
STEP = LEVELS / (2 * (LEVELS - 1))  # of an elementary effect: 2/3, which makes all levels equally likely
_EDGE = 1e-6  # of the cube, where a normal distribution has no value


def trajectories(inputs: int, count: int, seed: int) -> Array:
    """(count, inputs + 1, inputs): one input a step, in a random order, up or down (Morris 1991)."""
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
    """(count, 2 + groups, inputs): a, b, and a with each group's inputs from b (Saltelli et al. 2010), where (a, b) are
    scrambled Sobol points."""
    points = qmc.Sobol(2 * inputs, rng=np.random.default_rng([seed, 2])).random_base2(int(np.ceil(np.log2(count))))
    a, b = np.clip(points[:count, :inputs], _EDGE, 1 - _EDGE), np.clip(points[:count, inputs:], _EDGE, 1 - _EDGE)
    rows = np.stack([a, b, *[a] * len(groups)], axis=1)
    for k, group in enumerate(groups):
        rows[:, 2 + k, list(group)] = b[:, list(group)]
    return rows

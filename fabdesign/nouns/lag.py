"""A first-order lag, dx/dt = (goal - x) / time, exact for a goal that is constant within each step: of filling, creep,
the friction of a braid over its displacement. The virtual rig, another engine, has its own."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
SHORTEST = 1e-6  # s, under which there is no lag


def after(x: ArrayLike, goal: ArrayLike, step: ArrayLike, time: ArrayLike) -> Array:
    """Return what x is `step` [s] later, with a time constant `time` [s]."""
    return np.asarray(goal + np.subtract(x, goal) * np.exp(-np.divide(step, time)))


def first_order(
    goals: ArrayLike, steps: Iterable[float], time: float, *, start: ArrayLike, falling: float | None = None
) -> Array:
    """Return (n + 1, ...): x at the start and after each of n steps [s], in which it goes to the goals (n, ...).

    falling: the time constant [s] where x falls, if it is another one."""
    falling, path = time if falling is None else falling, [np.asarray(start, np.float64)]
    for goal, step in zip(np.asarray(goals, np.float64), steps, strict=True):
        constant = np.maximum(np.where(goal > path[-1], time, falling), SHORTEST)
        path.append(after(path[-1], goal, step, constant))
    return np.array(path)

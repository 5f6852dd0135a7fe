"""A first-order lag, dx/dt = (goal - x) / time, exact for a goal that is constant within each step: of filling, creep,
the friction of a braid over its displacement. The virtual rig, another engine, has its own."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.nouns.array import Array

SHORTEST = 1e-6  # s, under which there is no lag


def after(x: ArrayLike, goal: ArrayLike, step: ArrayLike, time: ArrayLike) -> Array:
    """Return what x is `step` [s] later, with a time constant `time` [s]."""
    return np.asarray(goal + np.subtract(x, goal) * np.exp(-np.divide(step, time)))


def first_order(
    goals: ArrayLike, steps: ArrayLike, time: float, *, start: ArrayLike, falling: float | None = None
) -> Array:
    """Return (n + 1, ...): x at the start and after each of n steps [s], in which it goes to the goals (n, ...).

    falling: the time constant [s] where x falls, if it is another one."""
    goals, lengths = np.asarray(goals, np.float64), np.asarray(steps, np.float64)
    up, down = (np.exp(-lengths / max(t, SHORTEST)).tolist() for t in (time, time if falling is None else falling))
    x: Any = start if goals.ndim > 1 else float(np.asarray(start))
    path = [x]
    for goal, rising, sinking in zip(goals if goals.ndim > 1 else goals.tolist(), up, down, strict=True):
        x = goal + (x - goal) * (rising if falling is None else np.where(goal > x, rising, sinking))
        path.append(x)
    return np.array(path, np.float64)

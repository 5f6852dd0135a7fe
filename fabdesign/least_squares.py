"""Linear least squares with linear inequalities, for curves that must rise, fall or bend one way."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SLACKS = 1e-6, 1e-7, 1e-4, 1e-3  # in turn, until the inequalities hold
_HELD = 1e-7  # of the data's scale


def least_squares_with_inequalities(a: Array, b: Array, g: Array, h: Array) -> Array:
    """The x (n,) that minimises |a x - b| with g x >= h, by non-negative least squares on the dual.

    a (rows, n) of full column rank, b (rows,), g (inequalities, n), h (inequalities,). The inequalities must admit a
    solution; they hold to about 1e-9 of the data's scale. Source: Lawson and Hanson, Solving Least Squares Problems
    (1974), chapter 23.
    """
    q, r = np.linalg.qr(a)
    target = q.T @ b
    g_r = np.linalg.solve(r.T, g.T).T
    dual = np.vstack([g_r.T, h - g_r @ target])
    dual /= np.linalg.norm(dual, axis=0)
    goal = np.zeros(len(dual))
    goal[-1] = 1.0
    # A slight slack keeps the columns independent where inequalities imply each other; without it the search for u goes
    # astray, and now and then with it.
    for slack in _SLACKS:
        u = non_negative(np.vstack([dual, slack * np.eye(dual.shape[1])]), np.append(goal, np.zeros(dual.shape[1])))
        residual = dual @ u - goal
        x = np.asarray(np.linalg.solve(r, target - residual[:-1] / residual[-1]))
        if (g @ x - h).min() >= -_HELD * np.abs(b).max():
            break
    return x


def non_negative(a: Array, b: Array) -> Array:
    """The x >= 0 that minimises |a x - b|, by the active sets of the same chapter. SciPy has it too, but takes half a
    second to import."""
    x, passive = np.zeros(a.shape[1]), np.zeros(a.shape[1], bool)
    least = 10 * max(a.shape) * np.finfo(float).eps * np.abs(a).sum(axis=0).max()
    for _ in range(3 * len(x)):
        gain = np.where(passive, 0.0, a.T @ (b - a @ x))
        if gain.max() <= least:
            break
        passive[gain.argmax()] = True
        while True:
            q, r = np.linalg.qr(a[:, passive])
            z = np.zeros(len(x))
            z[passive] = np.linalg.solve(r, q.T @ b)
            below = passive & (z <= 0)
            if not below.any():
                break
            way = np.full(len(x), np.inf)  # on which each stays positive
            way[below] = x[below] / np.maximum(x[below] - z[below], 1e-300)
            x += way.min() * (z - x)
            passive &= way > way.min()
            x[~passive] = 0.0
        x = z
    return x

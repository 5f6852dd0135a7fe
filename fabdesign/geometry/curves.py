"""Curves fitted to data: cubic B-splines on even knots, as P-splines use them (Eilers and Marx 1996,
doi:10.1214/ss/1038425655), and least squares with inequalities, for curves that must rise, fall or bend one way."""

import numpy as np

from fabdesign.nouns.array import Array

_SLACKS = 1e-6, 1e-7, 1e-4, 1e-3  # in turn, until the inequalities hold
_HELD = 1e-7  # of the data's scale


def least_squares_with_inequalities(a: Array, b: Array, g: Array, h: Array) -> Array:
    """Return the x (n,) that minimises |a x - b| with g x >= h, by non-negative least squares on the dual.

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
    x = np.linalg.solve(r, target)
    for slack in _SLACKS:
        try:
            u = non_negative(np.vstack([dual, slack * np.eye(dual.shape[1])]), np.append(goal, np.zeros(dual.shape[1])))
        except RuntimeError:
            continue
        residual = dual @ u - goal
        x = np.asarray(np.linalg.solve(r, target - residual[:-1] / residual[-1]))
        if (g @ x - h).min() >= -_HELD * np.abs(b).max():
            break
    return x


def non_negative(a: Array, b: Array) -> Array:
    """Return the x >= 0 that minimises |a x - b|. Raises RuntimeError where the active sets go round in circles."""
    from scipy.optimize import nnls  # here: a sixth of a second that only fits of curves take

    return np.asarray(nnls(a, b)[0])


def design_matrix(x: Array, count: int, derivative: int = 0) -> Array:
    """Return (..., count) values of every B-spline, or their derivatives, at x (...), in knot spans from the first
    knot. Outside the knots they continue linearly."""
    from scipy.interpolate import BSpline

    inside = np.clip(x, 0.0, count - 3)
    splines = BSpline(np.arange(-3.0, count + 1), np.eye(count), 3)
    if derivative:
        return np.asarray(splines(inside, nu=derivative))
    return np.asarray(splines(inside) + (x - inside)[..., None] * splines(inside, nu=1))

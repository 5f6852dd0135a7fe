"""Linear least squares with linear inequalities, for curves that must rise, fall or bend one way."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SLACK = 1e-6


def least_squares_with_inequalities(a: Array, b: Array, g: Array, h: Array) -> Array:
    """The x (n,) that minimises |a x - b| with g x >= h, by non-negative least squares on the dual.

    a (rows, n) of full column rank, b (rows,), g (inequalities, n), h (inequalities,). The inequalities must admit a
    solution; they hold to about 1e-9 of the data's scale. Source: Lawson and Hanson, Solving Least Squares Problems
    (1974), chapter 23.
    """
    from scipy.optimize import nnls

    q, r = np.linalg.qr(a)
    target = q.T @ b
    g_r = np.linalg.solve(r.T, g.T).T
    dual = np.vstack([g_r.T, h - g_r @ target])
    dual /= np.linalg.norm(dual, axis=0)
    goal = np.zeros(len(dual))
    goal[-1] = 1.0
    # A slight slack keeps the columns independent where inequalities imply each other; without it nnls goes astray.
    slack = _SLACK * np.eye(dual.shape[1])
    u, _ = nnls(np.vstack([dual, slack]), np.append(goal, np.zeros(len(slack))), maxiter=50 * len(slack))
    residual = dual @ u - goal
    return np.asarray(np.linalg.solve(r, target - residual[:-1] / residual[-1]))

"""Cubic B-splines on even knots, as P-splines use them (Eilers and Marx 1996, doi:10.1214/ss/1038425655).

A spline over s spans has s + 3 coefficients. Where their differences do not change sign, neither does its derivative.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def weights(x: Array, count: int, order: int) -> tuple[NDArray[np.int64], tuple[Array, Array, Array, Array]]:
    """First index and the four cubic B-spline weights (or their derivatives) at x, in knot spans from the first knot.

    Outside the knots the weights continue linearly.
    """
    inside = np.clip(x, 0.0, count - 3)
    i = np.minimum(inside.astype(np.int64), count - 4)
    t = inside - i
    s = 1.0 - t
    slope = (-s * s / 2, (3 * t * t - 4 * t) / 2, (3 * s * s - 4 * s) / -2, t * t / 2)
    if order == 1:
        return i, slope
    value = (s**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (3 * s**3 - 6 * s**2 + 4) / 6, t**3 / 6)
    beyond = x - inside
    w = [v + beyond * d for v, d in zip(value, slope, strict=True)]
    return i, (w[0], w[1], w[2], w[3])


def design_matrix(x: Array, count: int) -> Array:
    """(rows, count) values of every B-spline at x."""
    i, w = weights(x, count, 0)
    out = np.zeros((len(x), count))
    for a in range(4):
        out[np.arange(len(x)), i + a] = w[a]
    return out

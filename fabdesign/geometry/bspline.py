"""Cubic B-splines on even knots, as P-splines use them (Eilers and Marx 1996, doi:10.1214/ss/1038425655).

A spline over s spans has s + 3 coefficients. Where their differences do not change sign, neither does its derivative.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def design_matrix(x: Array, count: int, derivative: int = 0) -> Array:
    """Return (..., count) values of every B-spline, or their derivatives, at x (...), in knot spans from the first
    knot. Outside the knots they continue linearly."""
    from scipy.interpolate import BSpline

    inside = np.clip(x, 0.0, count - 3)
    splines = BSpline(np.arange(-3.0, count + 1), np.eye(count), 3)
    if derivative:
        return np.asarray(splines(inside, nu=derivative))
    return np.asarray(splines(inside) + (x - inside)[..., None] * splines(inside, nu=1))

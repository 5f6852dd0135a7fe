"""Non-negative least squares against SciPy's."""

import numpy as np
import pytest
from scipy.optimize import nnls

from fabdesign.least_squares import non_negative


@pytest.mark.parametrize("rows, columns", [(3, 3), (20, 5), (60, 40), (200, 150)])
def test_same_as_scipy(rows, columns):
    rng = np.random.default_rng(rows)
    for _ in range(10):
        a, b = rng.standard_normal((rows, columns)), rng.standard_normal(rows)
        np.testing.assert_allclose(non_negative(a, b), nnls(a, b)[0], atol=1e-9)


def test_polynomial_of_a_curve():
    strain = np.linspace(0, 0.2, 9)
    a = np.stack([strain, strain**2, strain**3], axis=1)
    for tension in (300 * strain + 2e4 * strain**3, 300 * strain - 400 * strain**2, -strain):
        np.testing.assert_allclose(non_negative(a, tension), nnls(a, tension)[0], rtol=1e-9, atol=1e-9)

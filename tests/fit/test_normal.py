"""The normal equations of a fit beside the same done slowly, with the covariance of a block written out."""

from types import SimpleNamespace

import numpy as np
import pytest

from optimize.fit.descent import fit
from optimize.fit.misfit import Misfit
from optimize.fit.normal import MODES, normal_equations
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.problem import BenchProblem, InputErrors, Linearisation, fingerprint

BLOCKS, POINTS = 12, 400
SIGMA = 0.6e-3  # m


def linearised(jacobian, residual):
    """BLOCKS trials with one frame of POINTS points each."""
    count = len(residual)
    trial = np.repeat(np.arange(BLOCKS), POINTS)
    misfit = Misfit(residual, trial, np.zeros(count, np.intp), trial)
    return Linearisation(np.zeros(jacobian.shape[1]), misfit, [], jacobian)


def vector(count, deviation=0.15):
    return FitVector(tuple(FitParameter(f"p{k}", deviation) for k in range(count)))


def test_information_is_that_of_a_block_s_whole_covariance():
    """J^T (sigma^2 I + U U^T)^-1 J summed over blocks, sigma^2 that of MODES observations of POINTS."""
    rng = np.random.default_rng(0)
    jacobian, errors = rng.normal(0, 5e-3, (BLOCKS * POINTS, 3)), rng.normal(0, 1e-3, (BLOCKS * POINTS, 2))
    residual = np.clip(rng.normal(0, SIGMA, BLOCKS * POINTS), -SIGMA, SIGMA)  # none counts less
    unknowns = vector(3)
    normal = normal_equations(
        linearised(jacobian, residual), np.zeros(3), unknowns,
        InputErrors(errors, np.zeros(len(errors))),
    )  # fmt: skip
    assert normal.capped
    expected = np.zeros((3, 3))
    for k in range(BLOCKS):
        rows = slice(k * POINTS, (k + 1) * POINTS)
        j, u = jacobian[rows], errors[rows]
        covariance = POINTS / MODES * normal.scale**2 * np.eye(POINTS) + u @ u.T
        expected += j.T @ np.linalg.solve(covariance, j)
    assert normal.information == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("size", [1e-3, 20e-3])
def test_what_looks_like_an_error_of_the_inputs_is_known_as_well_as_these_at_any_size_of_motion(size):
    """A gain does what all pressures together do: with these good to 1 % in each of K blocks, the gain is known to
    1 % / sqrt(K), not worse, where the motion is large beside the noise."""
    rng = np.random.default_rng(1)
    pattern = rng.normal(0, size, BLOCKS * POINTS)
    residual = np.clip(rng.normal(0, SIGMA, BLOCKS * POINTS), -SIGMA, SIGMA)
    unknowns = vector(1)
    normal = normal_equations(
        linearised(pattern[:, None], residual), np.zeros(1), unknowns,
        InputErrors(0.01 * pattern[:, None], np.zeros(len(pattern))),
    )  # fmt: skip
    known = float(normal.information[0, 0]) ** -0.5
    noise = normal.scale * np.sqrt(POINTS / MODES) / np.linalg.norm(pattern.reshape(BLOCKS, POINTS), axis=1)
    assert known == pytest.approx(np.sum(1 / (0.01**2 + noise**2)) ** -0.5, rel=1e-3)


def test_a_kept_fit_is_that_of_its_unknowns():
    """Of the same name, but with an unknown less or another one, it is computed."""
    kept, computed = {}, []

    class Kept:
        def arrays(self, name, compute):
            if name not in kept:
                kept[name] = compute()
                computed.append(name)
            return kept[name]

    rng, row = np.random.default_rng(0), np.repeat(np.arange(8), 5)
    table, measured = rng.standard_normal((40, 3)), rng.standard_normal(40)

    def fitted(*names):
        vector = FitVector(tuple(FitParameter(name, 1.0) for name in names))
        columns = table[:, : len(names)]
        return fit(BenchProblem(lambda x: columns @ x - measured, row, row, vector), named="some", checkpoint=Kept())

    first = fitted("a", "b")
    assert (fitted("a", "b").x == first.x).all() and len(computed) == 1
    assert len(fitted("a").x) == 1 and len(fitted("a", "c").x) == 2 and len(computed) == 3


def test_fits_to_other_trials_are_kept_apart():
    trials = [SimpleNamespace(trial=SimpleNamespace(name=f"00{k}", design_name="basic", order=k)) for k in range(3)]
    every, without_one = (fingerprint(vector(2), some) for some in (trials, trials[1:]))
    assert every == fingerprint(vector(2), trials) != without_one
    assert every != fingerprint(vector(3), trials)

"""The muscle law: recovery of a known law from noise, and monotonicity by construction."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.errors import InputError
from fabdesign.geometry.curves import least_squares_with_inequalities
from fabdesign.nouns.muscle import BenchTable
from fabdesign.nouns.muscle_law import MuscleLaw

DATA = Path(os.environ.get("FABDESIGN_DATA", Path(__file__).resolve().parents[2] / "../shared/data"))


def known_force(p, eps):
    """A laced muscle: pull that grows with pressure beyond 40 kPa, own stiffness 55 N, 270 N in stretch [N]."""
    pull = 4.2e-5 * 15e3 * np.logaddexp(0, (p - 40e3) / 15e3)
    return pull * np.clip(1 - 3.3 * eps, 0, None) ** 1.5 - 55 * eps + 215 * np.maximum(-eps, 0)


def table(p, eps, force):
    return BenchTable(tuple(np.ravel(p)), tuple(np.ravel(eps)), tuple(np.ravel(force)))


def grid_table(noise, seed=0):
    p, eps = np.meshgrid(np.arange(0, 400.1e3, 50e3), np.arange(-0.02, 0.281, 0.02), indexing="ij")
    return table(p, eps, known_force(p, eps) + noise * np.random.default_rng(seed).standard_normal(p.shape))


def assert_monotone(law):
    p = np.linspace(0, 1000e3, 81)[:, None]
    eps = np.linspace(-0.3, 0.6, 361)
    force = law.tension(p, eps)
    assert (np.diff(force, axis=1) < 0).all()
    inside = eps <= law.contraction_limits[1]
    rise = np.diff(force[:, inside], axis=0)[force[1:, inside] > 0]
    assert rise.min(initial=0) >= -1e-9 * np.abs(force).max()


def test_recovers_a_known_law_from_noise():
    law = MuscleLaw.fit(grid_table(noise=0.1))
    p, eps = np.linspace(0, 400e3, 41)[:, None], np.linspace(-0.02, 0.28, 61)
    error = law.tension(p, eps) - known_force(p, eps)
    assert np.sqrt(np.mean(error**2)) < 0.06  # less than the noise: smoothed, not interpolated
    assert np.abs(error).max() < 0.2
    assert 0.08 < law.misfit < 0.11
    assert_monotone(law)


def test_kink_is_kept_at_rest_length():
    law = MuscleLaw.fit(grid_table(noise=0.05))
    slopes = np.diff(law.tension(100e3, np.array([-1e-6, 0.0, 1e-6]))) / 1e-6
    jump = slopes[0] - slopes[1]
    assert jump == pytest.approx(-215, rel=0.03)
    either_side = law.tension(100e3, np.array([-1e-9, 0.0, 1e-9]))
    assert np.ptp(either_side) < 1e-6


def test_beyond_the_table_it_is_linear():
    law = MuscleLaw.fit(grid_table(noise=0.1))
    assert np.diff(law.tension(np.array([400e3, 700e3, 1000e3]), 0.05), 2) == pytest.approx(0, abs=1e-9)
    assert np.diff(law.tension(300e3, np.array([0.28, 0.38, 0.48])), 2) == pytest.approx(0, abs=1e-9)
    assert law.tension(800e3, 0.0) == pytest.approx(known_force(800e3, 0.0), rel=0.1)


def test_rows_in_any_order_and_place():
    rng = np.random.default_rng(3)
    p, eps = rng.uniform(0, 400e3, 150), rng.uniform(-0.02, 0.28, 150)
    law = MuscleLaw.fit(table(p, eps, known_force(p, eps) + 0.1 * rng.standard_normal(150)))
    grid_p, grid_e = np.linspace(20e3, 380e3, 19)[:, None], np.linspace(0, 0.26, 27)
    error = law.tension(grid_p, grid_e) - known_force(grid_p, grid_e)
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert_monotone(law)


@settings(max_examples=25, deadline=None)
@given(
    data=st.data(),
    pressures=st.integers(2, 6),
    contractions=st.integers(4, 9),
    stretched=st.booleans(),
)
def test_monotone_whatever_the_table(data, pressures, contractions, stretched):
    """Even a table of noise alone gives a law that falls with contraction and rises with pressure."""
    p, eps = np.meshgrid(
        np.linspace(0, 500e3, pressures), np.linspace(-0.05 if stretched else 0.0, 0.25, contractions), indexing="ij"
    )
    seed = data.draw(st.integers(0, 2**32 - 1))
    strength = data.draw(st.sampled_from([0.1, 3.0, 30.0]))
    force = known_force(p, eps) + strength * np.random.default_rng(seed).standard_normal(p.shape)
    assert_monotone(MuscleLaw.fit(table(p, eps, force)))


def test_monotone_where_non_negative_least_squares_goes_astray():
    # with the first slack it misses the inequalities by far
    p, eps = np.meshgrid(np.linspace(0, 500e3, 6), np.linspace(0.0, 0.25, 5), indexing="ij")
    noise = 30.0 * np.random.default_rng(7761).standard_normal(p.shape)
    assert_monotone(MuscleLaw.fit(table(p, eps, known_force(p, eps) + noise)))


def test_too_few_rows_and_bad_values_are_one_line():
    with pytest.raises(InputError, match=r"3 rows at 1 pressures.*expected at least 4 rows"):
        MuscleLaw.fit(table([0.0, 0.0, 0.0], [0.0, 0.1, 0.2], [0.0, -1.0, -2.0]))
    good = grid_table(0)
    with pytest.raises(InputError, match="not finite"):
        MuscleLaw.fit(BenchTable(good.pressure, good.contraction, (float("nan"), *good.force[1:])))
    with pytest.raises(InputError, match="pressure -50 kPa"):
        MuscleLaw.fit(BenchTable((-50e3, *good.pressure[1:]), good.contraction, good.force))


def test_inequalities_against_an_obvious_projection():
    """Nearest rising sequence: pool adjacent violators gives (1, 2.5, 2.5, 4) for (1, 3, 2, 4)."""
    x = least_squares_with_inequalities(np.eye(4), np.array([1.0, 3, 2, 4]), np.diff(np.eye(4), axis=0), np.zeros(3))
    np.testing.assert_allclose(x, [1, 2.5, 2.5, 4], atol=1e-12)


@pytest.mark.skipif(not (DATA / "rig_a").exists(), reason="shared/data is not here")
def test_bench_table_of_the_synthetic_rigs():
    p, eps, force = np.loadtxt(DATA / "rig_a/em20_bench.csv", delimiter=",", skiprows=1).T
    law = MuscleLaw.fit(table(p * 1e3, eps, force))
    assert np.abs(law.tension(p * 1e3, eps) - force).max() < max(0.01 * force.max(), 0.2)
    assert abs(law.tension(0, 0)) < 0.05
    assert_monotone(law)

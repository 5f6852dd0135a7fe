"""Evidence of groups of unknowns: its closed form for one unknown, and which of several that do the same is left."""

from types import SimpleNamespace

import numpy as np
import pytest

from optimize.fit.relevance import evidence

PRIOR = np.array([0.15, 2.0, 0.5, 0.1])  # of a factor, and of three effects


def fit_of(jacobian, truth, *, noise=1.0, seed=0):
    """Return the linear fit of noisy data, as `evidence` takes it."""
    data = jacobian @ truth + noise * np.random.default_rng(seed).standard_normal(len(jacobian))
    information, precision = jacobian.T @ jacobian / noise**2, np.diag(PRIOR**-2.0)
    minimum = np.linalg.solve(information + precision, jacobian.T @ data / noise**2)
    vector = SimpleNamespace(prior=PRIOR, precision=precision)
    return SimpleNamespace(vector=vector, normal=SimpleNamespace(information=information), minimum=minimum), data


GROUPS = {"curl": np.array([1]), "lag": np.array([2]), "droop": np.array([3])}


def test_one_unknown_has_the_evidence_of_the_closed_form():
    """Of data that are z deviations from nothing: (z^2 - 1 - log z^2) / 2, where z is over one (Tipping 2001)."""
    columns = np.linalg.qr(np.random.default_rng(1).standard_normal((200, 4)))[0] * 30
    fit, data = fit_of(columns, np.array([0.1, 0.2, 0.15, 0.0]))
    group_evidence = evidence(fit, GROUPS)
    for name, (k,) in GROUPS.items():
        z = float(columns[:, k] @ data) / 30
        assert group_evidence[name] == pytest.approx(
            max(0.5 * (z**2 - 1 - np.log(z**2)), 0.0) if abs(z) > 1 else 0.0, abs=1e-3
        )
    assert group_evidence["curl"] > 8 and group_evidence["droop"] < 1


def test_of_two_that_do_the_same_one_is_left():
    """The stronger in its prior's deviations: less of a prior costs less."""
    columns = np.random.default_rng(2).standard_normal((300, 4))
    columns[:, 2] = columns[:, 1] + 0.02 * columns[:, 2]
    fit, _ = fit_of(columns, np.array([0.1, 1.5, 0.0, 0.0]))
    group_evidence = evidence(fit, GROUPS)
    assert sorted(group_evidence.values())[1] < 8 < max(group_evidence.values())
    together = evidence(fit, {"both": np.array([1, 2]), "droop": np.array([3])})
    assert together["both"] > 100 and together["droop"] < 4


def test_a_group_without_a_column_is_gone():
    columns = np.random.default_rng(3).standard_normal((100, 4)) * [1, 1, 1, 0]
    fit, _ = fit_of(columns, np.array([0.0, 1.0, 0.5, 0.0]))
    assert evidence(fit, GROUPS)["droop"] == 0.0 and evidence(fit, {}) == {}

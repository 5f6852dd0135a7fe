"""Shapes at rest: where a cloth stands, columns against differences, and recovery of a known truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.trial_file import TrialData
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import Accuracy, Trial
from optimize.fit.at_rest import HELD, RestProblem, Standing, acting_at_rest, standing_of
from optimize.fit.clouds import Sample
from optimize.fit.free_parameters import fit_vector
from optimize.fit.problem import columns
from optimize.fit.significance import NEEDED, needed
from sim import Simulator
from studies.fitting.fits import LEAST, Fits, beginning, fit_at_rest
from studies.fitting.joint_fit import negligible, unneeded
from studies.measured.fit_data import MeasuredData
from studies.measured.used_frames import UsedFrames

DESIGN = build("basic", muscles=4)
SIGMA = 0.3e-3  # m
FREE = ["orthotropy", "line_loss", "supply_droop", "filling_lag", "registration_bias.z", "muscle_creep"]


def trial(design=DESIGN, name="000"):
    return Trial(file=Path(f"{name}.npz"), design_name="basic", design=design, order=0, role="fit")


def recorded(offset, *, seconds=0.8, rows=None):
    """A flat cloth whose middle is off its plane by offset(t) m, at 30 Hz, with noise."""
    rng, time = np.random.default_rng(0), np.arange(round(30 * seconds)) / 30
    u, v = rng.uniform(0, 0.2, (2, 1500))
    clouds = [
        np.column_stack([u, -v, offset(t) * v / 0.2 + SIGMA * rng.standard_normal(1500)]).astype(float) for t in time
    ]
    pressure = np.full((len(time), 1), 1e5) if rows is None else rows(time)
    return TrialData(time, pressure, tuple(clouds))


def stands(data):
    return len([*standing_of(trial(), data, SIGMA, np.random.default_rng(0))])


@pytest.mark.parametrize(
    ("offset", "shapes"),
    [
        (lambda t: 0.01, 1),
        (lambda t: 0.04 * t, 0),  # 40 mm/s at the hem
        (lambda t: 0.002 * np.cos(8.0 * (t - 0.8)), 0),  # a swing of seven times the noise that turns at the end
        (lambda t: 0.02 * np.exp(-t / 0.08), 1),  # it has come to rest
    ],
)
def test_a_cloth_stands_where_its_places_stay(offset, shapes):
    assert stands(recorded(offset)) == shapes


def test_pressures_that_change_sooner_than_a_cloth_comes_to_rest_give_no_shape():
    quick = recorded(lambda t: 0.01, rows=lambda time: 1e4 * np.floor(time / (0.8 * HELD))[:, None])
    assert stands(quick) == 0
    twice = recorded(lambda t: 0.01, rows=lambda time: np.where(time < 0.4, 1e5, 2e5)[:, None])
    assert stands(twice) == 2


@pytest.fixture(scope="module")
def forward():
    return Predictor(Simulator(21), sensing=True)


@pytest.fixture(scope="module")
def vector():
    return fit_vector(FREE, designs=[DESIGN])


@pytest.fixture(scope="module")
def standing(forward):
    """Shapes of a cloth that is stiffer across and loses pressure along its lines, with noise."""
    rng = np.random.default_rng(1)
    pressures = [*(3e5 * np.eye(DESIGN.channels)), *rng.uniform(0, 3e5, (LEAST, DESIGN.channels))]
    effects = (Term("orthotropy", {"ratio": 0.5}), Term("line_loss", {"share": 0.2}))
    cases = [Case(DESIGN, PressureProgram(np.zeros(1), p[None], 1.0), {"muscle_gain": 1.1}, effects) for p in pressures]
    shapes = forward.equilibria(cases)
    clouds = [np.asarray(s, float)[rng.choice(len(s), 300)] + SIGMA * rng.standard_normal((300, 3)) for s in shapes]
    return tuple(
        Standing(Sample(trial(name=f"{k:03d}"), np.array([1.5]), (cloud,)), p)
        for k, (cloud, p) in enumerate(zip(clouds, pressures, strict=True))
    )


def test_columns_are_what_differences_of_shapes_do_at_the_measured_points(forward, vector, standing):
    acting = acting_at_rest(vector)
    assert "muscle_creep.share" not in acting.names and "registration_bias.z" in acting.names
    problem = RestProblem(standing[:3], forward.faces_jacobian, acting)
    x = 0.5 * acting.prior
    state = problem.linearise(problem.evaluate([x])[0], np.eye(len(x)))
    for name in ("bending", "muscle_gain", "orthotropy.ratio", "line_loss.share", "registration_bias.z"):
        k = acting.names.index(name)
        step = 0.3 * acting.prior[k] * np.eye(len(x))[k]
        up, down = problem.evaluate([x + step, x - step])
        changes = [(a.middle - b.middle)[None] / (2 * step[k]) for a, b in zip(up.sheets, down.sheets, strict=True)]
        difference = columns(state, changes)[:, 0]
        off = np.linalg.norm(state.jacobian[:, k] - difference) / np.linalg.norm(difference)
        assert off < 0.05, name
    assert not state.jacobian[:, acting.names.index("filling_lag.fill")].any()


def test_errors_of_the_pressures_are_shares_of_each_channels_own(forward, vector, standing):
    """A channel without pressure moves nothing; all channels up by 1 % do what the gain of all muscles does."""
    acting = acting_at_rest(vector)
    problem = RestProblem(standing[:2], forward.faces_jacobian, acting, Accuracy(pressure=0.01, tilt=0.5))
    there = problem.evaluate([acting.start])[0]
    inputs, first = problem.input_errors(there), there.misfit.sample == 0
    assert np.abs(inputs.columns[first, 0]).max() > 1e-5
    assert np.abs(inputs.columns[first, 1 : DESIGN.channels]).max() < 1e-7
    assert np.abs(inputs.columns[:, -2]).max() > 1e-5 and inputs.columns.shape[1] == DESIGN.channels + 2


def test_a_known_truth_is_found_and_what_is_nothing_lies_aside(forward, vector, standing):
    data = MeasuredData(
        (), (), (), SensorNoise(SIGMA, 0.0, 0.0), UsedFrames(None, 0.0), Accuracy(0.0, 0.0), 0, standing
    )
    fitted = fit_at_rest(data, Fits(forward, 0.5e-3), vector)
    names, deviation = fitted.vector.names, np.sqrt(np.diag(fitted.covariance))
    truth = {
        "orthotropy.ratio": np.log(0.5),
        "line_loss.share": 0.2,
        "supply_droop.share": 0.0,
        "muscle_gain": np.log(1.1),
    }
    for name, value in truth.items():
        k = names.index(name)
        assert abs(fitted.x[k] - value) < max(3 * deviation[k], 0.1 * abs(value)), name
    assert fitted.after < 1.1 * SIGMA
    assert {*needed(fitted.minimum, fitted.covariance, fitted.vector, NEEDED)} == {"orthotropy", "line_loss"}
    assert {"supply_droop", "registration_bias"} <= negligible(fitted, 0.5e-3) <= {"supply_droop", "registration_bias"}

    dropped = unneeded(fitted)
    assert dropped == {*fitted.vector.labels} - {"orthotropy", "line_loss", "filling_lag"}  # which moves no shape
    without = dict(zip(vector.names, beginning(vector, fitted, dropped), strict=True))
    assert without["supply_droop.share"] == 0.0 and without["filling_lag.fill"] > 0
    assert without["line_loss.share"] == pytest.approx(0.2, abs=0.05)

    begun = dict(zip(vector.names, beginning(vector, fitted, ()), strict=True))
    assert begun["orthotropy.ratio"] == fitted.x[names.index("orthotropy.ratio")]
    assert begun["filling_lag.fill"] == vector.start[vector.names.index("filling_lag.fill")] > 0
    assert begun["muscle_creep.share"] == vector.start[vector.names.index("muscle_creep.share")]


def test_a_shape_on_another_side_than_the_measured_one_takes_no_part(forward, vector, standing):
    """One cloud of many is that of the cloth bent to the other side."""
    other = standing[0].sample
    turned = replace(standing[0], sample=replace(other, clouds=tuple(c * [1, 1, -1] for c in other.clouds)))
    problem = RestProblem([turned, *standing[1:]], forward.faces_jacobian, acting_at_rest(vector))
    found = problem.evaluate([problem.vector.start])[0].misfit
    whole = RestProblem(standing, forward.faces_jacobian, problem.vector).evaluate([problem.vector.start])[0].misfit
    assert np.isnan(found.residual[found.sample == 0]).all()
    assert np.isfinite(found.residual[found.sample != 0]).all() and np.isfinite(whole.residual).all()


def test_few_shapes_say_nothing(forward, vector, standing):
    data = MeasuredData((), (), (), SensorNoise(SIGMA, 0.0, 0.0), UsedFrames(None, 0.0), Accuracy(0.0, 0.0), 0)
    assert fit_at_rest(data, Fits(forward, 0.5e-3), vector) is None
    assert fit_at_rest(replace(data, standing=standing), Fits(object(), 0.5e-3), vector) is None

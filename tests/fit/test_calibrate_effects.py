"""Effects fitted together, against clouds of the simulator itself with two of them in it."""

from dataclasses import replace

import numpy as np
import pytest

from fabdesign.effects import EFFECTS
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import PARAMETERS, Case, Term
from fabdesign.nouns.pressure import PressureProgram
from optimize.fit.free_parameters import fit_vector
from sim import Simulator
from studies.calibration.calibrate import CalibrationOptions, most_trials
from studies.calibration.calibrate import calibrate_sets as calibrate
from tests.simulated_set import simulated_set

TIMES = np.arange(1, 9) / 16  # s
CURL, FILL = 1.2, 0.12  # 1/m, s
PUT_IN = (
    Term("rest_curvature", {"across": 0.0, "down": CURL, "twist": 0.0}),
    Term("filling_lag", {"fill": FILL, "empty": FILL}),
)


PLACES = {"local_stiffening": 6, "added_mass": 4}  # that are tried


def test_all_are_the_strengths_of_every_effect_at_each_of_its_choices():
    names = fit_vector(["all"]).names
    assert {"rest_curvature.down", "filling_lag.fill", "muscle_creep.share"} < {*names}
    assert not any(name.startswith("learned") for name in names)
    assert "muscle_creep.time" not in names and not any(name.startswith("odd_muscle") for name in names)
    assert (
        len({*names})
        == len(names)
        == 7
        + sum(len(e.strengths) * PLACES.get(e.name, 1) for e in EFFECTS.values() if e.named and e.name != "odd_muscle")
    )
    of_channels = [
        name
        for name in fit_vector(["all"], designs=[build("vertical", muscles=3)]).names
        if name.startswith("odd_muscle")
    ]
    assert of_channels == [f"odd_muscle:{channel}.factor" for channel in range(3)]


def test_every_term_of_a_model_stays_and_is_free_by_its_effects_name():
    odd = [Term("odd_muscle", {"channel": float(k), "factor": 0.9 - k / 10}) for k in (0, 2)]
    lag = Term("filling_lag", {"fill": 0.2, "empty": 0.1})
    designs = [build("vertical", muscles=3)]
    held = fit_vector(["dead_time"], terms=[*odd, lag], designs=designs)
    assert held.terms[:3] == (*odd, lag) and held.terms_at(held.start)[:3] == (*odd, lag)
    for free in ["odd_muscle"], ["odd_muscle", "all"], ["all"]:
        vector = fit_vector(free, terms=[*odd, lag], designs=designs)
        ours = [name for name in vector.names if name.startswith("odd_muscle")]
        assert ours == ["odd_muscle:0.factor", "odd_muscle:2.factor"]
        assert vector.terms_at(vector.start)[:3] == (*odd, lag)  # where the model has them
    one = fit_vector(["odd_muscle:channel=2"], terms=[*odd, lag], designs=designs)
    assert [name for name in one.names if "." in name] == ["odd_muscle:2.factor"]
    added = fit_vector(["odd_muscle:channel=1"], terms=[*odd, lag], designs=designs)
    assert [name for name in added.names if "." in name] == ["odd_muscle:1.factor"] and len(added.terms) == 4


def test_two_effects_are_found_among_four(tmp_path):
    # from the data sheet: the factors alone go where neither is found from (muscle gain and damping far off)
    design, rng, forward = build("cross", muscles=2), np.random.default_rng(2), Simulator(points_per_side=11)
    noise = SensorNoise(0.0005, 0.0, 0.05)
    programs = [PressureProgram(np.array([0.0]), rng.uniform(50e3, 300e3, (1, design.channels)), 0.5) for _ in range(2)]
    measured = simulated_set(
        tmp_path / "set", forward, design, programs, TIMES, noise=noise, points=300, rng=rng, effects=PUT_IN
    )
    vector = fit_vector(["rest_curvature.down", "filling_lag.fill", "air_drag", "orthotropy"])
    calibration = calibrate(
        measured, forward, vector=vector, options=CalibrationOptions(engines=np.zeros(len(vector.names)))
    )
    at = {p.name: p.value(x) for p, x in zip(vector.parameters, calibration.fit.x, strict=True)}
    assert calibration.fit.after < 0.7e-3 < calibration.fit.without_effects.after / 2
    assert abs(at["rest_curvature.down"] - CURL) < 0.2
    assert abs(at["filling_lag.fill"] - FILL) < 0.03


def test_what_is_learned_on_one_layout_is_what_happens_on_another(tmp_path):
    """Coefficients without a name, in place of the two effects that were put in."""
    rng, forward = np.random.default_rng(4), Simulator(points_per_side=11)

    def program(design):
        return PressureProgram(np.array([0.0]), rng.uniform(100e3, 300e3, (1, design.channels)), 0.5)

    design, other = build("cross", muscles=2), build("vertical", muscles=3)
    measured = simulated_set(
        tmp_path / "set", forward, design, [program(design) for _ in range(2)], TIMES,
        noise=SensorNoise(0.0005, 0.0, 0.05), points=200, rng=rng, effects=PUT_IN,
    )  # fmt: skip
    held = [name for name in PARAMETERS if name != "muscle_gain"]
    vector = fit_vector(["learned.down", "learned.quick", "learned.stroke"], held)
    calibration = calibrate(
        measured, forward, vector=vector, options=CalibrationOptions(engines=np.zeros(len(vector.names)))
    )
    case = Case(other, program(other))
    learned = replace(case, factors=calibration.model.factors, effects=calibration.model.terms)
    plain, learned, true = (
        motion.middle for motion in forward.run([case, learned, replace(case, effects=PUT_IN)], [TIMES] * 3)
    )
    assert np.abs(learned - true).max() < 0.1 * np.abs(plain - true).max() > 0.5e-3


@pytest.mark.parametrize(
    ("allowed", "effects", "most"), [(95, False, 16), (20, True, 16), (40, True, 20), (200, True, 48)]
)
def test_half_of_many_trials_are_fitted_where_effects_are(allowed, effects, most):
    assert most_trials(allowed, effects=effects) == most

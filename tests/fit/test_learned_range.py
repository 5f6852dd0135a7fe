"""How far the pressures went that learned coefficients were fitted to: kept by a calibration, said of a prediction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.model_file import read_model, write_model
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.model import EffectTerm, Model
from fabdesign.nouns.pressure import LearnedRange, PressureProgram, rising_program
from optimize.fit.free_parameters import fit_vector
from studies.calibration.calibrate import CalibrationOptions
from studies.calibration.calibrate import calibrate_sets as calibrate
from studies.prediction.forward_model import extrapolated
from tests.fit.test_calibrate import TIMES, Curler, write

RANGE = LearnedRange(350e3, 400e3, 2)


class Stroker(Curler):
    """Curls the more, the more tension is learned by contraction."""

    def _motion(self, case, times):
        more = sum(term.values.get("stroke", 0.0) for term in case.effects)
        gain = case.factors.get("muscle_gain", 1.0) * (1 + 0.01 * more)
        return super()._motion(replace(case, factors={**case.factors, "muscle_gain": gain}), times)


def test_a_calibration_keeps_how_far_what_it_learned_from_goes(tmp_path: Path) -> None:
    measured = write(tmp_path / "set", [100, 300, 200, 150], times=TIMES[:5])
    held = [name for name in PARAMETERS if name not in ("bending", "damping")]
    forward, engines = Stroker(), np.zeros(3)
    model = calibrate(
        measured, forward, vector=fit_vector(["learned.stroke"], held), options=CalibrationOptions(engines=engines)
    ).model
    channels = measured.designs["cross"].channels
    assert model.learned_range == LearnedRange(300e3, 3e6, channels)  # of role fit, steps
    write_model(model, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml") == model
    [line] = extrapolated(model, [constant_program([400e3] * channels)])
    assert line == (
        "beyond what the model has learned: pressures up to 400 kPa; learned from up to 300 kPa, "
        "rates up to 4000 kPa/s; learned from up to 3000 kPa/s"
    )
    assert not extrapolated(model, [trial.program for trial in measured.trials])
    plain = calibrate(
        measured, forward, vector=fit_vector([], held), options=CalibrationOptions(engines=engines[:2])
    ).model
    assert plain.learned_range is None


def test_each_quantity_is_told_by_itself() -> None:
    def sentence(last: list[float], rise: float) -> str | None:
        return RANGE.beyond([rising_program(np.array(last), rise, 1.5)])

    assert sentence([350e3, 0.0, 0.0], 1.0) is None
    assert sentence([0.0, 350e3, 0.0], 0.5) == (
        "beyond what the model has learned: rates up to 700 kPa/s; learned from up to 400 kPa/s"
    )
    assert sentence([50e3, 50e3, 50e3], 1.0) == (
        "beyond what the model has learned: up to 3 channels at once; learned from up to 2"
    )
    every = RANGE.beyond([constant_program([400e3, 1e3, 1e3]), constant_program([1e3, 1e3, 1e3])])
    assert every is not None
    assert "up to 400 kPa;" in every and "up to 4000 kPa/s" in every and "3 channels" in every


def test_a_rate_is_that_of_a_ramp_however_finely_it_is_given() -> None:
    for rows in (20, 60, 500):
        time = np.arange(rows) / rows  # s
        program = PressureProgram(time, 250e3 * np.arange(1, rows + 1)[:, None] / rows, 2.0)
        assert LearnedRange.of([program]).rate == pytest.approx(250e3, rel=0.03)


def test_only_of_models_that_have_learned_and_say_from_what() -> None:
    far, learned = [constant_program([900e3])], (EffectTerm("learned", scope="rig"),)
    assert extrapolated(Model(effects=learned, learned_range=RANGE), far)
    assert not extrapolated(Model(effects=learned), far)  # a file of before
    assert not extrapolated(Model(effects=learned, learned_range=RANGE).without(["rig"]), far)
    assert not extrapolated(Model(effects=(EffectTerm("filling_lag"),), learned_range=RANGE), far)
    assert not extrapolated(None, far)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("pressure = -1", "pressure = -1; expected a number from 0"),
        ("pressure = 300\nrate = -2", "rate = -2; expected a number from 0"),
        ("pressure = 300\nrate = 1\nchannels = 1.5", "channels = 1.5; expected a whole number"),
        ("pressure = 300\nrate = 1\nchannels = 2\nspeed = 1", "speed"),
    ],
)
def test_a_range_that_cannot_be_is_one_line(tmp_path: Path, line: str, expected: str) -> None:
    (tmp_path / "m.toml").write_text(f'format = "fabdesign.model/1"\n[learned_range]\n{line}\n')
    with pytest.raises(InputError, match=expected):
        read_model(tmp_path / "m.toml")

"""Intervals as part of a model: calibrated on trials not fitted, judged, shown, and gone with the model's change."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from sheets import rolled_sheet

from fabdesign.errors import InputError
from fabdesign.files.measurement_set import MeasurementSet, NewTrial, TrialData, read_set, write_set
from fabdesign.files.model_file import read_model, usable_model, write_model
from fabdesign.files.motion_file import read_band
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Covariance, Model, Parameter
from fabdesign.nouns.model_sampling import spread_hash, spread_of
from studies.calibration import calibrate as calibration
from studies.intervals.calibrate import over_nodes, width_in_words, with_spread
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.evaluation_report import tables_markdown
from studies.prediction.forward_model import forward_model
from studies.prediction.predict import predict

DESIGN = build("cross")
TIMES = np.arange(1, 13) * 0.05
MODEL = Model({"bending": Parameter(1.0)}, covariance=Covariance(("bending",), np.array([[1e-4]])))


class Roll:
    """Rolls forward by the pressure over its bending stiffness, within 0.2 s, whatever the muscles are."""

    def __init__(self) -> None:
        self.asked = 0

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        self.asked += len(cases)
        return [
            rolled(case.program.pressure.max(), case.factors.get("bending", 1.0), t)
            for case, t in zip(cases, times, strict=True)
        ]


def rolled(pascals: float, bending: float, times: np.ndarray, *, off: float = 1.0) -> np.ndarray:
    turns = 0.2 + off * pascals / 100e3 / bending * (1 - np.exp(-times / 0.2))
    return np.stack([rolled_sheet(turn) for turn in turns]).astype(np.float32)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> MeasurementSet:
    """24 trials, each off by some 10 % of its motion: ten times what the covariance says. A third are tests."""
    rng, trials = np.random.default_rng(4), []
    errors = 0.1 * norm.ppf((np.arange(8) + 0.5) / 8)
    noise = SensorNoise(0.0003, 0.0, 0.05)
    for order in range(24):
        pressure = np.full((len(TIMES), DESIGN.channels), 1e3 * (50 + 10 * order))
        motion = rolled(pressure.max(), 1.0, TIMES, off=1 + errors[5 * (order // 3) % 8])
        clouds = tuple(noise.draw(Surface.of_faces(frame), 300, rng) for frame in motion)
        role = "test" if order % 3 == 2 else "fit"
        trials.append(NewTrial(f"{order:03d}", "cross", order, role, TrialData(TIMES, pressure, clouds)))
    folder = tmp_path_factory.mktemp("measured")
    write_set(folder, {"cross": DESIGN}, trials, name="rolls", description="synthetic")
    return read_set(folder)


@pytest.fixture(scope="module")
def calibrated(measured: MeasurementSet) -> tuple[Model, str]:
    return with_spread(MODEL, [t for t in measured.trials if t.role == "fit"], Roll())


def test_calibrated_on_some_trials_they_hold_on_others(measured: MeasurementSet, calibrated: tuple[Model, str]) -> None:
    model, sentence = calibrated
    spread = model.spread
    assert spread is not None and spread.trials == 10 and 0.75 <= spread.held <= 1
    assert sentence.startswith("90 % intervals calibrated on 10 trials that were not fitted: mean width ")
    evaluation = evaluate_sets(forward_model(Roll(), model), [measured])
    [design] = evaluation.designs.values()
    intervals = design.intervals
    assert intervals is not None and 0.75 <= intervals.inside <= 1 and intervals.count == 8 * 2 * 9
    shown = json.loads(json.dumps(evaluation.to_json()))["designs"]["cross"]
    assert shown["intervals"]["width_mm"] == pytest.approx(1e3 * intervals.width)
    assert shown["trials"]["002"]["intervals"]["inside"] >= 0
    assert f"cross: 90 % intervals hold {intervals.inside:.0%} of the regions' heights" in tables_markdown(evaluation)
    # the covariance alone: 1 % of the motion in place of 10
    alone = replace(spread, constant=1e-6, covariance=1.645, motion=0.0)
    [narrow] = evaluate_sets(forward_model(Roll(), replace(model, spread=alone)), [measured]).designs.values()
    assert narrow.intervals is not None and narrow.intervals.inside < 0.5 < intervals.inside
    assert narrow.intervals.crps > intervals.crps
    [none] = evaluate_sets(forward_model(Roll(), MODEL), [measured]).designs.values()
    assert none.intervals is None and none.after == design.after


def test_too_few_trials_calibrate_nothing(measured: MeasurementSet) -> None:
    forward = Roll()
    model, sentence = with_spread(MODEL, measured.trials[:4], forward)
    assert model.spread is None and forward.asked == 0
    assert sentence == "intervals of motions are not calibrated: 4 trials of role fit are left for it; expected 5"
    model, sentence = with_spread(MODEL, measured.trials, forward, used=lambda trial: np.zeros(len(TIMES), dtype=bool))
    assert model.spread is None and "not calibrated: 0 trials" in sentence


def test_without_a_covariance_the_motion_alone_says_how_wide(measured: MeasurementSet) -> None:
    forward = Roll()
    model, _ = with_spread(Model(), measured.trials, forward)
    assert model.spread is not None and model.spread.covariance == 0.0 and model.spread.motion > 0.05
    assert forward.asked == 10


def test_a_model_that_was_changed_has_no_intervals(calibrated: tuple[Model, str], tmp_path: Path) -> None:
    model, _ = calibrated
    write_model(model, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml") == model
    lines: list[str] = []
    assert spread_of(usable_model(tmp_path / "m.toml", say=lines.append)) == model.spread and not lines
    text = (tmp_path / "m.toml").read_text()
    (tmp_path / "m.toml").write_text(text.replace("factor = 1.0", "factor = 1.1"))
    assert spread_of(usable_model(tmp_path / "m.toml", say=lines.append)) is None
    assert lines == [
        f"{tmp_path / 'm.toml'}: the model was changed since its intervals were calibrated; its motions have none"
    ]
    assert model.without(["spread"]).spread is None and model.without(["sensors"]) == model
    assert model.before.spread is None
    (tmp_path / "m.toml").write_text(text.replace("held = 0.", "held = 1."))
    with pytest.raises(InputError, match=r"spread: held = 1\.\d*; expected a number"):
        read_model(tmp_path / "m.toml")


def test_predictions_have_a_band_that_grows_with_the_motion(
    measured: MeasurementSet, calibrated: tuple[Model, str], tmp_path: Path
) -> None:
    predict(Roll(), calibrated[0], measured.trials[:2], tmp_path / "out")
    bands = [read_band(tmp_path / "out" / "trials" / f"{name}.npz") for name in ("000", "001")]
    assert bands[0] is not None and bands[0].shape == (len(TIMES), 3, 3)
    assert (np.diff(bands[0][:, 2, 1]) > 0).all()  # the free edge moves on
    assert bands[0][-1, 2, 1] > 2 * bands[0][-1, 0, 1]  # and more than the hung one
    width = np.mean([2e3 * np.array(bands)])
    assert f"mean width {width:.2f} mm" in width_in_words(bands)
    predict(Roll(), MODEL, measured.trials[:1], tmp_path / "plain")
    assert read_band(tmp_path / "plain" / "trials" / "000.npz") is None


def test_calibrate_leaves_trials_of_role_test_alone(measured: MeasurementSet, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def spared(model: Model, trials: Sequence, *_: object, **__: object) -> tuple[Model, str]:
        asked[:] = [trial.name for trial in trials]
        return replace(model, spread=None), "said"

    monkeypatch.setattr(calibration, "with_spread", spared)
    result = calibration.calibrate_sets(
        measured, Roll(), options=calibration.CalibrationOptions(orders=[0, 9, 21], intervals=True)
    )
    assert result.intervals == "said"
    assert len(asked) == 10 and not {"000", "009", "021"} & {*asked}
    assert {t.role for t in measured.trials if t.name in asked} == {"fit"}


def test_the_hash_is_of_all_that_a_motion_depends_on(tmp_path: Path) -> None:
    weights = tmp_path / "w.safetensors"
    weights.write_bytes(b"one")
    model = replace(MODEL, corrector=weights)
    wider = replace(MODEL, covariance=Covariance(("bending",), np.array([[2e-4]])))
    hashes = {spread_hash(one) for one in (MODEL, model, wider, replace(MODEL, parameters={}))}
    weights.write_bytes(b"two")
    assert len(hashes | {spread_hash(model)}) == 5


def test_values_of_regions_are_linear_over_the_nodes() -> None:
    values = np.arange(9.0).reshape(3, 3)
    nodes = over_nodes(values, 7)
    assert nodes[3, 3] == pytest.approx(4) and nodes[0, 0] == 0 and nodes[-1, -1] == 8
    assert nodes[1, 3] == pytest.approx(1) and nodes[2, 3] == pytest.approx(2.5)

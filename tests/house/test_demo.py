"""What the demo ships, and what its page says of a measured set."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sheets import rolled_sheet

from benchmarks import demo_model
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model, write_model
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.json_file import plain
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import EffectTerm, Model, Quantity
from studies.demo import measured
from studies.demo.measured import as_blocks
from studies.measured.used_frames import UsedFrames
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.forward_model import forward_model
from studies.prediction.stability import Branches
from studies.report.page import html_of

DATA = Path(measured.__file__).parents[2] / "fabdesign" / "data"


def test_no_trial_that_the_demo_judges_by_was_seen_by_the_shipped_model() -> None:
    shipped, demo_set = read_model(DATA / measured.MODEL), read_set(DATA / measured.SET)
    tests = {f"rig_a/{trial.name}" for trial in demo_set.trials if trial.role == "test"}
    assert len(tests) >= 3
    assert not tests & set(shipped.provenance.fitted)
    assert len(shipped.provenance.fitted) > 60
    assert sum(file.stat().st_size for file in DATA.rglob("*") if file.is_file()) < 5e6


def test_the_demo_set_is_a_part_of_the_measured_one(data: Path) -> None:
    for trial in read_set(DATA / measured.SET).trials:
        original, part = read_trial(data / "rig_a" / "trials" / f"{trial.name}.npz"), trial.load()
        rows = np.searchsorted(original.time, part.time - 1e-9)
        assert part.pressure.tolist() == original.pressure[rows].tolist()
        for row, frame in zip(rows, part.frames, strict=True):
            assert {*map(tuple, frame.tolist())} <= {*map(tuple, original.frames[row].tolist())}


def test_the_shipped_set_is_what_the_command_makes(data: Path, tmp_path: Path) -> None:
    shipped, rig = read_model(DATA / measured.MODEL), read_set(data / "rig_a")
    demo_model.ship(rig, shipped, tmp_path)
    again = read_model(tmp_path / measured.MODEL)
    assert again.corrector == tmp_path / "demo_model.safetensors" and shipped.corrector is not None
    assert again.corrector.read_bytes() == shipped.corrector.read_bytes()
    assert again.parameters == shipped.parameters and again.provenance == shipped.provenance
    made, known = read_set(tmp_path / measured.SET), read_set(DATA / measured.SET)
    assert [trial.name for trial in made.trials] == [trial.name for trial in known.trials]
    for one, other in zip(made.trials, known.trials, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one.load().frames, other.load().frames, strict=True))
    seen = replace(shipped, provenance=replace(shipped.provenance, fitted=(f"rig_a/{made.trials[0].name}",)))
    with pytest.raises(ValueError, match="has seen"):
        demo_model.ship(rig, seen, tmp_path)


def test_without_a_model_the_command_trains_one_and_keeps_it(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def train(measured_set: Path, out: Path, **options: object) -> None:
        asked.append(options["free"])
        (out.parent / "demo_model.safetensors").write_bytes((DATA / "demo_model.safetensors").read_bytes())
        write_model(replace(read_model(DATA / measured.MODEL), corrector=out.parent / "demo_model.safetensors"), out)

    monkeypatch.setattr(demo_model.interface, "train", train)
    command = ["demo_model", str(data / "rig_a"), "--work", str(tmp_path / "work"), "-o", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", command)
    for _ in range(2):
        demo_model.main()
    assert asked == [["all"]]  # once
    assert read_model(tmp_path / "out" / measured.MODEL).corrector == tmp_path / "out" / "demo_model.safetensors"


class Rolling:
    """Rolls, the longer the more, the less it resists, whatever the pressures."""

    def __init__(self) -> None:
        self.asked = 0

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        self.asked += len(cases)
        return [self._motion(case, case_times) for case, case_times in zip(cases, times, strict=True)]

    def _motion(self, case: Case, times: np.ndarray) -> np.ndarray:
        turns = 0.1 + 0.4 / case.factors.get("bending", 1.0) * times
        return np.stack([rolled_sheet(turn, n=41) for turn in turns]).astype(np.float32)


def test_each_model_is_simulated_once_and_evaluated_as_evaluate_does(monkeypatch: pytest.MonkeyPatch) -> None:
    demo_set = read_set(DATA / measured.SET)
    one_trial_set = replace(demo_set, trials=demo_set.trials[:1])
    monkeypatch.setattr(measured, "read_set", lambda folder: one_trial_set)
    monkeypatch.setattr(measured, "find_used_frames", lambda sets, coarse: UsedFrames((), 0.0))
    rolling = Rolling()
    errors = measured.evaluate_shipped(forward=rolling)
    assert rolling.asked == len(errors.errors) == 4  # data sheet, calibrated, with effects, corrected
    [expected] = evaluate_sets(forward_model(Rolling(), errors.shipped), [one_trial_set]).designs.values()
    [trial] = expected.trials
    assert (errors.errors[measured.CALIBRATED], errors.errors[measured.CORRECTED]) == (trial.before, trial.after)
    assert errors.errors[measured.SHEET] != trial.before
    assert errors.by_trial == {trial.trial: trial.after} and errors.far_off == []


def test_the_page_says_what_was_closed() -> None:
    """Excess of 3 mm before, 1.5 mm with effects: half is closed, of a floor of 0.6 mm."""
    floor = 0.6e-3

    def errors(excess: float) -> Errors:
        return Errors(6e-3, 4e-3, float(np.hypot(excess, floor)), floor)

    names = (measured.SHEET, measured.CALIBRATED, measured.EFFECTS, measured.CORRECTED)
    of = dict(zip(names, map(errors, (4e-3, 3e-3, 1.5e-3, 1e-3)), strict=True))
    demo_set = read_set(DATA / measured.SET)
    odd = [
        EffectTerm("odd_muscle", {"channel": Quantity(k, "1"), "factor": Quantity(factor, "1")})
        for k, factor in enumerate((0.9, 0.8, 1.0))
    ]
    off = EffectTerm("dead_time", {"delay": Quantity(0.0, "s", (0.0, 0.01))})
    shipped = Model(effects=(EffectTerm("air_drag", {}), *odd, off))
    by_trial = {"076": errors(1e-3), "077": errors(1e-3), "078": errors(3e-3)}
    far = Branches(demo_set.trials[2], 3e-3, np.array([3.1e-3, 0.9e-3]))
    errors = measured.ShippedErrors(
        replace(demo_set, description="a <synthetic rig>"), shipped, of, 0.0, by_trial, {"078": far}
    )
    page, text, values = html_of("demo", as_blocks(errors)), measured.as_text(errors), plain(errors)
    assert [model["closed"] for model in values["models"]] == [None, None, pytest.approx(0.5), pytest.approx(2 / 3)]
    assert "<td>50%</td>" in page and "<td>67%</td>" in page and "&lt;synthetic rig&gt;" in page
    assert "synthetic rig" in text and "Effects in the model: air drag, odd muscle." in text
    [line] = errors.far_off
    assert line.startswith("Trial 078 is off by 3.06 mm, the others by 1.17. It took another stable shape (branch):")
    assert "comes to 0.90 mm, without the change 3.00 mm." in line and line in page and line in text
    assert values["another_branch"] == {"078": True}
    assert values["effects"] == ["air_drag", "odd_muscle"]
    kept = measured.ShippedErrors.of_kept(json.loads(json.dumps(errors.kept())))
    assert (kept.errors, kept.by_trial, kept.far_off) == (errors.errors, errors.by_trial, errors.far_off)

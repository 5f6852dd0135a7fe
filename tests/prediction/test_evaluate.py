"""Evaluation with a forward model whose errors are known."""

import csv
import dataclasses
import json

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.geometry.metrics import trial_errors
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.model import EffectTerm, Model, Parameter, Quantity
from studies.measured.fit_data import noise_of
from studies.prediction import evaluate
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.evaluation_report import tables_markdown, write_evaluation
from studies.prediction.forward_model import forward_model

NOISE = SensorNoise(0.0006, 0.003, 0.012)
TIMES = np.array([0.1, 0.2, 0.3])
SOFT = Model(parameters={"bending": Parameter(0.5, (0.4, 0.6))})


def motion(kilopascals, bending):
    """Curls with pressure over bending stiffness."""
    return np.stack([rolled_sheet(kilopascals / 50 * t / 0.3 / bending) for t in TIMES]).astype(np.float32)


class Curler:
    """A simulator; what it is short of the truth, `rest` makes up, or an effect odd_muscle."""

    def __init__(self, rest=1.0):
        self.rest = rest
        self.batches = []

    def motions(self, cases, times):
        self.batches.append(len(cases))
        gains = [self.rest * (c.effects[0].values["factor"] if c.effects else 1.0) for c in cases]
        result = [
            motion(c.program.pressure.max() / 1e3 * gain, c.factors.get("bending", 1.0))
            for c, gain in zip(cases, gains, strict=True)
        ]
        for case, points in zip(cases, result, strict=True):
            if case.program.pressure.max() > 390e3:
                points[1:] = np.nan
        return result


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Truth: half the declared bending stiffness and 1.2 of the pressure."""
    design = build("cross")
    rng = np.random.default_rng(0)
    trials = []
    for order, (kilopascals, role) in enumerate([(100, "fit"), (200, "test"), (300, "test"), (395, "fit")]):
        truth = motion(1.2 * kilopascals, 0.5)
        clouds = tuple(NOISE.draw(Surface.of_faces(frame), 600, rng) for frame in truth)
        pressure = np.full((3, design.channels), kilopascals * 1e3)
        trials.append(NewTrial(f"{order:03d}", "cross", order, role, TrialData(TIMES, pressure, clouds)))
    folder = tmp_path_factory.mktemp("set")
    write_set(folder, {"cross": design}, trials, name="curled", description="synthetic")
    return read_set(folder)


def test_data_sheet_against_parameters_on_test_trials_only(measured):
    seen, forward = [], Curler(rest=1.2)
    evaluation = evaluate_sets(forward_model(forward, SOFT), [measured], progress=lambda *done: seen.append(done))
    assert seen == [(1, 2), (2, 2)]
    assert forward.batches == [4]  # two trials, before and after
    assert not evaluation.others
    design = evaluation.designs["cross"]
    assert [t.trial for t in design.trials] == ["001", "002"]
    assert design.after["chamfer"].mean == pytest.approx(design.after["chamfer_floor"].mean, rel=0.02)
    assert design.after["surface_rms"].mean == pytest.approx(design.after["surface_floor"].mean, rel=0.1)
    assert design.before["chamfer"].min > 2 * design.after["chamfer"].max
    assert design.closed.surface == pytest.approx(1, abs=0.05)
    assert design.noise.sigma == pytest.approx(0.0006, rel=0.1)
    printed = json.loads(json.dumps(evaluation.to_json()))
    assert printed["unit"] == "mm"
    values = printed["designs"]["cross"]["before"]["chamfer"]
    trials = [t["before"]["chamfer"] for t in printed["designs"]["cross"]["trials"].values()]
    assert values == pytest.approx(
        {"mean": np.mean(trials), "max": max(trials), "min": min(trials), "std": np.std(trials)}
    )


def test_a_trials_errors_are_those_computed_alone_and_the_noise_is_the_sets(measured, monkeypatch):
    """In batches of two, whose motions are simulated while others are evaluated; one sensor saw both designs."""
    monkeypatch.setattr(evaluate, "AT_ONCE", 2)
    renamed = dataclasses.replace(measured.trials[0], design_name="again")
    both = dataclasses.replace(measured, trials=(renamed, *measured.trials[1:3]))
    noise, seen = noise_of([measured.trials[1], measured.trials[2], renamed]), []
    predictor = forward_model(Curler(), SOFT)
    evaluation = evaluate_sets(
        predictor, [both], roles=["test", "fit"], seed=3, progress=lambda *done: seen.append(done)
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert evaluation.designs["cross"].noise == evaluation.others["again"].noise == noise
    for trial, trial_result in zip(measured.trials[1:3], evaluation.designs["cross"].trials, strict=True):
        for bending, errors in ((1.0, trial_result.before), (0.5, trial_result.after)):
            points = motion(trial.program.pressure.max() / 1e3, bending)
            assert errors == trial_errors(trial.load().frames, points, noise, seed=3 + trial.order)


class Shuffled:
    """A corrector whose points have no order."""

    ordered, starts = False, 0.0

    def history(self):
        return ()

    def correct(self, cases, times, motions):
        order = np.random.default_rng(0).permutation(motions[0].shape[1])
        return [points[:, order] for points in motions]


def test_points_without_an_order_are_compared_by_chamfer_alone(measured, tmp_path):
    predictor = dataclasses.replace(forward_model(Curler(rest=1.2), SOFT), corrector=Shuffled())
    evaluation = evaluate_sets(predictor, [measured])
    design = evaluation.designs["cross"]
    assert design.after["chamfer"].mean == pytest.approx(design.after["chamfer_floor"].mean, rel=0.1)
    assert design.closed.chamfer > 0.9 and design.closed.surface is None and not design.diverged
    printed = evaluation.to_json()["designs"]["cross"]["after"]
    assert printed["surface_rms"]["mean"] is None and printed["chamfer"]["mean"] > 0
    assert "no order, no surface" in tables_markdown(evaluation) and "nan" not in tables_markdown(evaluation)
    write_evaluation(evaluation, tmp_path / "out")
    assert (tmp_path / "out" / "histogram.png").is_file()


def test_effects_are_what_after_adds(measured):
    model = dataclasses.replace(SOFT, effects=(EffectTerm("odd_muscle", {"factor": Quantity(1.2, "1")}),))
    design = evaluate_sets(forward_model(Curler(), model), [measured]).designs["cross"]
    # before: the parameters alone are short of a sixth of the pressure; after: nothing is missing
    assert design.after["surface_rms"].mean == pytest.approx(design.after["surface_floor"].mean, rel=0.1)
    assert design.closed.surface == pytest.approx(1, abs=0.05)
    assert design.before["surface_rms"].mean > 3 * design.after["surface_rms"].mean


def test_other_trials_have_a_table_of_their_own_and_diverged_ones_are_named(measured, tmp_path):
    evaluation = evaluate_sets(forward_model(Curler(), SOFT), [measured], roles=["test", "fit"])
    assert [t.role for t in evaluation.designs["cross"].trials] == ["test", "test"]
    assert evaluation.others["cross"].diverged == ["003"]
    assert len(evaluation.others["cross"].trials) == 2
    text = tables_markdown(evaluation)
    assert "## Other trials" in text
    assert "diverged and left out: 003" in text
    assert "curled: synthetic" in text
    write_evaluation(evaluation, tmp_path / "out")
    with (tmp_path / "out/trials.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["trial"] for row in rows] == ["001", "002", "000", "003"]
    written = json.loads((tmp_path / "out/evaluation.json").read_text())
    assert written["others"]["cross"]["trials"]["003"]["after"]["chamfer"] is None
    assert float(rows[0]["chamfer_after_mm"]) == pytest.approx(
        written["designs"]["cross"]["trials"]["001"]["after"]["chamfer"], rel=1e-5
    )
    assert (tmp_path / "out/histogram.png").stat().st_size > 5000


def test_lone_trial_has_no_spread_and_a_worse_model_is_said_to_be_worse(measured):
    one = dataclasses.replace(measured, trials=measured.trials[1:2])
    worse = Model(parameters={"bending": Parameter(2.0)})
    text = tables_markdown(evaluate_sets(forward_model(Curler(rest=1.2), worse), [one]))
    rows = [row for row in text.splitlines() if row.startswith("| cross")]
    assert all("(" not in row for row in rows)
    assert "the excess grew by" in rows[1] and rows[1].endswith(" * |")
    assert "of the points lie more than 10 mm off" in text


def test_two_sets_with_one_design_and_sets_without_test_trials(measured):
    one = dataclasses.replace(measured, trials=measured.trials[1:2])
    both = evaluate_sets(forward_model(Curler(), SOFT), [one, dataclasses.replace(one, name="again")])
    assert sorted(both.designs) == ["again/cross", "curled/cross"]
    untested = dataclasses.replace(measured, trials=measured.trials[:1])
    with pytest.raises(InputError, match="curled: no trial of role test"):
        evaluate_sets(forward_model(Curler(), SOFT), [untested])
    lost = dataclasses.replace(measured, trials=measured.trials[3:])
    with pytest.raises(SimulationError, match="every motion of cross diverged"):
        evaluate_sets(forward_model(Curler(), SOFT), [lost], roles=["test", "fit"])


class Tosser(Curler):
    """At 300 kPa it lies to one side or the other from 0.15 s on, as the frame leans."""

    def motions(self, cases, times):
        result = super().motions([dataclasses.replace(case, effects=()) for case in cases], times)
        for case, points in zip(cases, result, strict=True):
            leans = sum(term.values["about_x"] for term in case.effects)
            if leans and 290e3 < case.program.pressure.max() < 310e3:
                points[1:, :, 2] += np.float32(0.01 * np.sign(leans))
        return result


def test_sensitive_stretches_are_left_out_and_named(measured, tmp_path):
    blind = evaluate_sets(forward_model(Curler(), SOFT), [measured])
    evaluation = evaluate_sets(forward_model(Curler(), SOFT), [measured], coarse=Tosser())
    assert blind.to_json()["unjudged"] is None
    printed = evaluation.to_json()
    [stretch] = printed["unjudged"]
    assert (stretch["trial"], stretch["from_s"], stretch["to_s"]) == ("002", 0.0, 0.3)
    assert printed["share_unjudged"] == pytest.approx(0.5)
    assert printed["designs"]["cross"]["without_judged_frame"] == ["002"]
    assert not printed["designs"]["cross"]["diverged"]
    means = [one.designs["cross"].after["surface_rms"] for one in (blind, evaluation)]
    assert means[0].std > 0 and means[1].std == 0  # one trial is left
    assert means[1].mean == blind.designs["cross"].trials[0].after.surface_rms
    write_evaluation(evaluation, tmp_path / "out")
    text = (tmp_path / "out/evaluation.md").read_text()
    assert "Left out as sensitive, 50% of the frames: 002 0.0 to 0.3 s" in text and "no frame used: 002" in text
    alone = dataclasses.replace(measured, trials=measured.trials[2:3])
    with pytest.raises(InputError, match="every frame is sensitive, small changes of the inputs lead to another shape"):
        evaluate_sets(forward_model(Curler(), SOFT), [alone], coarse=Tosser())

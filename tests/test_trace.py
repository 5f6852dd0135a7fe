"""Tracing on a made cloth whose effects are known: what is there is found, what is not is not."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sheets import rolled_sheet

from fabdesign.catalogue import build
from fabdesign.effects.acting import acting_pressure, specimen_of
from fabdesign.errors import InputError
from fabdesign.forward import PARAMETERS, Case, Term
from fabdesign.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.metrics import Errors
from fabdesign.model import Model
from fabdesign.model_file import read_model
from fabdesign.output import work_folder
from fabdesign.predictor import Predictor
from fabdesign.pressure import PressureProgram
from fabdesign.sensor_noise import SensorNoise
from fabdesign.splits import fit_trials
from fabdesign.surface import Surface
from fabdesign.trial_file import program_of
from studies.tracing.data import draw, folds_of
from studies.tracing.descent import bounded_step, descend
from studies.tracing.dictionary import Dictionary, Variant, entries_of
from studies.tracing.errors import TrialError, other_layouts
from studies.tracing.experiment import programs
from studies.tracing.fit import Bench
from studies.tracing.full_fit import Ranked, Task
from studies.tracing.grid import COARSE, FINE, Grid, change, error_of, on_grid
from studies.tracing.ranking import (
    Grams,
    Ranking,
    alike,
    covariance,
    cross_validate,
    excess_of,
    grams_of,
    held_out,
    rank,
    sign_vectors,
    stand_ins,
    without_parameters,
)
from studies.tracing.report import render_report
from studies.tracing.run import trace_set
from studies.tracing.stages import Stages
from studies.tracing.together import all_at_once, gains
from studies.tracing.vector import FACTORS, Added, Vector, place_of, scope_of, value_at
from studies.tracing.verdict import Evidence, decide, explains
from studies.tracing.words import as_text

TIMES = np.arange(1, 13) * 0.12
NOISE = SensorNoise(0.0006, 0.002, 0.02)
TRUTH = {"bending": 1.1, "muscle_gain": 0.95}


class Curler:
    """Curls and twists by the pressures that act, late by the damping; stretches by its weight. Effects of pressure
    and muscles act as in the simulator, others do nothing."""

    def motions(self, cases, times):
        return [self._motion(case, np.asarray(t)) for case, t in zip(cases, times, strict=True)]

    def _motion(self, case, times):
        f = dict.fromkeys(PARAMETERS, 1.0) | dict(case.factors)
        tick = 0.02
        acting = acting_pressure(case, int(times[-1] / tick) + 2, tick).means
        gain = specimen_of(case).muscles["gain"]
        pull = np.stack([acting[:, m.channel] for m in case.design.muscles], axis=1) * gain / 100e3
        state, keep = np.zeros(pull.shape[1]), np.exp(-tick / (0.04 * f["damping"]))
        path = [state := keep * state + (1 - keep) * row for row in pull]
        frames = []
        for t in times:
            a, b, *_ = path[min(int(t / tick), len(path) - 1)]
            frame = rolled_sheet(0.1 + (2.0 * a + 1.2 * b) * f["axis_offset"] / f["bending"], n=41)
            frame[:, 2] += 0.4 * (a - b) / f["shear"] * frame[:, 0]
            frame[:, 1] *= 1 + 0.02 * f["areal_density"] / f["membrane"]
            frames.append(frame)
        return np.stack(frames).astype(np.float32)


class Shaker(Curler):
    """With something that no effect of the list does: it flutters across, by the product of the pressures."""

    def _motion(self, case, times):
        frames = super()._motion(case, times)
        levels = case.program.at(times) / 300e3
        size = 0.008 * (levels[:, 0] * levels[:, 1])[:, None] * np.sin(60 * frames[:, :, 0])
        frames[:, :, 2] += size
        return frames


PROGRAMS = [
    ([0, 0.5, 1.0], [[200, 0], [0, 0], [300, 100]]),
    ([0, 0.4, 0.9], [[0, 200], [250, 250], [0, 100]]),
    ([0, 0.7], [[300, 300], [50, 0]]),
    ([0, 0.3, 0.6, 1.2], [[100, 0], [200, 100], [100, 300], [0, 0]]),
    ([0, 0.8], [[0, 300], [200, 0]]),
    ([0, 0.2, 1.0], [[50, 50], [300, 0], [150, 150]]),
    ([0, 0.6, 1.1], [[150, 250], [0, 50], [250, 0]]),
    ([0, 0.5], [[250, 150], [100, 300]]),
]


def write(folder, *, effects=(), forward=None, tests=1, count=8):
    design, rng, trials = build("cross"), np.random.default_rng(5), []
    for order, (rows, kilopascals) in enumerate(PROGRAMS[:count]):
        program = PressureProgram(np.array(rows, float), 1e3 * np.array(kilopascals, float), TIMES[-1])
        pressure = program.at(TIMES - 0.06)
        case = Case(design, program_of(TIMES, pressure), TRUTH, effects)  # as a reader of the trial takes it
        motion = Predictor(forward or Curler(), Model(), sensing=True).motions([case], [TIMES])[0]
        clouds = tuple(NOISE.draw(Surface.of_faces(frame), 150, rng) for frame in motion)
        role = "test" if order >= count - tests else "fit"
        trials.append(NewTrial(f"{order:03d}", "cross", order, role, TrialData(TIMES, pressure, clouds)))
    write_set(folder, {"cross": design}, trials, name="curled", description="synthetic")
    return read_set(folder)


def trace(tmp_path, *, forward=None, **kwargs):
    measured = write(tmp_path / "set", forward=forward, **kwargs)
    return trace_set(measured, tmp_path / "out", inputs=[tmp_path / "set"], forward=Curler())


@pytest.fixture(scope="module")
def lagging(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lag")
    term = Term("filling_lag", {"fill": 0.25, "empty": 0.25})
    return folder, trace(folder, effects=(term,))


def test_a_lag_is_found(lagging):
    _, outcome = lagging
    assert outcome.verdict == "effect"
    assert [effect.name for effect in outcome.effects] == ["filling_lag"]


def test_a_lag_is_found_with_its_size_and_what_it_leaves_is_noise(lagging):
    _, outcome = lagging
    for quantity in outcome.effects[0].parameters.values():
        assert quantity.value == pytest.approx(0.25, abs=0.03)
        assert quantity.interval90[0] < 0.25 < quantity.interval90[1]
    assert outcome.evidence.before > 1e-3
    assert outcome.evidence.after < 0.35 * outcome.evidence.before
    assert explains(outcome.evidence) > 0.65


def test_trace_json_has_what_the_format_says(lagging):
    folder, _ = lagging
    found = json.loads((folder / "out" / "trace.json").read_text())
    assert found["format"] == "fabdesign.trace/1"
    assert {"verdict", "effects", "indistinguishable", "candidates", "error", "residual", "unjudged", "discovered",
            "next_experiment"} <= found.keys()  # fmt: skip
    assert set(found["effects"][0]) == {"name", "site", "scope", "parameters", "explains"}
    assert found["effects"][0]["site"] == "pneumatics"
    assert found["effects"][0]["scope"] == "rig"
    assert set(found["effects"][0]["parameters"]["fill"]) == {"value", "unit", "interval90"}
    named = {row["name"]: row for row in found["candidates"]}
    assert {"none", "filling_lag", "dead_time", "odd_muscle", "braid_hysteresis"} <= named.keys()
    assert named["filling_lag"]["adequate"] and not named["none"]["adequate"]
    error = found["error"]
    assert (error["metric"], error["unit"], error["tolerance"]) == ("surface_rms", "mm", 0.5)
    assert 0.5 < error["noise_floor"] < error["before"]["held_out"]
    assert error["after"]["held_out"] == pytest.approx(error["noise_floor"], rel=0.1)  # it may fall below by chance
    assert {"where", "when_s", "follows"} == found["residual"].keys()


def test_the_model_predicts_with_the_effect_and_remembers_what_was_before(lagging):
    folder, outcome = lagging
    model = read_model(folder / "out" / "model.toml")
    assert model.terms[0].name == "filling_lag"
    assert model.without_effects["bending"].factor != model.parameters["bending"].factor
    assert model.covariance.names[-2:] == ("filling_lag.fill", "filling_lag.empty")
    assert model.parameters["bending"].factor / model.parameters["muscle_gain"].factor == pytest.approx(
        1.1 / 0.95, rel=0.1
    )
    assert model == outcome.model


def test_the_report_is_whole_and_says_the_answer(lagging):
    folder, _ = lagging
    page = (folder / "out" / "report.html").read_text()
    assert "filling lag" in page
    assert "synthetic rig" in page
    assert page.count("<iframe") == 1
    assert "http://" not in page.split("<body>")[1].split("srcdoc")[0]


def test_the_grid_and_its_error_are_said_where_there_was_a_choice(lagging):
    _, outcome = lagging
    assert outcome.as_json()["grid"] == {"points_per_side": 21, "error_mm": None}
    assert "grid" not in as_text(outcome)
    chosen = replace(outcome, search=replace(outcome.search, grid=Grid(21, 0.3e-3)))
    assert chosen.as_json()["grid"] == {"points_per_side": 21, "error_mm": pytest.approx(0.3)}
    assert "grid: 21 points a side, whose error of 0.30 mm counts with the noise" in as_text(chosen)
    assert "Grid: 21 points a side, whose error of 0.30 mm" in render_report(chosen)


def test_the_same_call_goes_on_from_the_stages_and_another_set_is_refused(lagging, tmp_path):
    folder, outcome = lagging

    class Counting(Curler):
        cases = 0

        def motions(self, cases, times):
            self.cases += len(cases)
            return super().motions(cases, times)

    measured, counting = read_set(folder / "set"), Counting()
    again = trace_set(measured, folder / "out", inputs=[folder / "set"], forward=counting)
    assert again.as_json() == outcome.as_json()
    assert counting.cases < 250  # neither the dictionary nor a fit
    other = write(tmp_path / "other")
    with pytest.raises(InputError, match="holds another trace"):
        trace_set(other, folder / "out", inputs=[tmp_path / "other"], forward=Curler())


def test_nothing_is_found_where_nothing_is(tmp_path):
    outcome = trace(tmp_path, tests=0)
    assert outcome.verdict == "adequate"
    assert outcome.effects == ()
    assert outcome.evidence.before < 0.3e-3
    assert outcome.as_json()["error"]["before"]["held_out"] == pytest.approx(
        1e3 * np.hypot(outcome.evidence.before, outcome.floor)
    )


def test_what_no_effect_does_is_unexplained(tmp_path):
    outcome = trace(tmp_path, forward=Shaker(), count=5)
    assert outcome.verdict == "unexplained"
    assert outcome.effects == ()
    assert outcome.model.effects == ()


def test_too_few_trials_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected at least 3"):
        trace(tmp_path, count=3)


def made_grams(strength, *, seed=0, trials=8, points=400):
    """Residuals of `strength` times the second of three columns, which the declared parameter cannot take; the third
    column is nearly the second."""
    rng = np.random.default_rng(seed)
    grams = []
    for _ in range(trials):
        j = rng.standard_normal((points, 1))
        c = rng.standard_normal((points, 3))
        c[:, 2] = c[:, 1] + 0.05 * rng.standard_normal(points)
        r = strength * c[:, 1] + 0.3 * j[:, 0] + 0.6 * rng.standard_normal(points)
        table = 1e-3 * np.column_stack([j, c, r])
        grams.append(table.T @ table)
    index = np.arange(trials)
    found = Grams(np.array(grams), index, index, np.full(trials, float(points)), np.ones(1), np.zeros(1), 200.0)
    variants = tuple(Variant(name, (k,), 1.0, {}) for k, name in enumerate(("wrong", "right", "twin")))
    return found, Dictionary((), variants, np.zeros((0, 3)))


def test_ranking_finds_the_column_that_made_the_residual_and_its_twin():
    grams, dictionary = made_grams(-0.8)
    ranking = rank(grams, dictionary, 0.6e-3)
    by_name = {c.effect: c for c in ranking.candidates}
    assert ranking.candidates[0].effect == "right"
    assert by_name["right"].best.coefficients[0] == pytest.approx(0.8, abs=0.06)
    assert ranking.certain(by_name["right"])
    assert not ranking.certain(by_name["wrong"])
    right, twin, wrong = (by_name[name].best for name in ("right", "twin", "wrong"))
    cosines = alike(grams, right, [twin, wrong])
    assert cosines[0] > 0.98
    assert abs(cosines[1]) < 0.5


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_ranking_is_certain_of_nothing_in_noise(seed):
    grams, dictionary = made_grams(0.0, seed=seed)
    ranking = rank(grams, dictionary, 0.3e-3)
    assert not any(ranking.certain(c) for c in ranking.candidates)


def test_left_out_trials_are_predicted_from_the_others():
    """Against the same done slowly, with each trial's points."""
    grams, _ = made_grams(0.5, trials=3)
    scored = cross_validate(grams, None)
    for out in range(3):
        others = [k for k in range(3) if k != out]
        a, g = (grams.gram[others].sum(axis=0)[s] for s in ((slice(0, 1), slice(0, 1)), (slice(0, 1), -1)))
        step = -np.linalg.solve(a, g)[0]  # its prior says next to nothing here
        own = grams.gram[out]
        assert scored.squares[out] == pytest.approx(own[0, 0] * step**2 + 2 * own[0, -1] * step + own[-1, -1], rel=2e-2)
    assert covariance(grams).shape == (1, 1)


def test_a_parameter_that_is_taken_away_leaves_the_others_and_its_part_of_the_residual():
    """Against the same done slowly, with the points: r - J x of the one that goes."""
    rng = np.random.default_rng(3)
    table, x = rng.normal(size=(40, 4)), np.array([0.5, -2.0, 1.0])  # [J of three, r]
    grams = Grams(
        (table.T @ table)[None], np.zeros(1, int), np.zeros(1, int), np.array([40.0]), np.arange(3.0), x, 10.0
    )
    left = without_parameters(grams, slice(1, 2))
    slow = np.column_stack([table[:, [0, 2]], table[:, 3] + 2.0 * table[:, 1]])
    np.testing.assert_allclose(left.gram[0], slow.T @ slow, rtol=1e-12)
    np.testing.assert_array_equal(left.x, [0.5, 1.0])
    np.testing.assert_array_equal(left.precision, [0.0, 2.0])


def test_what_would_do_as_well_as_an_effect_of_the_state_is_named():
    """The state's second parameter by a column like it, less what its first takes; not by one of another shape."""
    rng = np.random.default_rng(4)
    declared, own, other, noise = (rng.normal(size=400) for _ in range(4))
    twin = own + 3.0 * declared + 0.05 * noise
    table = np.column_stack([declared, own, twin, other, 0.1 * noise])
    grams = Grams(
        (table.T @ table)[None], np.zeros(1, int), np.zeros(1, int), np.array([400.0]), np.full(2, 1e-6),
        np.array([0.3, 2.0]), 400.0,
    )  # fmt: skip
    variants = [Variant("twin", (0,), 1.0, {}), Variant("other", (1,), 1.0, {}), Variant("decoy", (0,), 1.0, {}, True)]
    assert stand_ins(grams, slice(1, 2), variants) == ("twin",)


@given(st.integers(0, 10**6))
def test_a_step_ends_where_the_quadratic_model_is_least_within_the_bounds(seed):
    """Karush, Kuhn and Tucker: inside, no slope; at a bound, a slope out of it."""
    rng = np.random.default_rng(seed)
    vector = Vector((Added("muscle_creep", ("share", "time")), Added("dead_time", ("delay",))))
    root = rng.normal(size=(vector.size, vector.size))
    hessian, gradient = root @ root.T + 0.1 * np.eye(vector.size), 3.0 * rng.normal(size=vector.size)
    x = vector.within(rng.normal(size=vector.size))
    end = x + bounded_step(vector, x, gradient, hessian)
    low, high = vector.bounds
    assert (end >= low - 1e-9).all() and (end <= high + 1e-9).all()
    slope = gradient + hessian @ (end - x)
    inside = (end > low + 1e-6) & (end < high - 1e-6)
    assert np.abs(slope[inside]).max() < 1e-5 * np.abs(gradient).max()
    assert (slope[end <= low + 1e-6] >= -1e-5).all() and (slope[end >= high - 1e-6] <= 1e-5).all()


def test_sign_vectors_are_all_of_them_where_they_are_few():
    rng = np.random.default_rng(0)
    assert len({tuple(row) for row in sign_vectors(4, rng)}) == 7
    assert sign_vectors(20, rng).shape == (200, 20)


@pytest.mark.parametrize(
    ("evidence", "verdict"),
    [
        (Evidence(0.4e-3, 0.1e-3, 0, 0.1e-3, 0.1e-3, True), "adequate"),  # within the tolerance
        (Evidence(2e-3, 2e-3, 0, 2.1e-3, 2.1e-3, False), "adequate"),  # nobody gains
        (Evidence(2e-3, 2e-3, 0, 2.1e-3, 2.1e-3, False, fitted=0.9e-3), "adequate"),
        (Evidence(2e-3, 2e-3, 0, 2.1e-3, 2.1e-3, False, fitted=1.1e-3), "unexplained"),  # nor what it was fitted to
        (Evidence(2e-3, 2e-3, 0, 0.8e-3, 0.8e-3, True), "unexplained"),
        (Evidence(2e-3, 2e-3, 0, 0.8e-3, 0.8e-3, True, fitted=0.9e-3), "adequate"),  # the black box takes little of it
        (Evidence(2e-3, 2e-3, 0, 0.5e-3, 0.5e-3, True, fitted=0.9e-3), "unexplained"),
        (Evidence(2e-3, 0.4e-3, 1, 0.8e-3, 0.4e-3, True), "effect"),
        (Evidence(2e-3, 0.7e-3, 1, 0.8e-3, 0.6e-3, True), "effect"),  # beyond the tolerance, but most of it
        (Evidence(3e-3, 2.2e-3, 1, 0.8e-3, 0.6e-3, True), "unexplained"),  # the best leaves structure
        (Evidence(6e-3, 2e-3, 1, 2.4e-3, 1.6e-3, True, 0.5), "unexplained"),  # that goes with the cloth's pose
        (Evidence(6e-3, 0.4e-3, 1, 2.4e-3, 0.3e-3, True, 0.5), "effect"),  # within the tolerance, whatever is left
    ],
)
def test_the_verdict_is_that_of_the_rules(evidence, verdict):
    assert decide(evidence, 0.5e-3) == verdict


def test_layouts_of_which_no_trial_was_fitted_stand_by_themselves():
    some = Errors(4.2e-3, 4.1e-3, 1e-3, 0.6e-3)
    told = [("a", "fit"), ("a", "test"), ("b", "test"), ("b", "test")]
    errors = [TrialError(str(k), design, role, some, some) for k, (design, role) in enumerate(told)]
    assert {name: [e.trial for e in own] for name, own in other_layouts(errors).items()} == {"b": ["2", "3"]}


def test_a_black_box_that_finds_no_gap_leaves_nothing_to_explain():
    assert explains(Evidence(1e-3, 0.5e-3, 1, 1e-3, 0.5e-3, False)) is None
    assert explains(Evidence(1e-3, 0.25e-3, 1, 0.5e-3, 0.2e-3, True)) == pytest.approx(0.75)


def test_a_vector_is_in_prior_standard_deviations_and_keeps_bounds():
    vector = Vector((Added("muscle_creep", ("share", "time"), scope="muscle_types.EM20"),))
    assert vector.names[-2:] == ("muscle_creep.share", "muscle_creep.time")
    x = vector.centre()
    assert vector.factors(x) == dict.fromkeys(PARAMETERS, 1.0)
    assert vector.terms(x)[0].values == {"share": 0.0, "time": 0.8}
    x[FACTORS:] = [-3.0, 1.0]
    assert vector.terms(x)[0].values["share"] == 0.0
    assert vector.within(x)[FACTORS] == 0.0
    parameter = Added("muscle_creep", ("time",)).declared[0]
    assert place_of(parameter, value_at(parameter, 1.3)) == pytest.approx(1.3)
    assert scope_of("muscle_creep", ["EM20"]) == "muscle_types.EM20"
    assert scope_of("filling_lag", ["EM20"]) == "rig"


def test_the_dictionary_has_every_effect_at_several_shapes_and_sizes():
    entries, variants = entries_of(4, known=["dead_time"])
    assert "dead_time" not in {e.effect for e in entries}
    assert {v.shape["channel"] for v in variants if v.effect == "odd_muscle"} == {0, 1, 2, 3}
    assert len({v.shape["time"] for v in variants if v.effect == "muscle_creep"}) == 3
    assert len(next(v for v in variants if v.effect == "filling_lag").columns) == 2


@pytest.fixture
def task_of(tmp_path):
    """What a trace knows once a set is drawn, the round at a place of the declared parameters, and its stages."""

    def made(measured, x):
        samples, noise = draw(fit_trials(measured.trials), (), seed=0)
        bench = Bench(samples, Predictor(Curler(), Model(), sensing=True))
        state = bench.with_slopes(bench.states(Vector(), [np.asarray(x)])[0])
        folds = folds_of(samples)
        grams = grams_of(bench, state, np.zeros((len(state.found.residual), 0)), folds)
        none = cross_validate(grams, None)
        ranking = Ranking(none, held_out(grams, none), (), 0.0, 0.0, excess_of(grams, none, noise.sigma))
        task = Task(bench, Stages(work, {}), folds, noise.sigma, ["EM20"], 2, (), lambda line: None)
        return task, Ranked(0, "0", state, grams, ranking)

    with work_folder(tmp_path / "out", made_by="trace") as work:
        yield made


def test_a_large_effect_is_found_from_the_data_sheet_whatever_the_refit_made_of_it(tmp_path, task_of):
    """Trials late by 0.1 s, and declared parameters that went three deviations off for want of that."""
    measured = write(tmp_path / "set", effects=(Term("dead_time", {"delay": 0.1}),), count=4)
    task, at = task_of(measured, [1.0, -2.0, 2.0, 0.0, 3.0, 0.0, -3.0])
    found, _ = all_at_once(task, at)
    assert {added.name for added in found.vector.added} <= {"dead_time", "time_offset"}  # from rest these are one
    assert found.vector.added and found.rms < 1.1 * task.floor < 0.25 * at.state.rms


def test_several_effects_are_found_together_and_no_other(tmp_path, task_of):
    effects = Term("filling_lag", {"fill": 0.3, "empty": 0.3}), Term("supply_droop", {"share": 0.15})
    task, at = task_of(write(tmp_path / "set", effects=effects, count=5), np.zeros(FACTORS))
    found, _ = all_at_once(task, at)
    assert [added.name for added in found.vector.added] == ["filling_lag", "supply_droop"]
    assert found.rms < 1.1 * task.floor
    terms = {term.name: term.values for term in found.vector.terms(found.x)}
    assert terms["supply_droop"]["share"] == pytest.approx(0.15, abs=0.02)
    assert terms["filling_lag"]["fill"] == pytest.approx(0.3, abs=0.03)
    told = gains(task.bench, found, task.folds, task.floor)
    assert all(gain.interval90[0] > 0 for gain in told.values())
    assert told["filling_lag"].gain > told["supply_droop"].gain > 0


def test_where_nothing_is_missing_every_effect_is_dropped(tmp_path, task_of):
    task, at = task_of(write(tmp_path / "set", count=4), np.zeros(FACTORS))
    found, plain = all_at_once(task, at)
    assert found.vector == Vector() and plain.vector == Vector()
    assert found.rms == pytest.approx(NOISE.sigma, rel=0.1)


class Rough(Curler):
    """On a grid too coarse: with ripples of 0.7 mm, which no declared parameter makes."""

    def _motion(self, case, times):
        frames = super()._motion(case, times)
        frames[:, :, 2] += 0.7e-3 * np.sin(60 * frames[:, :, 0])
        return frames


class Stiff(Curler):
    """On a grid on which the cloth is stiffer by a tenth, which a declared parameter takes."""

    def _motion(self, case, times):
        return super()._motion(replace(case, factors={**case.factors, "bending": 1.1 * case.factors["bending"]}), times)


@pytest.mark.parametrize(("coarse", "side"), [(Rough(), FINE), (Stiff(), COARSE)])
def test_a_finer_grid_takes_over_where_it_changes_what_the_declared_parameters_cannot_take(tmp_path, coarse, side):
    samples, _ = draw(fit_trials(write(tmp_path / "set", count=4).trials), (), seed=0)
    begin = Bench(samples, Predictor(coarse, Model(), sensing=True))
    finer = Predictor(Curler(), Model(), sensing=True)
    refit = partial(descend, iterations=6)
    state = refit(begin, Vector(), np.zeros(FACTORS))
    with work_folder(tmp_path / "out", made_by="trace") as work:
        bench, after, grid = on_grid(
            begin, Stages(work, {}), state, finer, tolerance=0.5e-3, refit=refit, say=lambda line: None
        )
    assert grid.points_per_side == side
    assert bench.forward is (finer if side == FINE else begin.forward)
    assert after.rms == pytest.approx(NOISE.sigma, rel=0.1)
    if side == FINE:  # 41 points lack a third of what they change of 21, which the refit on 21 is off
        assert state.rms > 1.1 * after.rms
        assert np.hypot(after.rms, 3 * grid.error) == pytest.approx(
            state.rms, rel=0.1
        )  # points between the faces: less
        assert grid.floor(NOISE.sigma) == pytest.approx(np.hypot(NOISE.sigma, grid.error))
    else:
        assert change(begin, state, finer) < 0.1e-3


def test_what_a_grid_lacks_follows_from_what_another_changes():
    """With an error c h^2: c h^2 of 21 points a side, a quarter of 41, three quarters between them."""
    assert error_of(0.75e-3, finer=False) == pytest.approx(1e-3)
    assert error_of(0.75e-3, finer=True) == pytest.approx(0.25e-3)


def test_programs_keep_the_limits():
    design = build("basic")
    for program in programs(design, highest=250e3).values():
        assert program.pressure.shape[1] == design.channels
        assert program.pressure.min() >= 0 and program.pressure.max() <= 250e3

"""Calibration against clouds drawn from a forward model whose factors are known."""

import dataclasses

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.files.model_file import read_model, write_model
from fabdesign.files.trial_file import write_trial
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import Surface, capped_rms
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import PARAMETERS, Term
from fabdesign.nouns.model import NORMAL90, EffectTerm, Model, Quantity
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Accuracy
from optimize.fit import problem as problems
from optimize.fit.clouds import Sample, derivatives, match, nodes_of
from optimize.fit.descent import FitStart, fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.misfit import Misfit
from optimize.fit.normal import Normal, directions
from optimize.fit.parameters import DECLARED, PRIOR
from optimize.fit.problem import Evaluation, FitProblem, Problem
from sim.motion import faces
from studies.calibration.calibrate import DRAWN, CalibrationOptions
from studies.calibration.calibrate import calibrate_sets as calibrate
from studies.calibration.result import as_text
from studies.fitting.fitted_model import engine_difference, interval_warnings, noise_rms
from studies.measured.splits import Tolerance, fit_trials, sound_trials
from tests.restricted_effects import restrict_effects

TIMES = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 1.2])
ONE_ENGINE = np.zeros(7)  # the clouds are the forward model's own
NOISE = SensorNoise(0.0006, 0.003, 0.05)
TRUTH = {"bending": 1.2, "muscle_gain": 0.9, "axis_offset": 1.1, "damping": 1.3, "areal_density": 0.9}


class Curler:
    """Curls by moment over stiffness, gain times offset over bending, late by the damping; sags by its weight.

    Membrane and shear do nothing, and gain and offset are one factor: a calibration must say so.
    """

    def __init__(self, lag=0.0, loses=False, power=1.0):
        self.lag = lag  # its delay is longer by this share in every other trial, shorter in the others
        self.loses = loses  # diverges at high pressure
        self.power = power  # of the damping's factor in the delay: other than 1 is wrong, but not at the data sheet

    def motions(self, cases, times):
        return [self._motion(case, t) for case, t in zip(cases, times, strict=True)]

    def _motion(self, case, times):
        f = dict.fromkeys(PARAMETERS, 1.0) | dict(case.factors)
        pressure = case.program.pressure.max() / 100e3
        final = 2.0 * pressure * f["muscle_gain"] * f["axis_offset"] / f["bending"]
        delay = 0.25 * f["damping"] ** self.power * (1 + self.lag * (-1) ** round(2 * pressure))
        frames = []
        for t in times:
            frame = rolled_sheet(0.1 + final * (1 - np.exp(-t / delay)), n=21)
            frame[:, 1] *= 1 + 0.02 * f["areal_density"]
            frames.append(frame * (np.nan if self.loses and pressure > 3.9 and t > 0.65 else 1.0))
        return np.stack(frames).astype(np.float32)


def write(folder, kilopascals, *, truth=TRUTH, seed=0, points=200, forward=None, times=TIMES):
    from fabdesign.files.trial_file import program_of
    from fabdesign.nouns.forward import Case

    design, rng, trials = build("cross"), np.random.default_rng(seed), []
    for order, kpa in enumerate(kilopascals):
        pressure = np.full((len(times), design.channels), kpa * 1e3)
        case = Case(design, program_of(times, pressure), truth)
        motion = (forward or Curler()).motions([case], [times])[0]
        clouds = tuple(NOISE.draw(Surface.of_faces(frame), points, rng) for frame in motion)
        role = "test" if order == len(kilopascals) - 1 else "fit"
        trials.append(NewTrial(f"{order:03d}", "cross", order, role, TrialData(times, pressure, clouds)))
    write_set(folder, {"cross": design}, trials, name="curled", description="synthetic")
    return read_set(folder)


def exact(measured):
    """Its inputs are known as they were: the fit need not ask what errors of them would do."""
    return dataclasses.replace(measured, accuracy=Accuracy(0.0, 0.0))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    return write(tmp_path_factory.mktemp("set"), [100, 200, 300, 250, 150])


def test_differences_are_taken_along_combinations_that_change_the_shape_by_as_much():
    """Seven factors that all but cancel: single differences of 0.03 would change the weakest combination by 2 um, less
    than a solver's noise; as a difference of its own it is as long as the prior allows."""
    weak = np.ones(7) / np.sqrt(7)
    jacobian = 5e-3 * (np.eye(7) - np.outer(weak, weak)) + 1.5e-4 * np.outer(weak, weak)  # m
    one = np.ones(1)
    sensitivity = jacobian.T @ jacobian
    normal = Normal(np.zeros(7), np.eye(7), np.zeros((1, 7)), 1.0, False, 6e-4, sensitivity, one, one, one)
    chosen = directions(normal)
    change = chosen @ jacobian.T
    assert change @ change.T == pytest.approx(np.diag(np.square(change).sum(axis=1)), abs=1e-12)
    moved = np.sqrt(np.square(change).sum(axis=1))
    assert moved.min() > 2e-5
    assert moved.max() == pytest.approx(2e-4)
    prior = np.array([PRIOR[name] for name in PARAMETERS])
    assert np.sqrt(np.square(chosen / prior).sum(axis=1)).max() == pytest.approx(1.5)


def test_derivatives_are_those_of_moved_surfaces():
    """Residuals of the faces of a mid-surface moved by a small known field, against the first-order change: the faces
    turn with the mid-surface, which the residuals do not see."""
    rng = np.random.default_rng(1)
    base = Shape(rolled_sheet(5.0, n=41)[None]).middle.astype(float)
    field = np.stack([0.3 * base[..., 1], 0.2 * base[..., 0], np.sin(20 * base[..., 1])], axis=-1)
    points = faces(base, 0.002)
    cloud = NOISE.draw(Surface.of_faces(points[0]), 300, rng)
    sample = Sample(None, np.array([0.1]), (cloud,))  # the trial is not looked at
    misfit = match([sample], [points])
    predicted = derivatives(misfit, nodes_of(misfit, 41), [field[None]])[:, 0]
    h = 1e-6
    moved = [Surface.of_faces(faces(base + s * h * field, 0.002)[0]).nearest(cloud).signed for s in (1, -1)]
    difference = (moved[0] - moved[1]) / (2 * h)
    smooth = np.abs(misfit.residual) > 1e-5
    # points whose nearest triangle changes have a kink: few
    assert np.mean(np.abs(predicted - difference)[smooth] < 0.01) > 0.97
    assert np.abs(predicted).max() > 0.5


def test_known_factors_come_back_and_ambiguities_are_said(measured, tmp_path):
    lines = []
    calibration = calibrate(
        exact(measured),
        Curler(),
        progress=lambda line, share: lines.append(line),
        options=CalibrationOptions(engines=ONE_ENGINE),
    )
    f = {name: parameter.factor for name, parameter in calibration.model.parameters.items()}
    # the data fix gain x offset / bending and the delay; which of the three it is, only the data sheet could say
    assert f["muscle_gain"] * f["axis_offset"] / f["bending"] == pytest.approx(0.9 * 1.1 / 1.2, rel=0.01)
    assert f["damping"] == pytest.approx(1.3, rel=0.01)
    for name in ("bending", "muscle_gain", "axis_offset"):
        low, high = calibration.model.parameters[name].interval90
        assert low < TRUTH[name] < high
    low, high = calibration.model.parameters["shear"].interval90
    assert np.log(high / low) == pytest.approx(2 * NORMAL90 * PRIOR["shear"], rel=1e-6)
    statements = "\n".join(calibration.statements)
    assert "shear: these data say little" in statements
    assert "muscle_gain" in statements and "axis_offset" in statements
    assert calibration.fit.after == pytest.approx(np.hypot(0.0006, 0.010 * np.sqrt(0.003)), rel=0.15)
    assert calibration.fit.before > 3 * calibration.fit.after
    assert calibration.noise.sigma == pytest.approx(0.0006, rel=0.15)
    assert calibration.fit.converged and lines
    write_model(calibration.model, tmp_path / "model.toml")
    again = read_model(tmp_path / "model.toml")
    assert again.provenance.fitted == ("curled/000", "curled/001", "curled/002", "curled/003")
    assert again.provenance.held_out == ("curled/004",)
    assert "shear" in as_text(calibration)
    assert set(calibration.to_json()["parameters"]) == set(PARAMETERS)


def test_ctrl_c_keeps_the_values_reached(measured):
    def interrupted(at, free=(), time=1, **options):
        lines = []

        def progress(line, share):
            lines.append(line)
            if sum(line.startswith(at) for line in lines) == time:
                raise KeyboardInterrupt

        return calibrate(
            exact(measured), Curler(), vector=fit_vector(free), progress=progress, options=CalibrationOptions(**options)
        )

    with pytest.raises(KeyboardInterrupt):  # where nobody asked to keep it
        interrupted("iteration 2")
    with pytest.raises(KeyboardInterrupt):  # before there are any
        interrupted("", interruptible=True)
    calibration = interrupted("iteration 1", time=2, interruptible=True)  # frames far off then count less
    assert calibration.fit.interrupted and not calibration.fit.converged and calibration.fit.iterations > 0
    assert abs(np.log(calibration.model.parameters["damping"].factor / 1.3)) < 0.1  # begun at 1
    assert calibration.fit.after < calibration.fit.before / 2
    assert not any(p.reliable for p in calibration.model.parameters.values())
    assert any("interrupted after" in line for line in calibration.warnings)
    assert "interrupted after" in as_text(calibration) and "a likely cause" not in as_text(calibration)
    assert calibration.to_json()["interrupted"]
    # the factors alone are whole, and the fit with an effect has hardly begun
    calibration = interrupted("iteration 1", ("scale_error",), interruptible=True)
    assert calibration.fit.interrupted and calibration.model.effects == ()
    assert calibration.model.parameters["damping"].factor == pytest.approx(1.3, rel=0.02)


def test_the_factors_alone_see_fewer_trials_than_the_last_fit(tmp_path, monkeypatch):
    monkeypatch.setattr("studies.calibration.calibrate.TRIALS", 1)
    late = EffectTerm("time_offset", {"offset": Quantity(0.3, "s")})  # far off, so that one step does not do
    measured = write(
        tmp_path / "set", [100, 200, 300, 250, 150], forward=Predictor(Curler(), Model(effects=(late,)), sensing=True)
    )
    vector, lines = fit_vector(["time_offset"]), []

    def fitted(most):
        def progress(line, share):
            if len(lines) == most:
                raise KeyboardInterrupt
            lines.append(line)

        lines.clear()
        return calibrate(
            exact(measured), Curler(), vector=vector, progress=progress, options=CalibrationOptions(interruptible=True)
        )

    uninterrupted = fitted(None)
    interrupted = fitted(len(lines) - 1)
    for fit_ in (uninterrupted.fit, interrupted.fit):
        assert (len(fit_.without_effects.by_trial), len(fit_.by_trial)) == (1, 2)
        problem = FitProblem(uninterrupted.data.samples, Curler(), Curler(), vector)
        there = problem.evaluate([vector.start])[0].misfit.residual  # of both trials
        assert fit_.before == pytest.approx(capped_rms(there), rel=1e-6)
        assert fit_.after < fit_.before / 2
    assert interrupted.fit.interrupted and not uninterrupted.fit.interrupted


def test_effects_that_are_nothing_come_out_as_nothing_in_the_end(measured, monkeypatch, tmp_path):
    monkeypatch.setattr("studies.calibration.calibrate.EXCESS", 0.02)  # four trials of eight frames say little
    messages, parts = [], []
    restrict_effects(monkeypatch, "time_offset", "scale_error", "dead_time")
    model = Term("scale_error", {"scale": 0.0}), Term("air_drag", {"coefficient": 1.0})

    def fit_seen(problem, *arguments, **options):
        parts.append(problem.vector.labels)
        return fit(problem, *arguments, **options)

    monkeypatch.setattr("studies.fitting.fits.fit", fit_seen)
    calibration = calibrate(
        exact(measured),
        Curler(),
        vector=fit_vector(["all"], terms=model),
        progress=lambda line, share: messages.append((line, share)),
    )
    assert calibration.fit.vector.terms[:2] == model  # fitted and held: what a model gave stays
    assert parts[-2] == () and {"dead_time", "time_offset"} < {*parts[-1]}  # without effects first
    shares = [share for _, share in messages]
    assert shares == sorted(shares) and shares[-1] < 1
    names = calibration.fit.vector.names
    assert {"dead_time.delay", "time_offset.offset"} < {*names}
    assert calibration.model.covariance.names == names
    write_model(calibration.model, tmp_path / "model.toml")
    effects = {effect.name: effect.parameters for effect in read_model(tmp_path / "model.toml").effects}
    offset = effects["time_offset"]["offset"]
    assert abs(offset.value) < 0.01 and -0.02 < offset.interval90[0] <= 0.0 <= offset.interval90[1] < 0.02
    assert (
        calibration.fit.without_effects is not None and calibration.fit.before == calibration.fit.without_effects.before
    )


def test_sets_and_designs_are_fitted_together(measured, tmp_path):
    """Orders are those of each set; a set may hold several designs; the provenance names SET/TRIAL."""
    trials = [
        NewTrial(f"{k:03d}", name, k, "fit", measured.trials[k].load()) for k, name in enumerate(("cross", "cross two"))
    ]
    designs = {"cross": build("cross"), "cross two": build("cross", name="cross two")}
    write_set(tmp_path / "two", designs, trials, name="two")
    both = [measured, read_set(tmp_path / "two")]
    assert len(both[1].designs) == 2
    shares = []
    calibration = calibrate(
        both,
        Curler(),
        progress=lambda line, share: shares.append(share),
        options=CalibrationOptions(orders=[0, 1], engines=ONE_ENGINE),
    )
    origin = calibration.model.provenance
    assert origin.sets == ("curled", "two")
    assert origin.fitted == ("curled/000", "curled/001", "two/000", "two/001")
    assert origin.held_out == ("curled/002", "curled/003", "curled/004")
    assert set(origin.hashes) == {f"{name}.npz" for name in origin.fitted}
    f = {name: parameter.factor for name, parameter in calibration.model.parameters.items()}
    assert f["muscle_gain"] * f["axis_offset"] / f["bending"] == pytest.approx(0.9 * 1.1 / 1.2, rel=0.01)
    assert shares == sorted(shares) and 0 < shares[0] < shares[-1] <= 1
    with pytest.raises(InputError, match="set curled: given twice"):
        calibrate([measured, measured], Curler(), options=CalibrationOptions(engines=ONE_ENGINE))


def test_intervals_cover_over_repeats(tmp_path):
    """Of 8 sets with factors drawn from the prior, 90 % intervals hold the truth in most of the 7 x 8 cases."""
    rng, inside = np.random.default_rng(3), 0
    for k in range(8):
        truth = {name: float(np.exp(PRIOR[name] * rng.standard_normal())) for name in PARAMETERS}
        measured = write(tmp_path / str(k), [100, 200, 300, 150], truth=truth, seed=k, points=100)
        parameters = calibrate(measured, Curler(), options=CalibrationOptions(engines=ONE_ENGINE)).model.parameters
        inside += sum(p.interval90[0] <= truth[name] <= p.interval90[1] for name, p in parameters.items())
    assert inside >= 44  # binomial, 0.9 of 56: fewer once in 100


def test_the_difference_between_engines_widens_what_the_data_determine(measured):
    alone = calibrate(measured, Curler(), options=CalibrationOptions(engines=ONE_ENGINE))
    deviations = np.sqrt(np.diag(alone.fit.covariance))
    for engines in (None, np.full(7, 0.05)):  # the virtual rig's, and one more
        widths = {
            name: np.log(p.interval90[1] / p.interval90[0]) / 3.29
            for name, p in calibrate(
                measured, Curler(), options=CalibrationOptions(engines=engines)
            ).model.parameters.items()
        }
        for k, name in enumerate(PARAMETERS):
            share = 1 - (deviations[k] / PRIOR[name]) ** 2
            difference = engine_difference()[k] if engines is None else engines[k]
            assert widths[name] == pytest.approx(np.hypot(deviations[k], share * difference), rel=1e-3)
    assert widths["damping"] > 1.1 * deviations[PARAMETERS.index("damping")]  # well determined
    assert widths["shear"] == pytest.approx(PRIOR["shear"], rel=1e-3)  # the data sheet's alone


def test_model_error_widens_intervals(measured, monkeypatch):
    """A wrong engine's residuals are alike over a whole trial: the intervals must not shrink with the points."""

    def width(lag, seed=0):
        calibration = calibrate(measured, Curler(lag=lag), options=CalibrationOptions(engines=ONE_ENGINE, seed=seed))
        low, high = calibration.model.parameters["damping"].interval90
        return np.log(high / low)

    right, wrong = width(0.0), width(0.2)
    assert wrong > 2 * right
    fifth = dataclasses.replace(DRAWN, points=DRAWN.points // 5)
    monkeypatch.setattr("studies.calibration.calibrate.DRAWN", fifth)  # drawn four times
    assert wrong > 0.9 * np.median([width(0.2, seed) for seed in range(4)])


def test_the_fine_engine_has_the_last_word(measured, monkeypatch):
    """An engine of differences that is right at the data sheet and nowhere else leads to the other's minimum."""

    class Asked(Curler):
        def motions(self, cases, times):
            self.batches = [*getattr(self, "batches", []), len(cases)]
            return super().motions(cases, times)

    fine, slopes = Asked(), Asked(power=0.7)
    assert calibrate(exact(measured), slopes).model.factors["damping"] == pytest.approx(1.3 ** (1 / 0.7), rel=0.02)
    slopes.batches.clear()
    mended = calibrate(exact(measured), fine, options=CalibrationOptions(slopes=slopes)).model.factors
    assert mended["damping"] == pytest.approx(1.3, rel=0.01)
    trials = len(fit_trials(measured.trials, None))
    # where it begins, then steps and parts of them; no differences, which the other makes, with the place beside them
    assert set(fine.batches) == {trials, 2 * trials}
    assert set(slopes.batches) == {(1 + 7) * trials}
    monkeypatch.setattr(problems, "AT_ONCE", 1)
    slopes.batches.clear()
    two_by_two = calibrate(exact(measured), fine, options=CalibrationOptions(slopes=slopes)).model.factors
    assert two_by_two == mended and set(slopes.batches) == {2 * trials}


def test_one_frame_of_a_cloth_at_rest_leaves_the_data_sheet(tmp_path):
    """Which is said once: no combinations of factors on which the data say little."""
    measured = write(tmp_path / "set", [0, 0], times=TIMES[:1])
    calibration = calibrate(measured, Curler(), options=CalibrationOptions(engines=ONE_ENGINE))
    assert [line.split(":")[0] for line in calibration.statements] == list(PARAMETERS)
    assert calibration.fit.x == pytest.approx(np.zeros(7), abs=0.01)  # density sags it a little


def test_slopes_that_are_too_small_by_half_do_not_keep_the_descent_from_its_end():
    """Every step is then nearly twice too long and takes the one before back; halved, such steps end it."""
    rng, target = np.random.default_rng(2), np.full(7, 0.05)
    slopes, noise = 0.01 * rng.standard_normal((2400, 7)), 3e-4 * rng.standard_normal(2400)
    times = np.repeat(np.arange(0.25, 6.0, 0.5), 200)
    sample = Sample(None, np.unique(times), ())
    frame = np.searchsorted(sample.times, times)

    class Line(Problem):
        samples, vector = (sample,), DECLARED

        def evaluate(self, xs):
            residuals = [slopes @ (x - target) + noise for x in xs]
            zeros = np.zeros(2400, np.intp)
            return [
                Evaluation(x, Misfit(r, zeros, frame, frame // 200), []) for x, r in zip(xs, residuals, strict=True)
            ]

        def linearise(self, evaluation, along, old=None, fresh=None):
            return self.with_jacobian(evaluation, slopes / 1.95)

    fit_ = fit(Line(), FitStart(np.zeros(7)))
    assert fit_.converged
    assert fit_.x == pytest.approx(target, abs=0.01)


def test_trials_that_agree_are_not_simulated_again_for_their_clocks(measured):
    class Asked(Curler):
        def motions(self, cases, times):
            self.last = [len(t) for t in times]
            return super().motions(cases, times)

    forward = Asked()
    calibration = calibrate(measured, forward, options=CalibrationOptions(engines=ONE_ENGINE))
    assert calibration.fit.by_trial == pytest.approx(np.full(4, np.hypot(0.0006, 0.010 * np.sqrt(0.003))), rel=0.4)
    assert forward.last == [len(TIMES)] * len(forward.last)  # other clocks would be other times


@pytest.mark.parametrize(
    ("rms", "outlying", "expected"),
    [
        (0.0006, 0.0, []),  # the noise alone
        (0.00078, 0.029, []),  # sqrt(0.78^2 - 0.6^2) = 0.498
        (0.00079, 0.0, ["the fit leaves 0.51 mm over the noise, expected at most 0.5"]),
        (0.0006, 0.17, ["17% of the frames fitted are far off, expected under 3%"]),
        (np.nan, 0.0, ["the fit leaves nan mm over the noise, expected at most 0.5"]),
    ],
)
def test_intervals_are_believed_where_the_fit_leaves_the_noise(rms, outlying, expected):
    assert interval_warnings(rms, outlying, SensorNoise(0.0006, 0.0, 0.05)) == expected


def test_noise_of_points_drawn_with_strays_is_what_it_is_taken_for():
    rng = np.random.default_rng(1)
    noise = SensorNoise(0.0006, 0.02, 0.03)
    strays = rng.random(400_000) < noise.strays
    distance = np.where(strays, 0.03 * rng.uniform(-1, 1, 400_000), 0.0006 * rng.standard_normal(400_000))
    assert noise_rms(noise) == pytest.approx(capped_rms(distance), rel=0.02)


def test_a_lag_that_the_model_lacks_marks_the_intervals(tmp_path):
    measured = write(tmp_path / "set", [100, 150, 250, 300, 200], forward=Curler(lag=0.9))
    calibration = calibrate(measured, Curler(), options=CalibrationOptions(engines=ONE_ENGINE))
    assert calibration.warnings
    assert not calibration.to_json()["believable"]
    assert "not reliable" in as_text(calibration) and "NOT reliable: the fit leaves" in as_text(calibration)
    write_model(calibration.model, tmp_path / "model.toml")
    assert not any(p.reliable for p in read_model(tmp_path / "model.toml").parameters.values())


def test_factors_of_a_wrong_model_are_not_refined(tmp_path, monkeypatch):
    """What a missing effect leaves is no reason for last steps; it ends as near, as far as that can be said."""
    measured = write(tmp_path / "set", [100, 150, 250, 300, 200], forward=Curler(lag=0.9))
    asked = []

    def fitted():
        motions = Curler.motions
        monkeypatch.setattr(Curler, "motions", lambda self, c, t: asked.append(len(c)) or motions(self, c, t))
        fit_ = calibrate(measured, Curler(), options=CalibrationOptions(engines=ONE_ENGINE)).fit
        monkeypatch.setattr(Curler, "motions", motions)
        total = sum(asked)
        asked.clear()
        return fit_, total

    unrefined, unrefined_cases = fitted()
    monkeypatch.setattr("studies.fitting.fits.expected_rms", lambda noise, tolerance: 1.0)  # m: nothing is wrong
    refined, refined_cases = fitted()
    assert unrefined.after > 2 * 0.8e-3
    assert unrefined_cases < refined_cases and unrefined.after < 1.05 * refined.after


def test_a_diverging_trial_is_left_out_from_there_on(tmp_path):
    measured = write(tmp_path / "set", [100, 200, 395, 150])
    calibration = calibrate(measured, Curler(loses=True))
    assert calibration.fit.lost == (("002", pytest.approx(0.7)),)
    assert "002: the motion diverged; left out from 0.70 s on" in as_text(calibration)
    lost = np.mean(TIMES >= 0.7 - 1e-9) / 3  # of one trial of three
    assert calibration.fit.outlying == calibration.to_json()["outlying"] == pytest.approx(lost)
    assert f"NOT reliable: {lost:.0%} of the frames fitted are far off" in as_text(calibration)
    assert not any(p.reliable for p in calibration.model.parameters.values())
    alone = dataclasses.replace(measured, trials=measured.trials[2:3])
    with pytest.raises(SimulationError, match="every motion"):
        calibrate(alone, Lost())


class Lost(Curler):
    def motions(self, cases, times):
        return [motion * np.nan for motion in super().motions(cases, times)]


def test_orders_choose_and_test_trials_are_refused(measured):
    calibration = calibrate(measured, Curler(), options=CalibrationOptions(orders=[0, 2]))
    assert calibration.model.provenance.fitted == ("curled/000", "curled/002")
    assert calibration.model.provenance.held_out == ("curled/001", "curled/003", "curled/004")
    with pytest.raises(InputError, match="role test"):
        calibrate(measured, Curler(), options=CalibrationOptions(orders=[4]))


def test_bad_trials_are_named_and_skipped_on_request(tmp_path):
    measured = write(tmp_path / "set", [100, 200, 300, 150])
    bad = measured.trials[1].file
    bad.write_bytes(bad.read_bytes()[:300])
    with pytest.raises(InputError, match=r"001\.npz: is damaged") as caught:
        sound_trials(measured, Tolerance(skip_bad=False))
    assert "\n" not in str(caught.value)
    kept, skipped = sound_trials(measured, Tolerance(skip_bad=True))
    assert [t.name for t in kept.trials] == ["000", "002", "003"]
    assert len(skipped) == 1 and "001.npz" in skipped[0]
    assert "skipped: " in as_text(calibrate(kept, Curler(), options=CalibrationOptions(skipped=skipped)))
    tests, none = sound_trials(measured, Tolerance(skip_bad=False), ["test"])  # the damaged one is not read
    assert ([t.role for t in tests.trials], none) == (["test"], ())
    alone = dataclasses.replace(measured, trials=measured.trials[1:2])
    with pytest.raises(InputError, match="no sound trial"):
        sound_trials(alone, Tolerance(skip_bad=True))


def rewrite(trial, **changes):
    """Write the trial again with other times or clouds."""
    write_trial(dataclasses.replace(trial.load(), **changes), trial.file)


def test_a_trial_with_its_faces_swapped_is_named_and_skipped_on_request(tmp_path):
    measured = write(tmp_path / "set", [100, 200, 300, 250, 150])
    rewrite(measured.trials[2], frames=tuple(c * (1, 1, -1) for c in measured.trials[2].load().frames))
    with pytest.raises(InputError, match=r"002\.npz: .* with front and back exchanged; expected the front at \+z"):
        calibrate(measured, Curler())
    calibration = calibrate(measured, Curler(), options=CalibrationOptions(skip_bad=True))
    assert [t.split("/")[-1] for t in calibration.model.provenance.fitted] == ["000", "001", "003"]
    assert len(calibration.skipped) == 1 and "002.npz" in calibration.skipped[0] and "skipped: " in as_text(calibration)


@pytest.mark.parametrize("shift, way", [(0.15, "earlier"), (-0.1, "later")])
def test_a_trial_with_a_clock_of_its_own_is_named_and_skipped_on_request(tmp_path, shift, way):
    measured = write(tmp_path / "set", [300, 200, 400, 250, 150])
    rewrite(measured.trials[2], time=TIMES + shift)
    with pytest.raises(InputError, match=rf"002\.npz: agrees .* s {way} than the other trials do.*its clock differs"):
        calibrate(measured, Curler())
    calibration = calibrate(measured, Curler(), options=CalibrationOptions(skip_bad=True))
    assert len(calibration.skipped) == 1 and "002.npz" in calibration.skipped[0]


def test_a_lag_that_all_trials_share_is_no_clock(tmp_path):
    measured = write(tmp_path / "set", [300, 200, 400, 250, 150])
    for trial in measured.trials:
        rewrite(trial, time=TIMES + 0.15)
    assert not calibrate(measured, Curler()).skipped


class Coin(Curler):
    """From 0.4 s on, at 250 kPa, it lies to one side or the other, as the frame leans."""

    side = 1.0

    def _motion(self, case, times):
        frames = super()._motion(case, times)
        leans = [term.values["about_x"] for term in case.effects if term.name == "frame_tilt"]
        if 240e3 < case.program.pressure.max() < 260e3:
            side = np.sign(sum(leans)) or self.side
            frames[times > 0.35, :, 2] *= side
        return frames


def test_sensitive_stretches_are_named_and_left_out(tmp_path):
    other = Coin()
    other.side = -1.0  # the measured cloth fell to the other side
    measured = write(tmp_path / "set", [100, 200, 300, 250, 150], forward=other)
    blind = calibrate(exact(measured), Coin(), options=CalibrationOptions(engines=ONE_ENGINE))
    calibration = calibrate(exact(measured), Coin(), options=CalibrationOptions(coarse=Coin(), engines=ONE_ENGINE))
    [stretch] = calibration.used.stretches
    assert stretch.trial == "003" and 0.2 <= stretch.begin <= 0.4 and stretch.end == pytest.approx(1.2)
    assert calibration.used.share_left_out == pytest.approx(5 / 32, abs=2 / 32)
    assert "left out as sensitive" in as_text(calibration) and "003" in as_text(calibration)
    assert calibration.to_json()["unjudged"][0]["trial"] == "003"
    assert calibration.model.parameters["damping"].factor == pytest.approx(1.3, rel=0.01)
    assert calibration.fit.after < 0.5 * blind.fit.after
    assert blind.used.stretches is None


def test_a_set_of_sensitive_stretches_alone_is_refused(tmp_path):
    measured = write(tmp_path / "set", [250, 245, 150])
    coin = Coin()

    def toss(cases, times):
        return [np.full((len(t), 882, 3), np.nan, np.float32) for t in times]

    coin.motions = toss
    with pytest.raises(InputError, match="every frame is sensitive, small changes of the inputs lead to another shape"):
        calibrate(measured, Curler(), options=CalibrationOptions(coarse=coin))

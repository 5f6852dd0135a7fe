"""Frames of motions in balance: what is seen of a displacement, recovery of a known truth, and what has no balance."""

from dataclasses import replace

import numpy as np
import pytest

from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.files.trial_file import program_of
from fabdesign.geometry.shape import Shape, normals
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.column import Balance
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from optimize.fit.balance import FRAMES, HALF, acting_in_balance, frames_around
from optimize.fit.clouds import Density, Sample, match
from optimize.fit.displacement import Unstrained, heights
from optimize.fit.free_parameters import fit_vector
from optimize.fit.misfit import frames_of
from optimize.fit.problem import fingerprint
from optimize.fit.significance import NEEDED, needed
from sim import Simulator
from studies.fitting.fits import Fits, fit_in_balance, shown, starts_of, unneeded, worth_fitting
from studies.measured.fit_data import MeasuredData
from studies.measured.splits import fit_trials
from studies.measured.used_frames import UsedFrames

DESIGN = build("basic", muscles=4)
SIGMA = 0.3e-3  # m
TIMES = np.arange(30) / 30  # s
FREE = ["orthotropy", "filling_lag", "supply_droop", "registration_bias.z", "muscle_creep", "air_drag"]
TERMS = (
    Term("orthotropy", {"ratio": 0.5}),
    Term("filling_lag", {"fill": 0.15, "empty": 0.15}),
    Term("registration_bias", {"x": 0.0, "y": 0.0, "z": 2e-3, "about_x": 0.0, "about_y": 0.0, "about_z": 0.0}),
)
PRESSURES = [  # Pa, from 0 s and from 0.5 s on
    [[3e5, 0, 0, 1e5], [0, 2e5, 0, 0]],
    [[0, 3e5, 0, 0], [0, 0, 2e5, 2e5]],
    [[0, 1e5, 0, 0], [0, 1e5, 3e5, 0]],
]


@pytest.fixture(scope="module")
def forward():
    return Predictor(Simulator(21), sensing=True)


@pytest.fixture(scope="module")
def vector():
    return fit_vector(FREE, designs=[DESIGN])


@pytest.fixture(scope="module")
def data(forward, tmp_path_factory):
    """Motions of a cloth that is stiffer across, under pressures that lag, seen 2 mm off, with noise."""
    rng, new = np.random.default_rng(1), []
    for order, rows in enumerate(PRESSURES):
        pressure = PressureProgram(np.array([0.0, 0.5]), np.array(rows), 1.0).at(TIMES)
        case = Case(DESIGN, program_of(TIMES, pressure), {"muscle_gain": 1.1}, TERMS)
        [motion] = forward.motions([case], [TIMES])
        clouds = tuple(
            frame[rng.choice(len(frame), 500)] + SIGMA * rng.standard_normal((500, 3)) for frame in motion.astype(float)
        )
        role = "test" if order == len(PRESSURES) - 1 else "fit"
        new.append(NewTrial(f"{order:03d}", "basic", order, role, TrialData(TIMES, pressure, clouds)))
    folder = tmp_path_factory.mktemp("balance") / "set"
    write_set(folder, {"basic": DESIGN}, new, name="balance", description="synthetic")
    measured = read_set(folder)
    density = Density(until=1.0, frames=20, points=100)
    return MeasuredData.of([measured], fit_trials(measured.trials), UsedFrames((), 0.0), density, seed=0)


@pytest.fixture(scope="module")
def balanced(data, forward, vector):
    return fit_in_balance(data, Fits(forward, 0.5e-3), vector)


def test_a_known_truth_is_led_to_in_one_go(data, forward, vector, balanced):
    """From the data sheet on all frames: no first horizon, no second start."""
    names, deviation = balanced.vector.names, np.sqrt(np.diag(balanced.covariance))
    truth = {
        "orthotropy.ratio": (np.log(0.5), 0.1),
        "filling_lag.fill": (0.15, 0.02),
        "filling_lag.empty": (0.15, 0.03),
        "registration_bias.z": (2e-3, 0.3e-3),
        "supply_droop.share": (0.0, 0.02),
        "muscle_gain": (np.log(1.1), 0.06),
    }
    for name, (value, tolerance) in truth.items():
        assert abs(balanced.x[names.index(name)] - value) < tolerance, name
    creep = balanced.vector.part("muscle_creep")  # next to nothing, so that its time is not known
    assert balanced.x[creep[0]] < 0.02 and (deviation <= balanced.vector.prior * (1 + 1e-9)).all()
    assert (np.delete(deviation, creep[1:]) < np.delete(balanced.vector.prior, creep[1:])).all()
    problem = Fits(forward, 0.5e-3).problem(data, vector)
    sheet, *starts = problem.evaluate([np.zeros(len(vector.names)), *starts_of(vector, balanced)])
    assert min(one.misfit.rms for one in starts) < 1.3 * SIGMA < 0.1 * sheet.misfit.rms


def test_what_balance_needs_is_said_and_what_it_does_not_begins_at_nothing(vector, balanced):
    needed_effects = {*needed(balanced.minimum, balanced.covariance, balanced.vector, NEEDED)}
    assert needed_effects == {"orthotropy", "filling_lag", "registration_bias"}
    assert "air_drag" not in balanced.vector.labels  # a force without a tangent
    assert {*shown(balanced)} == {*balanced.vector.labels} and unneeded(balanced) == {"supply_droop"}
    worth = worth_fitting(vector, balanced)  # and what balance does not show
    assert needed_effects | {"air_drag"} <= worth < {*vector.labels} == worth_fitting(vector, None)
    rows = [dict(zip(vector.names, row, strict=True)) for row in starts_of(vector, balanced)]
    drag = vector.start[vector.names.index("air_drag.coefficient")]
    assert sorted(row["air_drag.coefficient"] for row in rows) == [0.0, 0.0, drag, drag, drag]
    assert sum(row["supply_droop.share"] == 0 for row in rows) == 2  # where it is dropped
    assert sum(row["orthotropy.ratio"] < -0.5 for row in rows) == 4  # not at the vector's own start
    starts = starts_of(vector.without_effects, balanced)
    assert starts.shape == (3, 7) and (starts == 0).all(axis=1).any()
    assert (starts == balanced.x[:7]).all(axis=1).any()


@pytest.mark.parametrize("seconds", [1 / 30, 0.1])
def test_frames_too_far_apart_for_an_acceleration_have_none(data, seconds):
    trial = data.trials[0]
    seen = replace(trial.load(), time=np.arange(len(TIMES)) * seconds)
    frames = frames_around(trial, seen, np.ones(len(TIMES), bool), np.random.default_rng(0))
    assert (frames is None) == (seconds > 0.05)


def test_frames_beside_unused_ones_take_no_part(data):
    trial, used = data.trials[0], np.ones(len(TIMES), bool)
    used[12] = False
    frames = frames_around(trial, trial.load(), used, np.random.default_rng(0))
    assert len(frames.around) == FRAMES and not np.isin(frames.sample.times, TIMES[12]).any()
    assert np.diff(frames.sample.times[frames.around], axis=1) == pytest.approx(np.full((FRAMES, 4), 1 / 30))
    assert (frames.central.times == frames.sample.times[frames.around[:, HALF]]).all()
    used[::3] = False
    assert frames_around(trial, trial.load(), used, np.random.default_rng(0)) is None


def test_an_engine_without_balance_begins_where_the_vector_does(data, vector):
    class Bare:
        def motions(self, cases, times):
            raise AssertionError

    bare = Fits(Predictor(Bare()), 0.5e-3)
    assert fit_in_balance(data, bare, vector) is None
    assert (starts_of(vector, None) == vector.start[None]).all()
    assert (starts_of(vector.without_effects, None) == 0).all()


def test_a_set_of_which_no_frame_balances_begins_where_the_vector_does(data, vector):
    class Falling(Simulator):
        def balances(self, cases, courses, columns):
            return [
                [Balance(np.full_like(one.moved, np.nan), np.full((len(columns), 21, 21, 3), np.nan))]
                * len(course.instants)
                for course in courses
                for one in course.instants[:1]
            ]

    assert fit_in_balance(data, Fits(Predictor(Falling(21), sensing=True), 0.5e-3), vector) is None


def test_a_balance_is_kept(data, forward, vector, balanced):
    """A resumed fit asks for one look at where the steps led, with what led the motions, not for the steps."""
    kept, lines = {}, []

    class Kept:
        def arrays(self, name, compute):
            assert name == f"fit_in balance {fingerprint(acting_in_balance(vector), data.samples)}"
            if name not in kept:
                kept[name] = compute()
            return kept[name]

    fits = Fits(forward, 0.5e-3, checkpoint=Kept(), progress_of=lambda named, vector: lambda *line: lines.append(line))
    first = fit_in_balance(data, fits, vector)
    steps = len(lines)
    again = fit_in_balance(data, fits, vector)
    assert 2 <= steps == len(lines)
    for one in (first, again):
        assert (one.x == balanced.x).all() and (one.covariance == balanced.covariance).all()


@pytest.fixture(scope="module")
def curled():
    """A cloth curled to a quarter of a tube, (21, 21, 3) m, and its faces."""
    u, v = np.meshgrid(np.linspace(0, 0.2, 21), np.linspace(0, 0.2, 21))
    angle = v / 0.2 * np.pi / 2
    return np.stack([u, -0.2 / (np.pi / 2) * np.sin(angle), 0.2 / (np.pi / 2) * (1 - np.cos(angle))], axis=-1)


def faces_of(middle):
    fine = np.array([np.interp(np.linspace(0, 20, 41), np.arange(21), row) for row in middle.reshape(21, -1).T]).T
    fine = fine.reshape(41, 21, 3).swapaxes(0, 1)
    fine = np.array([np.interp(np.linspace(0, 20, 41), np.arange(21), row) for row in fine.reshape(21, -1).T]).T
    fine = fine.reshape(41, 41, 3).swapaxes(0, 1)
    return np.concatenate([(fine + sign * 1e-3 * normals(fine)).reshape(-1, 3) for sign in (1, -1)])


def test_heights_of_a_cloud_are_those_of_the_cloth_that_was_seen(curled):
    """Of both faces and with strays; along the normal towards the front."""
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    height = 3e-3 * v**2 * np.cos(2 * np.pi * u)
    seen = faces_of(curled + height[..., None] * normals(curled))
    cloud = seen[rng.choice(len(seen), 800)] + SIGMA * rng.standard_normal((800, 3))
    cloud[:20] += 0.02  # strays
    misfit = match([Sample(None, np.array([0.1]), (cloud,))], [faces_of(curled)[None]])
    [off] = heights(misfit, frames_of(misfit)[1], 21)
    inner = np.s_[2:-3, 2:-2]
    assert np.sqrt(np.mean(np.square(off - height)[inner])) < 0.3e-3  # a tenth of the largest


def test_a_displacement_along_normals_is_completed_by_one_that_strains_no_edge(curled):
    """A curled cloth that curls on, of which only the part along its normals is seen."""
    v = np.linspace(0, 0.2, 21)
    angle = v / 0.2 * np.pi / 2
    along = np.stack([0 * v, np.cos(angle) * -1, np.sin(angle)], axis=-1)  # tangents down the cloth
    turned = 0.01 * angle[:, None] * np.stack([0 * v, np.sin(angle), np.cos(angle)], axis=-1)
    steps = 0.5 * (turned[1:] + turned[:-1]) * 0.01
    true = np.repeat(np.concatenate([[np.zeros(3)], np.cumsum(steps, axis=0)])[:, None], 21, axis=1)
    normal = normals(curled)
    seen = (true * normal).sum(axis=-1, keepdims=True) * normal
    full = Unstrained(curled)(seen)
    down = full[1:] - full[:-1]
    strain = np.abs((down * (curled[1:] - curled[:-1])).sum(axis=-1)) / 0.01**2
    strain_seen = np.abs(((seen[1:] - seen[:-1]) * (curled[1:] - curled[:-1])).sum(axis=-1)) / 0.01**2
    assert strain.max() < 0.05 * strain_seen.max()
    assert (
        np.abs(full - seen - ((full - seen) * along[:, None]).sum(axis=-1, keepdims=True) * along[:, None]).max() < 1e-4
    )
    assert Shape(faces_of(curled)).side == 41

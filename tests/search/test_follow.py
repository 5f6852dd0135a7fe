"""Pressures over time for a target that moves: windows, limits, measured motions fed back, folders."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import read_csv
from fabdesign.files.trial_file import TrialData, write_trial
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.pressure import regulated
from fabdesign.study_files.follow_file import FollowStudy
from sim import Simulator
from sim.motion import faces
from sim.resume import at_rest, go_on, with_states
from studies.follow.measured import MeasuredRun, displacements
from studies.follow.programs import UNIT, Regulator, Roughness, best_change
from studies.follow.run import run_follow
from studies.follow.wanted import Wanted, moved
from studies.follow.windows import FollowTask, solve
from studies.layout_search.target import LoadedTarget

GRID = 11
NOISE = 3e-4  # m
DESIGN = build("cross", muscles=2)
REGULATOR = Regulator(0.05, 100.0, np.zeros(2), np.full(2, 300e3), np.inf)
TIMES = np.arange(1, 8) / 30
TRUTH = 1e3 * np.array([[20, 40], [80, 80], [150, 120], [130, 150], [80, 120]], float)


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(GRID)


def moving(simulator, pressures=TRUTH, **case):
    """The motion (T, 2 n, 3) m of set points."""
    return simulator.motions([Case(DESIGN, REGULATOR.program(pressures), **case)], [TIMES])[0].astype(float)


@pytest.fixture(scope="module")
def wanted(simulator) -> Wanted:
    rng = np.random.default_rng(3)
    clouds = [Surface.of_faces(points).sample(400, rng)[0] for points in moving(simulator)]
    noise = SensorNoise(NOISE, 0.0, 0.0)
    return Wanted(TIMES, tuple(LoadedTarget(c + NOISE * rng.normal(size=c.shape), noise=noise) for c in clouds))


def rms(wanted: Wanted, motion) -> float:
    """m, of the distances of all instants."""
    return float(np.sqrt(np.mean([(wanted.distances(k, p, GRID).off ** 2).mean() for k, p in enumerate(motion)])))


@pytest.mark.parametrize("effects", [(), (Term("braid_hysteresis", {"friction": 0.02}),)], ids=["bare", "memory"])
def test_a_motion_goes_on_from_a_state_bit_for_bit(simulator, effects):
    case = Case(DESIGN, REGULATOR.program(TRUTH), effects=effects)
    [full_motion] = simulator.run([case], [TIMES])
    [kept] = with_states(simulator, [case], at_rest(simulator, case), TIMES, [96 * k for k in range(1, 6)])
    assert np.array_equal(kept.motion.middle, full_motion.middle)
    later = TIMES[TIMES > 0.1]
    [rest] = go_on(simulator, [case], [kept.states[1]], [later])
    assert np.array_equal(rest.middle, full_motion.middle[-len(later) :])
    assert np.array_equal(rest.tension, full_motion.tension[-len(later) :])


def test_programs_in_one_block_are_the_same_motions_but_for_shorter_steps(simulator):
    programs = [TRUTH, TRUTH[::-1].copy()]
    cases = [Case(DESIGN, REGULATOR.program(set_points)) for set_points in programs]
    several = with_states(simulator, cases, at_rest(simulator, cases[0]), TIMES, [96 * 5])
    for kept, case in zip(several, cases, strict=True):
        [alone] = simulator.run([case], [TIMES])
        assert np.abs(kept.motion.middle - alone.middle).max() < 2e-4  # m: long steps after small jumps


def test_distances_change_as_differences_of_shapes_say(simulator, wanted):
    """d' = -n . x': central differences of the distances of one instant."""
    middle = simulator.run([Case(DESIGN, REGULATOR.program(TRUTH))], [TIMES])[0]
    rng = np.random.default_rng(5)
    smooth = rng.normal(size=(3, 3, 3))
    u = np.linspace(0, 1, GRID)
    change = np.einsum("ai,bj,ijc->abc", np.vander(u, 3), np.vander(u, 3), smooth)
    ahead, behind = (
        wanted.distances(4, faces((middle.middle[4:5] + by * change).astype(np.float64), 0.002)[0], GRID).off
        for by in (1e-5, -1e-5)
    )
    base = wanted.distances(4, middle.points[4].astype(float), GRID)
    expected = moved(base, change[None])[:, 0]
    inside = np.abs(expected - (ahead - behind) / 2e-5) < 0.05 * np.abs(expected).max()
    assert inside.mean() > 0.95  # others lie beyond a hem, or change their triangle


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([np.inf, 400e3, 2e6]))
def test_the_best_change_keeps_limits_and_rate(seed, rate):
    rng = np.random.default_rng(seed)
    regulator = replace(REGULATOR, rate=rate)
    rows = regulator.kept(rng.uniform(0, 300e3, (5, 2)))
    root = rng.normal(size=(8, 8))
    hessian, gradient = root @ root.T + np.eye(8), 5 * rng.normal(size=8)
    before = rows[0]
    change = best_change(hessian, gradient, regulator, (before, rows[1:]), 1e5)
    after = rows[1:] + change
    assert (np.abs(change) <= 1e5 + 1).all()
    assert (after >= -1).all()
    assert (after <= 300e3 + 1).all()
    steps = np.abs(np.diff(np.concatenate([before[None], after]), axis=0))
    was = np.abs(np.diff(np.concatenate([before[None], rows[1:]]), axis=0))
    assert (steps <= np.maximum(regulator.change, was) + 1).all()
    if np.isinf(rate):  # bounds alone: scipy's own solver of min |L' x + L^-1 g|
        lower = np.linalg.cholesky(hessian)
        low = np.maximum(-rows[1:], -1e5).ravel() / UNIT
        high = np.minimum(300e3 - rows[1:], 1e5).ravel() / UNIT
        answer = lsq_linear(lower.T, -np.linalg.solve(lower, gradient), (low - 1e-9, high + 1e-9))
        assert change.ravel() / UNIT == pytest.approx(answer.x, abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(50e3, 5e6))
def test_kept_set_points_have_the_resolution_and_the_rate(seed, rate):
    regulator = replace(REGULATOR, rate=rate)
    wanted = np.random.default_rng(seed).uniform(-1e5, 4e5, (9, 2))
    rows = regulator.kept(wanted)
    stepped = replace(REGULATOR, rate=np.inf).kept(wanted)
    assert np.array_equal(stepped, regulated(np.clip(wanted, 0.0, 300e3)))  # as all that a regulator takes
    steps = np.abs(np.diff(np.concatenate([np.zeros((1, 2)), rows]), axis=0))
    assert steps.max() <= rate * 0.05 + 1e-6
    assert rows == pytest.approx(100 * np.round(rows / 100))
    assert rows.min() >= 0
    assert rows.max() <= 300e3


def test_roughness_is_its_own_quadratic():
    """v(x) = sum (x'' / s)^2 + sum (x' / t)^2: gradient and Hessian are those of half of it."""
    rng = np.random.default_rng(2)
    before, rows = rng.uniform(0, 3e5, (2, 2)), rng.uniform(0, 3e5, (4, 2))
    change = rng.normal(size=(4, 2)) * 1e4
    at, there = Roughness.of(before, rows), Roughness.of(before, rows + change)
    x = change.ravel() / UNIT
    assert there.value - at.value == pytest.approx(2 * at.gradient @ x + x @ at.hessian @ x)


def test_set_points_of_the_truth_stay(simulator, wanted):
    task = FollowTask(Case(DESIGN, REGULATOR.program(TRUTH)), wanted, REGULATOR, simulator)
    solved = solve(task, TRUTH.copy(), steps=2)
    assert np.array_equal(solved, TRUTH)  # nothing is to be gained below the noise


def test_what_a_corrector_adds_is_part_of_the_motion(simulator):
    """The wanted motion lies 2 mm in front of the simulator's: with that displacement the truth stays."""
    motion = moving(simulator)
    shift = np.zeros_like(motion)
    shift[..., 2] = 2e-3
    clouds = tuple(LoadedTarget(points) for points in motion + shift)
    wanted = Wanted(TIMES, clouds)
    case = Case(DESIGN, REGULATOR.program(TRUTH))
    with_it, without = (
        solve(FollowTask(case, wanted, REGULATOR, simulator, lacks), TRUTH.copy(), steps=1) for lacks in (shift, None)
    )
    assert np.abs(with_it - TRUTH).max() < 1e3
    assert np.abs(without - TRUTH).max() > 9e3  # 9.98 kPa on one processor, 10.0 on another


def test_pressures_nearby_are_recovered_from_clouds(simulator, wanted):
    begin = 0.7 * TRUTH
    task = FollowTask(Case(DESIGN, REGULATOR.program(begin)), wanted, REGULATOR, simulator)
    program = solve(task, begin, steps=4)
    assert rms(wanted, moving(simulator, program)) < 0.2 * rms(wanted, moving(simulator, begin))


def test_a_measured_motion_says_what_the_model_lacks(simulator):
    """A cloth shifted by 3 mm along its normals: half of it in front, half behind."""
    motion = moving(simulator)
    rng = np.random.default_rng(1)
    side = round(np.sqrt(motion.shape[1] / 2))
    grid = motion[:, : side * side].reshape(-1, side, side, 3)
    normal = np.cross(np.gradient(grid, axis=1), np.gradient(grid, axis=2))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    height = 3e-3 * np.linspace(-1, 1, side)[:, None, None]
    shift = (height * normal).reshape(len(motion), -1, 3)
    shifted = motion + np.concatenate([shift, shift], axis=1)
    clouds = tuple(Surface.of_faces(points).sample(1500, rng)[0] for points in shifted)
    run = MeasuredRun(Path("trial.npz"), TrialData(TIMES, TRUTH[np.zeros(len(TIMES), int)], clouds))
    beside, seen = displacements(run, motion, np.append(TIMES[:-1], 2.0))
    assert seen.tolist() == [True] * (len(TIMES) - 1) + [False]
    inner = np.abs(height.ravel()) < 2.5e-3
    off = (beside - np.concatenate([shift, shift], axis=1))[:-1].reshape(len(TIMES) - 1, 2, side, side, 3)[:, :, inner]
    assert np.sqrt((off**2).sum(axis=-1).mean()) < 3e-4


def folder(tmp_path: Path, wanted: Wanted, **more) -> Path:
    """A study file with a trial to follow."""
    write_design(DESIGN, tmp_path / "cross.toml")
    data = TrialData(TIMES, np.zeros((len(TIMES), 2)), tuple(t.points for t in wanted.targets))
    write_trial(data, tmp_path / "trial.npz")
    lines = ['format = "fabdesign.study/1"', 'kind = "follow"', 'design = "cross.toml"', f"points_per_side = {GRID}"]
    lines += [f"{name} = {value}" for name, value in more.items()]
    lines += ["[scatter]", "copies = 2", "[motion]", 'file = "trial.npz"']
    (tmp_path / "study.toml").write_text("\n".join(lines))
    return tmp_path / "study.toml"


@pytest.fixture
def quick(monkeypatch):
    """Two passes, on the test's grid."""
    monkeypatch.setattr("studies.follow.run.COARSE", GRID)
    monkeypatch.setattr("studies.follow.run.PASSES", ((2, 8, 0.3), (3, 4, 0.4)))


def test_a_study_goes_on_where_it_was_stopped_and_a_measured_run_corrects_it(tmp_path, wanted, simulator, quick):
    study, out = folder(tmp_path, wanted), tmp_path / "out"
    with pytest.raises(InputError, match=r"no pressures\.csv; expected the folder of a study whose program was run"):
        run_follow(study, out, measured=tmp_path / "trial.npz")
    assert not out.exists()
    first = run_follow(study, out, seconds=1e-6)
    assert not first.complete
    assert "the same command goes on" in first.sentences[-1]
    done = run_follow(study, out)
    [*_, last] = sorted((out / "pieces").glob("pass_1_*.npz"))
    last.unlink()  # as if it had been killed in the last window
    assert np.array_equal(run_follow(study, out).pressures, done.pressures)
    assert done.complete
    assert done.rms.mean() < 1.25 * rms(wanted, moving(simulator))  # after two passes
    assert done.begun > 1.5 * done.rms.mean()
    program = read_csv(out / "pressures.csv")
    assert np.array_equal(program.at(REGULATOR.cycle * np.arange(5)), done.pressures)
    content = json.loads((out / "result.json").read_text())
    assert content["error_mm"] == pytest.approx(1e3 * done.rms.mean())
    assert content["study"] == "../study.toml"  # the studio opens the folder by it
    assert "Wanted and predicted" in (out / "report.html").read_text()

    def measured(pressures, name):
        """What a heavier cloth does."""
        motion, rng = (
            moving(simulator, pressures, factors={"areal_density": 1.5, "bending": 1.3}),
            np.random.default_rng(7),
        )
        clouds = tuple(Surface.of_faces(points).sample(1500, rng)[0] for points in motion)
        write_trial(TrialData(TIMES, program.at(TIMES), clouds), tmp_path / name)
        return tmp_path / name

    before = measured(done.pressures, "run_1.npz")
    corrected = run_follow(study, out, measured=before)
    assert (corrected.run, (out / "pressures_1.csv").is_file()) == (1, True)
    again = run_follow(study, out, measured=measured(corrected.pressures, "run_2.npz"))
    assert again.measured_error < 0.7 * corrected.measured_error


def test_what_cannot_be_reached_is_answered_by_the_nearest_motion_and_the_reason(tmp_path, quick):
    write_design(DESIGN, tmp_path / "cross.toml")
    moment = {"time": 0.25, "wishes": [{"edge": "bottom", "forward": 0.15}]}
    study = FollowStudy.read(
        {"name": "far", "design": DESIGN, "points_per_side": GRID, "scatter": {"copies": 0}, "moments": [moment],
         "rig_limits": {"rate": 300.0}}
    )  # fmt: skip
    result = run_follow(study, tmp_path / "out")
    steps = np.abs(np.diff(np.concatenate([np.zeros((1, 2)), result.pressures]), axis=0))
    assert steps.max() <= 300e3 * 0.05 + 1e-6
    assert result.limitations[0].by == "rate"
    assert "as fast as the regulator changes" in result.sentences[0]
    free = replace(result, regulator=replace(result.regulator, rate=np.inf))

    def reason(*rows):
        [limit] = replace(
            free, pressures=np.array([*rows[:1] * (len(result.pressures) - len(rows)), *rows])
        ).limitations
        return limit.sentence

    assert reason([300e3, 0], [300e3, 0]).endswith("s channel 0 is at the highest pressure")  # the other one is idle
    assert reason([300e3, 300e3]).endswith("s channels 0, 1 are at the highest pressure")
    assert reason([50e3, 90e3], [0, 90e3]).endswith("s channel 0 is at the lowest pressure, after falling to it")
    assert "no limit of the regulator is met" in reason([50e3, 0], [50e3, 0])
    unmoved = replace(free, pressures=np.full_like(free.pressures, 50e3))
    assert "the layout does not reach the shape" in unmoved.sentences[0]
    assert replace(unmoved, complete=False).sentences[0].endswith("s the shape is not reached so far")


def test_between_poses_the_pressures_swing_nothing_to_its_goal(tmp_path, quick, monkeypatch):
    """Without the shapes between them a cloth is swung to a pose: one cycle differs by 268 kPa from its neighbours."""
    monkeypatch.setattr("studies.follow.run.PASSES", ((3, 4, 0.4),))
    moments = [{"time": time, "wishes": [{"edge": "bottom", "forward": 0.02}]} for time in (0.4, 0.8)]
    keys = {"name": "poses", "design": DESIGN, "points_per_side": GRID, "scatter": {"copies": 0}, "moments": moments}
    result = run_follow(FollowStudy.read(keys), tmp_path / "out")
    rest = np.zeros((2, 2))
    bends = np.abs(np.diff(np.concatenate([rest, result.pressures]), 2, axis=0))
    assert result.rms.max() < 6e-3 and len(result.motion) == 2
    assert bends.max() < 120e3  # Pa


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('[motion]\nfile = "none.npz"', "none.npz is not there"),
        ("", "expected one [motion], or [[moments]] with their times"),
        ("[[moments]]\ntime = 0.5\nwishes = []\n", "missing"),
        ('[[moments]]\ntime = 0\nwishes = [{edge = "bottom", forward = 0.05}]', "time = 0"),
        (
            '[[moments]]\ntime = 0.5\nwishes = [{edge = "bottom", forward = 0.05}]\n'
            '[[moments]]\ntime = 0.5\nwishes = [{edge = "bottom", forward = 0.02}]',
            "two at 0.5 s",
        ),
        ('[rig_limits]\ncycle = 0\n[[moments]]\ntime = 0.5\nwishes = [{edge = "bottom", forward = 0.05}]', "cycle = 0"),
    ],
)
def test_what_a_study_may_not_be_is_said_in_a_line(tmp_path, text, problem):
    write_design(DESIGN, tmp_path / "cross.toml")
    (tmp_path / "s.toml").write_text(f'format = "fabdesign.study/1"\nkind = "follow"\ndesign = "cross.toml"\n{text}\n')
    with pytest.raises(InputError) as error:
        FollowStudy.read(tmp_path / "s.toml")
    assert problem in str(error.value)
    assert "\n" not in str(error.value)

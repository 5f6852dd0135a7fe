"""A study from its file to its report, on a cloth in closed form; and the demo's plumbing."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.design_file import read_design
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.files.pressure_file import constant_program, read_pressures
from fabdesign.files.trial_file import TrialData, read_trial, write_trial
from fabdesign.formats.json_file import plain
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model, Spread
from fabdesign.nouns.model_sampling import spread_hash
from fabdesign.nouns.pressure import RISE_STEPS, regulated, rising_program
from fabdesign.study_files.study_file import MuscleChoice, Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from studies.demo import measured
from studies.demo.run import as_text, run_demo
from studies.layouts.result import write_best
from studies.layouts.run import FILES, run_study
from tests.analytic_cloth import AnalyticCloth

TRUTH = np.array([320e3, 60e3, 210e3])
TIME = 1.2  # s


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    """A noisy trial of two frames; the last one is what the cloth does at TIME."""
    design = build("vertical")
    times = np.array([0.6, TIME])
    motion = AnalyticCloth().motions([Case(design, constant_program(TRUTH))], [times])[0]
    motion = motion[:, ::4]  # fewer points make every distance cheaper
    frames = motion + np.random.default_rng(3).normal(0, 6e-4, motion.shape)
    write_trial(TrialData(times, np.tile(TRUTH, (2, 1)), tuple(frames)), tmp_path / "trial.npz")
    return tmp_path / "trial.npz"


def study(trial: Path, **changes: object) -> Study:
    return replace(Study("pose", build("vertical"), (TargetFile(trial),)), **changes)


def test_a_study_writes_what_others_read(trial: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_study(study(trial), out, forward=AnalyticCloth())
    result = json.loads((out / "result.json").read_text())
    keys = "objective_mm chamfer chamfer_floor evaluations wall_s muscles pressures_kpa constraints stop_reason seed"
    assert set(keys.split()) <= set(result)
    np.testing.assert_allclose(result["pressures_kpa"], TRUTH / 1e3, atol=8)
    assert result["chamfer"] == result["objective_mm"] < result["chamfer_floor"] + 0.2
    design = read_design(out / "design.toml")
    assert design.muscles == build("vertical").muscles
    program = read_pressures(out / "pressures.csv", design)
    np.testing.assert_allclose(program.pressure[-1] / 1e3, result["pressures_kpa"], atol=0.1, rtol=0)  # its steps
    assert program.duration == pytest.approx(TIME)
    table = (Path(__file__).parents[2] / "docs/studies.md").read_text().split("### Result of a search")[1]
    rows = [line.split("|")[1:3] for line in table.split("\n## ")[0].splitlines() if line.startswith("| `")]
    assert {name for row in rows for name in re.findall("`(\\w+)`", row[0])} == {*result}
    [reach] = [words for name, words in rows if "`reach`" in name]
    assert {*re.findall("`(\\w+)`", reach)} == {*result["reach"]}


def test_pressures_are_whole_steps_of_a_regulator(tmp_path: Path) -> None:
    """A number of 15 digits is no setting; none is raised, for a limit may lie there."""
    steps = np.arange(4001)
    for time in (None, 1.0):
        write_best(tmp_path, build("basic"), np.array([100.0 * steps[-8:] + 0.7]), {}, [time])
        text = (tmp_path / "pressures.csv").read_text()
        assert max(len(cell.partition(".")[2]) for line in text.splitlines()[1:] for cell in line.split(",")[1:]) <= 1
    linear = np.outer(np.arange(1, RISE_STEPS + 1) / RISE_STEPS, [3700.0, 81.3e3])  # Pa; the last row as it is given
    rise = rising_program(linear[-1], 1.0, 1.5).pressure
    assert rise[:-1].tolist() == regulated(linear[:-1]).tolist() and rise[-1].tolist() == linear[-1].tolist()
    assert rising_program(np.zeros(0), 1.0, 1.5).pressure.shape == (RISE_STEPS, 0)
    assert regulated(100.0 * steps).tolist() == (100 * steps).tolist()
    assert regulated(100.0 * steps + 99.0).tolist() == (100 * steps).tolist()


class Refusing(AnalyticCloth):
    """Computes nothing."""

    def motions(self, cases: object, times: object) -> list[np.ndarray]:
        raise AssertionError("a finished study asks for motions")

    def equilibria(self, cases: object) -> list[np.ndarray]:
        raise AssertionError("a finished study asks for shapes")


def test_a_finished_study_answers_at_once(trial: Path, tmp_path: Path) -> None:
    """By what it has kept: every value, every file; wider limits, where a limit ended it, go further."""
    out, cut = tmp_path / "out", study(trial, limits=StudyLimits(evaluations=60))
    first = run_study(cut, out, forward=AnalyticCloth())
    written = {name: (out / name).read_bytes() for name in FILES}
    again = run_study(cut, out, forward=Refusing())
    assert again.to_json() == first.to_json() and again.history == first.history
    assert again.search_time.endswith(
        "all in earlier calls on this folder, which count together: a larger limit goes on"
    )
    used = replace(again, stop_reason="time used: the limit of 600 s is reached")
    assert used.search_time.endswith("a larger --seconds goes on")
    assert first.search_time.endswith("(without compilation)")
    assert again.points.tobytes() == first.points.tobytes() and again.rest.tobytes() == first.rest.tobytes()
    assert again.pressure.tobytes() == first.pressure.tobytes() and again.design == first.design
    assert {name: (out / name).read_bytes() for name in FILES} == written
    (out / "report.html").unlink()
    run_study(cut, out, forward=Refusing())
    assert (out / "report.html").is_file() and (out / "result.json").read_bytes() == written["result.json"]
    further = replace(cut, limits=StudyLimits(evaluations=2000))
    done = run_study(further, out, forward=AnalyticCloth())
    assert len(done.history) > 60 and done.history[:60] == first.history and "limit" not in done.stop_reason
    converged = run_study(replace(cut, limits=StudyLimits(evaluations=4000)), out, forward=Refusing())
    assert converged.search_time.endswith("(without compilation)")
    with pytest.raises(AssertionError, match="finished study asks"):
        run_study(cut, out, forward=Refusing(), force=True)


def test_a_result_says_within_how_much_it_is_expected(trial: Path, tmp_path: Path) -> None:
    spread = Spread(0.003, 0.0, 0.0, 20, 0.9, spread_hash(Model()))
    result = run_study(study(trial, model=Model(spread=spread)), tmp_path / "out", forward=AnalyticCloth())
    assert result.to_json()["expected_within_mm"] == pytest.approx(3.0)
    assert "What is sewn is expected within 3.00 mm of this shape" in (tmp_path / "out" / "report.html").read_text()


def test_a_study_with_a_calibrated_model_ends_on_the_grid_that_its_factors_belong_to(
    trial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def simulator(points_per_side: int, **_: object) -> AnalyticCloth:
        asked.append(points_per_side)
        return AnalyticCloth()

    monkeypatch.setattr("sim.Simulator", simulator)
    for model in (None, Model({}), Model({}, points_per_side=61)):
        run_study(study(trial, model=model), tmp_path / str(len(asked)))
    assert asked == [41, 21, 41, 21, 61, 21]


def test_the_report_is_one_file_with_everything_in_it(trial: Path, tmp_path: Path) -> None:
    result = run_study(study(trial), tmp_path / "out", forward=AnalyticCloth())
    page = (tmp_path / "out" / "report.html").read_text()
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=", page)
    assert len(page) < 6e6
    for text in ("Chamfer", f"{1e3 * result.errors.chamfer:.2f}", f"{1e3 * result.errors.chamfer_floor:.2f}"):
        assert text in page
    figures = json.loads(re.findall(r'id="figures">(.*?)</script>', page)[0])
    assert [trace["name"] for trace in figures["scene-0-0"]["data"]][:3] == ["target", "result", "cloth at rest"]
    assert len(figures["curve-0"]["data"][0]["x"]) == len(result.history)
    assert page.count("<polyline") == 3
    assert "synthetic rig" not in page  # this target is no rig's


def test_every_pose_has_its_own_pressures(trial: Path, tmp_path: Path) -> None:
    both = study(trial, targets=(TargetFile(trial, 0), TargetFile(trial, 1)))
    run_study(both, tmp_path / "out", forward=AnalyticCloth())
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    np.testing.assert_allclose(result["pressures_kpa"], [TRUTH / 1e3] * 2, atol=12)
    assert (tmp_path / "out" / "pressures_2.csv").is_file()
    assert np.mean([pose["chamfer"] for pose in result["poses"]]) == pytest.approx(result["chamfer"])


def test_a_layout_keeps_the_limits_and_its_start(trial: Path, tmp_path: Path) -> None:
    limits = StudyLimits(evaluations=150, spacing=0.02)
    free = study(trial, muscles=MuscleChoice(1, 2, ("front",)), positions=True, limits=limits)
    result = run_study(free, tmp_path / "out", forward=AnalyticCloth())
    assert result.stop_reason == "the limit of 150 evaluations is reached"
    assert len(result.design.muscles) in (1, 2)
    assert min(result.constraints.values()) >= -1e-6
    assert result.errors.chamfer < result.rest_errors.chamfer


def test_the_best_so_far_is_there_before_the_end(trial: Path, tmp_path: Path) -> None:
    class PowerCut(AnalyticCloth):
        def motions(self, cases, times):  # type: ignore[no-untyped-def]
            if self.calls == 4:
                raise SystemExit
            return super().motions(cases, times)

    with pytest.raises(SystemExit):
        run_study(study(trial), tmp_path / "out", forward=PowerCut())
    early = json.loads((tmp_path / "out" / "result.json").read_text())
    assert early["stop_reason"].startswith("unfinished")
    assert read_design(tmp_path / "out" / "design.toml").channels == 3
    late = run_study(study(trial), tmp_path / "out", forward=AnalyticCloth())
    straight = run_study(study(trial), tmp_path / "straight", forward=AnalyticCloth())
    assert 1e3 * late.objective <= early["objective_mm"]
    np.testing.assert_array_equal(late.pressure, straight.pressure)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"targets": (TargetFile(Path("none.npz")),)}, "none.npz: no such file"),
        ({"muscles": MuscleChoice(40, 40), "limits": StudyLimits(spacing=0.05)}, "no layout of 40 muscles"),
        ({"design": replace(build("vertical"), muscles=())}, "has no muscles"),
    ],
)
def test_bad_studies_are_refused_before_anything_is_written(
    trial: Path, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    model = AnalyticCloth()
    with pytest.raises(InputError, match=message):
        run_study(study(trial, **change), tmp_path / "out", forward=model)
    assert model.calls == 0
    assert not (tmp_path / "out").exists()


def test_designs_that_all_diverge_are_an_error_and_no_result(trial: Path, tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="every design diverged"):
        run_study(study(trial), tmp_path / "out", forward=AnalyticCloth(fail_above=-1.0))


def test_a_frame_that_is_not_there_is_refused(trial: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="frame 2; expected -2 to 1"):
        run_study(study(trial, targets=(TargetFile(trial, 2),)), tmp_path / "out", forward=AnalyticCloth())


def test_a_place_that_cannot_be_written_is_refused_first(trial: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    model = AnalyticCloth()
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="file"):
            run_study(study(trial), out, forward=model)
    assert model.calls == 0


def test_a_ply_is_compared_with_the_equilibrium(tmp_path: Path) -> None:
    cloud = AnalyticCloth().equilibria([Case(build("vertical"), constant_program(TRUTH))])[0][::4]
    header = (
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    rows = "".join("{} {} {}\n".format(*point) for point in cloud)
    (tmp_path / "cloud.ply").write_text(header.format(len(cloud)) + rows)
    result = run_study(study(tmp_path / "cloud.ply"), tmp_path / "out", forward=AnalyticCloth())
    assert result.targets[0].time is None
    np.testing.assert_allclose(result.pressure[0], TRUTH, atol=8e3)


def test_the_demo_runs_both_searches_on_embedded_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = StudyLimits(seconds=2.0)
    monkeypatch.setattr("studies.demo.run.LIMITS", {"basic": limits, "free": limits})
    data = Path(measured.__file__).parents[2] / "fabdesign" / "data"
    errors = {measured.CALIBRATED: Errors(7e-3, 6e-3, 2e-3, 0.6e-3), measured.CORRECTED: Errors(6e-3, 6e-3, 1 / 3e3, 0)}
    shipped = measured.ShippedErrors(
        read_set(data / measured.SET),
        read_model(data / measured.MODEL),
        errors,
        0.1,
        {"076": Errors(1 / 3, 0, 0, 0)},
        {},
    )
    monkeypatch.setattr("studies.demo.run.evaluate_shipped", lambda **_: shipped)  # held by tests/house/test_demo.py
    demo = run_demo(tmp_path, forward=AnalyticCloth(), coarse=AnalyticCloth(21))
    runs, results = plain(demo)["runs"], demo.runs
    assert [run["name"] for run in runs] == ["basic", "free"]
    assert all(run["chamfer_floor"] < run["chamfer"] < 30 for run in runs)  # a closed form is no cloth
    assert [len(results[0].design.muscles), len(results[1].design.muscles) <= 4] == [8, True]
    assert "synthetic rig" in as_text(demo)
    assert "* share of the excess error (surface RMS over its floor) of calibrated that is removed" in as_text(demo)
    page = (tmp_path / "report.html").read_text()
    assert "synthetic rig" in page
    assert "not hardware" in page.replace("\n", " ")

    def again(**_: object) -> None:
        raise AssertionError("a finished demo compares the model once more")

    monkeypatch.setattr("studies.demo.run.evaluate_shipped", again)
    monkeypatch.setattr("studies.demo.run.render_report", again)
    repeated = run_demo(tmp_path, forward=Refusing(), coarse=Refusing())
    assert plain(repeated) == plain(demo) and as_text(repeated) == as_text(demo)


def test_the_demo_target_is_the_measured_one(data: Path) -> None:
    from importlib.resources import as_file, files

    with as_file(files("fabdesign") / "data" / "demo_target.npz") as path:
        embedded = read_trial(path)
        assert path.stat().st_size < 1e6
    measured = read_trial(data / "rig_a" / "trials" / "078.npz")
    assert embedded.time.tolist() == measured.time[-1:].tolist()
    np.testing.assert_allclose(embedded.frames[0], measured.frames[-1], atol=1e-9)

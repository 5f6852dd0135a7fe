"""Through the command line: nothing is replaced unasked, one run a folder, and what is killed leaves nothing."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fabdesign.cli import commands
from fabdesign.files.design_file import write_design
from fabdesign.files.measurement_set import NewTrial, TrialData, write_set
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.catalogue import build
from fabdesign.study_files.study_file import StudyLimits
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line
from tests.conftest import ROOT

WRITING = [name for name, command in commands.commands.items() if any("-o" in p.opts for p in command.params)]
STUDY = 'kind = "optimize"\ndesign = "vertical.toml"\n[target]\nfile = "target.npz"\n[limits]\nseconds = 60\n'


def snapshot(top: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in top.rglob("*")}


@pytest.mark.parametrize("command", WRITING)
def test_every_command_that_writes_takes_force(command: str) -> None:
    assert "--force" in [option for parameter in commands.commands[command].params for option in parameter.opts]


# what to run where its output is there already, as a file or as a folder that fabdesign made
AGAIN = [
    "new cross -o d2.toml",
    "simulate cross.toml --pressures 1,2 -o m.npz",
    "simulate cross.toml --pressures 1,2 --equilibrium -o e.npz --mesh shape.ply",
    "predict set --model model.toml -o predicted",
    "evaluate set --model model.toml --all -o evaluated",
    "export cross.toml --tail-length 0.05 --paper none -o templates",
]


@pytest.mark.parametrize("line", AGAIN)
def test_output_is_refused_and_replaced_with_force(
    line: str,
    run: Run,
    hanging: type,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("studies.prediction.evaluation_report.write_histogram", lambda _, path: path.touch())  # is slow
    monkeypatch.chdir(folder)
    assert run(*line.split())[0] == 0
    before = snapshot(folder)
    hanging.asked = []
    one_line(run(*line.split()), "--force replaces it")
    assert (snapshot(folder), hanging.asked) == (before, [])
    assert run(*line.split(), "--force")[0] == 0
    assert snapshot(folder).keys() == before.keys()
    out = Path(line.split("-o ")[1].split()[0])
    if out.is_dir():
        (out / "notes.txt").write_text("mine")
        before = snapshot(folder)
        for force in ([], ["--force"]):
            one_line(run(*line.split(), *force), "holds notes.txt, which fabdesign did not make there")
        assert snapshot(folder) == before


# what would write over what it reads
INTO_INPUTS = [
    ("simulate cross.toml --pressures 1,2 -o cross.toml", "ends in .toml, another format"),
    ("simulate cross.toml --pressures 1,2 -o em20_bench.csv", "ends in .csv, another format"),
    ("simulate cross.toml --pressures p.csv -o link.csv", "ends in .csv, another format"),
    ("simulate cross.toml --pressures set/trials/000.npz -o set/trials/000.npz", "is an input"),
    ("simulate cross.toml --pressures set/trials/000.npz -o link.npz", "is an input"),
    ("simulate cross.toml --pressures 1,2 --model model.toml -o ../{}/model.toml", "ends in .toml, another format"),
    ("predict set --model model.toml -o set", "is an input"),
    ("predict set --model model.toml -o set/trials", "holds the input"),
    ("evaluate set --model model.toml -o .", "holds the input"),
    ("simulate cross.toml --pressures 1,2 --effects own.py -o own.py", "is an input"),
    ("calibrate set --model model.toml -o model.toml", "is an input"),
    ("trace set --model traced/model.toml -o traced", "holds the input model.toml"),
    ("calibrate set -o set/set.toml", "is part of the input set"),
    ("calibrate set -o set/trials/000.npz", "ends in .npz, another format"),
    ("export cross.toml -o .", "holds the input"),
    ("rig cross.toml --pressures 1,2 -o .", "holds the input"),
    ("rig cross.toml --pressures 1,2 -o new --recording new/raw", "not apart from the set"),
    ("rig set/cross.toml --pressures set/trials/000.npz -o set", "holds the input"),
    ("fuse recording -o recording", "is an input"),
    ("fuse recording -o .", "holds the input"),
    ("optimize study.toml -o .", "holds the input"),
    ("optimize study.toml -o set/trials", "holds the input"),
]


@pytest.mark.parametrize(("line", "problem"), INTO_INPUTS)
def test_an_input_is_never_an_output(
    line: str,
    problem: str,
    run: Run,
    hanging: type,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    (folder / "link.csv").symlink_to("p.csv")
    (folder / "link.npz").symlink_to("set/trials/000.npz")
    (folder / "traced").mkdir()
    shutil.copy(folder / "model.toml", folder / "traced")
    (folder / "own.py").write_text('from fabdesign.effects import EFFECTS\n\nAIR_DRAG = EFFECTS["air_drag"]\n')
    (folder / "study.toml").write_text(STUDY.replace("vertical", "cross").replace("target.npz", "set/trials/000.npz"))
    write_recording(folder / "recording")
    before = snapshot(folder)
    hanging.asked = []
    for force in ([], ["--force"]):
        one_line(run(*line.format(folder.name).split(), *force), problem)
    assert (snapshot(folder), hanging.asked) == (before, [])


def write_recording(place: Path) -> None:
    """One that can be opened."""
    place.mkdir()
    write_design(build("cross"), place / "cross.toml")
    (place / "pressure.csv").write_text("time_s,channel_0,channel_1\n0,100,0\n")
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.5
    (place / "recording.toml").write_text(
        'format = "fabdesign.recording/1"\ndesign = "cross.toml"\ntimes = [0.1]\n'
        f'[[sensors]]\nname = "front"\ncamera_to_world = {pose.tolist()}\n'
    )
    np.savez(place / "front.npz", points=np.full((9, 3), 0.5))
    (place / "frames" / "0000").mkdir(parents=True)
    (place / "front.npz").rename(place / "frames" / "0000" / "front.npz")


def test_new_does_not_keep_another_bench_table_unasked(run: Run, tmp_path: Path) -> None:
    assert run("new", "basic", "-o", tmp_path / "a.toml")[0] == 0
    bench = tmp_path / "em20_bench.csv"
    catalogue = bench.read_text()
    assert run("new", "side", "-o", tmp_path / "b.toml")[0] == 0  # shares the table
    bench.write_text("\n".join(catalogue.splitlines()[:-1]) + "\n")
    one_line(run("new", "cross", "-o", tmp_path / "c.toml"), "em20_bench.csv: exists; --force replaces it")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.toml", "b.toml", "em20_bench.csv"]
    assert run("new", "cross", "-o", tmp_path / "c.toml", "--force")[0] == 0
    assert bench.read_text() == catalogue


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of `vertical` whose forward model is in closed form."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sim.Simulator", lambda *args, **options: AnalyticCloth(11), raising=False)
    write_design(build("vertical"), tmp_path / "vertical.toml")
    points = np.random.default_rng(3).uniform([-0.1, -0.18, 0], [0.1, 0, 0.02], (300, 3))
    trial = NewTrial("000", "v", 0, "fit", TrialData(np.array([1.0]), np.full((1, 3), 1e5), (points,)))
    write_set(tmp_path / "set", {"v": build("vertical")}, [trial], name="x")
    (tmp_path / "set" / "trials" / "000.npz").rename(tmp_path / "target.npz")
    path = tmp_path / "study.toml"
    path.write_text(STUDY + "evaluations = 60\n")
    return path


def result(out: str = "out") -> dict[str, object]:
    return dict(json.loads(Path(out, "result.json").read_text()))


def test_the_same_search_goes_on_and_further_with_more(run: Run, study: Path) -> None:
    assert run("optimize", study, "-o", "out")[0] == 0
    first = result()
    assert (first["evaluations"], first["stop_reason"]) == (60, "the limit of 60 evaluations is reached")
    assert run("optimize", study, "-o", "out")[0] == 0
    assert result() == first | {"wall_s": result()["wall_s"]}
    study.write_text(study.read_text().replace("= 60\n", "= 90\n"))
    assert run("optimize", study, "-o", "out")[0] == 0
    assert 60 < int(str(result()["evaluations"])) <= 90
    assert float(str(result()["objective_mm"])) <= float(str(first["objective_mm"]))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[target]", "seed = 2\n[target]", "(seed was 1, now 2)"),
        ("[limits]", "[limits]\npressure = [0, 300]", "(limits.pressure was [0.0, 400.0], now [0.0, 300.0])"),
        ("[limits]", "[limits]\nspacing = 0.008", "(limits.spacing was 0.006, now 0.008)"),
        ("vertical.toml", "thick.toml", "(design.fabric.thickness was 0.0007, now 0.0009)"),
        ("target.npz", "other.npz", "(target.points differs)"),
    ],
)
def test_a_changed_study_is_refused_with_what_differs(
    old: str,
    new: str,
    problem: str,
    run: Run,
    study: Path,
) -> None:
    design, trial = Path("vertical.toml").read_text(), np.load("target.npz")
    thickness = f"thickness = {build('vertical').fabric.thickness}"
    assert thickness in design
    problem = problem.replace("was 0.0007", f"was {build('vertical').fabric.thickness}")
    Path("thick.toml").write_text(design.replace(thickness, "thickness = 0.0009"))
    np.savez("other.npz", **{**trial, "points": trial["points"] + 1})
    assert run("optimize", study, "-o", "out")[0] == 0
    before = snapshot(Path("out"))
    Path("changed.toml").write_text(study.read_text().replace(old, new))
    one_line(run("optimize", "changed.toml", "-o", "out"), problem)
    assert snapshot(Path("out")) == before


def test_force_searches_anew_and_the_old_stays_until_then(
    run: Run,
    study: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Stopped(AnalyticCloth):
        def motions(self, cases, times):  # type: ignore[no-untyped-def]
            assert result() == first
            if self.calls == 2:
                self.calls += 1
                raise KeyboardInterrupt
            return super().motions(cases, times)

    assert run("optimize", study, "-o", "out")[0] == 0
    first = result()
    study.write_text(study.read_text().replace("[target]", "seed = 5\n[target]"))
    with monkeypatch.context() as patch:
        stopped = Stopped(11)
        patch.setattr("sim.Simulator", lambda *args, **options: stopped)
        code, out, _ = run("optimize", study, "-o", "out", "--force")
    assert (code, result()) == (0, first)
    assert "interrupted; the same command goes on from here; out holds the earlier result until then" in out
    assert run("optimize", study, "-o", "out", "--force")[0] == 0
    assert (result()["seed"], result()["evaluations"]) == (5, 60)
    assert not list(Path("out").glob(".unfinished*"))
    assert run("optimize", study, "-o", "out")[0] == 0  # the folder is the new study's


def test_a_folder_of_another_command_is_no_place_for_a_search(run: Run, study: Path) -> None:
    assert run("export", "vertical.toml", "--tail-length", 0.05, "-o", "out")[0] == 0
    one_line(run("optimize", study, "-o", "out"), "out: exists, made by fabdesign export; --force replaces it")
    assert run("optimize", study, "-o", "out", "--force")[0] == 0
    assert not list(Path("out").glob("*.svg"))


def test_a_search_does_not_write_into_the_result_that_it_starts_from(run: Run, study: Path) -> None:
    assert run("optimize", study, "-o", "out")[0] == 0
    study.write_text('start = "out"\n' + study.read_text())
    before = snapshot(Path("out"))
    for force in ([], ["--force"]):
        one_line(run("optimize", study, "-o", "out", *force), "out: holds the input design.toml")
    assert snapshot(Path("out")) == before


def test_demo_again_and_after_an_interruption(
    run: Run,
    study: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limits = StudyLimits(seconds=0.3)
    monkeypatch.setattr("studies.demo.run.LIMITS", {"basic": limits, "free": limits})
    monkeypatch.setattr("studies.layout_search.first_layouts.LAYOUT_STARTS", 8)
    monkeypatch.setattr("studies.layout_search.first_layouts.THINNED_STARTS", 8)
    # what it writes counts here, not what stands in it
    monkeypatch.setattr(
        "studies.layouts.run.target_errors", lambda _, shape, *args, **options: Errors(*[float(np.std(shape))] * 4)
    )
    monkeypatch.setattr("studies.demo.run.save_picture", lambda _, path: path.touch())
    monkeypatch.setattr("studies.demo.run.evaluate_shipped", lambda **options: None)

    class Stopped(AnalyticCloth):
        def motions(self, cases, times):  # type: ignore[no-untyped-def]
            if self.calls == 3:
                raise KeyboardInterrupt
            return super().motions(cases, times)

    with monkeypatch.context() as patch:
        patch.setattr("sim.Simulator", lambda *args, **options: Stopped(11))
        run("demo", "-o", "demo")
    code, out, _ = run("demo", "-o", "demo", "--json")
    assert (code, [entry["name"] for entry in json.loads(out)["runs"]]) == (0, ["basic", "free"])
    before = {path for path in snapshot(Path("demo")) if path.is_file()}
    assert Path("demo/report.html") in before
    for force in ([], ["--force"]):
        code, again, _ = run("demo", "-o", "demo", "--json", *force)
        assert code == 0
        assert {path for path in snapshot(Path("demo")) if path.is_file()} == before
        if not force:
            keys = ("name", "chamfer", "evaluations")
            shown = [[[entry[key] for key in keys] for entry in json.loads(text)["runs"]] for text in (out, again)]
            assert shown[0] == shown[1]
    Path("demo/notes.txt").write_text("mine")
    one_line(run("demo", "-o", "demo", "--force"), "holds notes.txt")


# the commands with a forward model that never ends; it says when it has begun
SLOW = """
import pathlib, sys, time, types
from tests.analytic_cloth import AnalyticCloth

class Slow(AnalyticCloth):
    def __init__(self, *args, **options):
        super().__init__(11)
    def motions(self, cases, times):
        if self.calls or sys.argv[1] != "optimize":
            pathlib.Path("begun").touch()
            time.sleep(600)
        return super().motions(cases, times)

sys.modules["sim"] = types.SimpleNamespace(Simulator=Slow)  # without taichi, which takes long to load
from fabdesign.cli import main
main()
"""
Start = Callable[[str], "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Starts a command of SLOW and returns when its forward model is at work, or when it has ended."""

    def begin(line: str) -> "subprocess.Popen[str]":
        (tmp_path / "begun").unlink(missing_ok=True)
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        arguments = [sys.executable, "-c", SLOW, *line.split()]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = subprocess.Popen(arguments, cwd=tmp_path, env=environment, text=True, **pipes)
        end = time.monotonic() + 60
        while not (tmp_path / "begun").exists() and process.poll() is None:
            assert time.monotonic() < end
            time.sleep(0.05)
        (tmp_path / "begun").unlink(missing_ok=True)
        return process

    return begin


SIMULATE = "simulate cross.toml --pressures 1,2 -o new/m.npz"
PREDICT = "predict set --model model.toml -o new/predicted"


@pytest.mark.skipif(os.name == "nt", reason="no signals")
@pytest.mark.parametrize("line", [SIMULATE, PREDICT])
def test_sigterm_leaves_nothing_and_kill_is_swept(
    line: str,
    folder: Path,
    hanging: type,
    run: Run,
    start: Start,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = snapshot(folder)
    first = start(line)
    second = start(line)
    one_line((second.wait(), "", second.communicate()[1]), "another run is writing there")
    first.terminate()
    _, error = first.communicate()
    assert first.returncode == 143
    assert error.splitlines()[-1:] == ["fabdesign: terminated by SIGTERM"]
    assert snapshot(folder) == before
    killed = start(line)
    killed.kill()
    killed.communicate()
    assert list(folder.rglob(".unfinished*"))
    monkeypatch.chdir(folder)
    other = line.replace("m.npz", "m2.npz")
    assert run(*other.split())[0] == 0
    assert not list(folder.rglob(".unfinished*"))


@pytest.mark.skipif(os.name == "nt", reason="no signals")
def test_two_searches_at_once_and_what_signals_leave_of_one(run: Run, study: Path, start: Start) -> None:
    first = start("optimize study.toml -o out")
    second = start("optimize study.toml -o out")
    _, error = second.communicate()
    assert (second.returncode, error) == (
        2,
        "fabdesign: out: another run is writing there; expected to be the only one\n",
    )
    first.send_signal(signal.SIGTERM)
    first.communicate()
    assert first.returncode == 143
    assert not list(Path("out").glob(".unfinished*"))
    third = start("optimize study.toml -o out")
    third.kill()
    third.communicate()
    assert run("optimize", study, "-o", "out")[0] == 0
    assert run("optimize", study, "-o", "straight")[0] == 0
    assert result()["pressures_kpa"] == result("straight")["pressures_kpa"]
    assert not list(Path("out").glob(".unfinished*"))

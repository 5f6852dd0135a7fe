"""The command line: help, exit codes, one line for each bad input, and nothing half written."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

from fabdesign.cli import commands
from fabdesign.errors import SimulationError
from fabdesign.files.design_file import read_design
from fabdesign.files.model_file import read_model
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import PARTS
from studies.prediction.predict import require_motions
from tests.command_line import Diverging, Hanging, Run, one_line
from tests.conftest import ROOT


@pytest.mark.parametrize("command", ["", *commands.commands])
def test_help_answers_in_half_a_second(command: str) -> None:
    line = [sys.executable, "-m", "fabdesign", *([command] if command else []), "--help"]
    before = os.times()
    subprocess.run(line, cwd=ROOT, check=True, capture_output=True)
    after = os.times()
    # processor seconds of the one thread: what the wall clock shows where nothing else runs
    assert after.children_user + after.children_system - before.children_user - before.children_system < 0.5


def test_the_commands_load_without_numpy_and_a_help_names_a_models_parts() -> None:
    code = "import sys, fabdesign.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
    assert f"{', '.join(PARTS)}." in str(
        next(one.help for one in commands.commands["predict"].params if one.name == "without")
    )


@pytest.mark.parametrize(("given", "taken"), [(None, "1"), ("3", "3")])
def test_matrices_take_one_thread_unless_the_environment_says_otherwise(given: str | None, taken: str) -> None:
    code = (
        "import os, sys, fabdesign.cli; sys.argv = ['fabdesign', 'check', 'none']\n"
        "try: fabdesign.cli.main()\nexcept SystemExit: print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    inherited = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment = inherited | ({} if given is None else {"OPENBLAS_NUM_THREADS": given})
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{taken}\n"


@pytest.mark.parametrize("command", [*commands.commands])
def test_every_command_takes_json(command: str) -> None:
    click_command = commands.commands[command]
    each = [*click_command.commands.values()] if isinstance(click_command, click.Group) else [click_command]
    for one in each:
        assert "--json" in [option for parameter in one.params for option in parameter.opts], one.name


def test_new_then_check_then_export(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    code, out, _ = run("new", "vertical", "--width", "0.3", "--muscles", 4, "--name", "mine", "-o", path, "--json")
    assert (code, json.loads(out)) == (0, {"design": str(path), "muscles": 4, "channels": 4})
    assert read_design(path) == build("vertical", width=0.3, muscles=4, name="mine")
    assert run("check", path)[0] == 0
    code, out, _ = run("export", path, "--tail-length", 0.03, "-o", tmp_path / "out", "--json")
    assert code == 0
    assert {Path(file) for file in json.loads(out)["files"]} == set((tmp_path / "out").glob("[!.]*"))


def test_check_names_every_problem(run: Run, folder: Path) -> None:
    for name in ("000", "002"):
        path = folder / "set" / "trials" / f"{name}.npz"
        path.write_bytes(path.read_bytes()[:200])
    code, out, err = run("check", folder / "set", folder / "model.toml", folder / "p.csv", folder / "em20_bench.csv")
    assert code == 2
    problems = err.splitlines()
    assert [line.split(".npz")[0][-3:] for line in problems] == ["000", "002"]
    assert len(out.splitlines()) == 3
    code, out, err = run("check", folder / "set", folder / "cross.toml", "--json")
    result = json.loads(out)["files"]
    assert [entry["sound"] for entry in result.values()] == [False, True]


def test_simulate(run: Run, hanging: type[Hanging], folder: Path) -> None:
    out = folder / "out.npz"
    arguments = ("simulate", folder / "cross.toml", "--pressures", folder / "p.csv", "--model", folder / "model.toml")
    code, printed, _ = run(*arguments, "-o", out, "--json")
    assert (code, json.loads(printed)) == (0, {"motion": str(out), "frames": 61, "points": 3362})
    assert hanging.asked[0].factors == {"membrane": 1.1}
    with np.load(out) as motion:
        muscles = {f"muscle_{name}" for name in ("begins", "points", "diameters", "sides")}
        assert set(motion) == {"time", "points", "triangles", "cloth_size"} | muscles
        assert motion["time"].tolist() == [k / 60 for k in range(61)]
        assert (motion["points"].shape, motion["points"].dtype) == ((61, 3362, 3), np.float32)
    assert (hanging.side, hanging.options) == (41, {"self_contact": False, "rise": 1.0, "hold": 10.0})
    options = ("--self-contact", "--grid", 81)
    run("simulate", folder / "bare.toml", "--duration", 0.1, "--frame-rate", 100, *options, "-o", out, "--force")
    assert np.load(out)["time"].tolist() == [k / 100 for k in range(11)]
    assert (hanging.side, hanging.options) == (81, {"self_contact": True, "rise": 1.0, "hold": 10.0})


def test_predict_a_set_and_a_trial(run: Run, hanging: type[Hanging], folder: Path) -> None:
    code, out, _ = run("predict", folder / "set", "--model", folder / "model.toml", "-o", folder / "a", "--json")
    assert code == 0
    assert len(json.loads(out)["motions"]) == 3
    assert sorted(file.name for file in (folder / "a" / "trials").iterdir()) == ["000.npz", "001.npz", "002.npz"]
    assert [case.program.pressure[0, 0] for case in hanging.asked] == [0, 1e5, 2e5]
    assert np.load(folder / "a" / "trials" / "001.npz")["time"].tolist() == [0.1, 0.2]
    trial = folder / "set" / "trials" / "002.npz"
    design = ("--design", folder / "cross.toml")
    assert run("predict", trial, "--model", folder / "model.toml", *design, "-o", folder / "b")[0] == 0
    assert [file.name for file in (folder / "b" / "trials").iterdir()] == ["002.npz"]


def test_predict_several_sets(run: Run, hanging: type[Hanging], folder: Path) -> None:
    """Each under its name, with as many trials of one name as there are sets; two sets of one name are refused."""
    shutil.copytree(folder / "set", folder / "other")
    text = (folder / "other" / "set.toml").read_text()
    (folder / "other" / "set.toml").write_text(text.replace('name = "x"', 'name = "y"'))
    sets, model = (folder / "set", folder / "other"), ("--model", folder / "model.toml")
    code, out, err = run("predict", *sets, *model, "-o", folder / "both", "--json")
    assert code == 0
    expected = [folder / "both" / name / "trials" / f"00{k}.npz" for name in "xy" for k in range(3)]
    assert [Path(file) for file in json.loads(out)["motions"]] == expected
    assert all(file.is_file() for file in expected)
    assert err.splitlines()[-1] == "predicted 6 of 6 trials"
    code, _, err = run("predict", folder / "set", folder / "set", *model, "-o", folder / "twice")
    assert (code, (folder / "twice").exists()) == (2, False)
    assert "set x: expected sets with a name of their own" in err


def test_bench_becomes_a_cloth_that_a_design_includes(run: Run, folder: Path) -> None:
    bench = folder / "strip"
    bench.mkdir()
    head = 'format = "fabdesign.bench/1"\nspecimen = "strip"\nwidth = 0.05\ninput = ["stretch"]\noutput = "force_n"\n'
    for i in range(3):
        # tension over width: 520 N/m times the strain
        rows = [f"{1 + 0.004 * k},{520 * 0.05 * 0.004 * k}" for k in range(26)]
        (bench / f"r{i}.csv").write_text("\n".join(["stretch,force_n", *rows]) + "\n")
        head += f'[[records]]\nfile = "r{i}.csv"\n'
    (bench / "bench.toml").write_text(head)
    code, out, _ = run("calibrate", bench, "--fit", "r0,r1", "-o", folder / "cloth.toml", "--json")
    assert code == 0
    assert json.loads(out)["error_fit"] < 0.01  # N
    bare = (folder / "bare.toml").read_text()
    (folder / "new.toml").write_text(
        bare.replace("[fabric]", 'include = ["cloth.toml"]\n[fabric]').replace(
            "membrane_stiffness = [520.0, 520.0]", ""
        )
    )
    assert read_design(folder / "new.toml").fabric.membrane_stiffness == pytest.approx((520, 520), rel=0.03)


def test_model_is_used_on_the_grid_that_it_was_fitted_on(run: Run, hanging: type[Hanging], folder: Path) -> None:
    """A cloth that no factor moves: the data sheet stays, its prior the only thing known."""
    hanging.made.clear()
    code, out, _ = run("calibrate", folder / "set", "-o", folder / "fitted.toml", "--json")
    assert (code, hanging.made) == (0, {21, 41})  # stretches and all steps, the last look
    hanging.made.clear()
    assert run("calibrate", folder / "set", "--grid", 61, "-o", folder / "finer.toml")[0] == 0
    assert hanging.made == {21, 61}
    model = ("--model", folder / "finer.toml")
    simulate = ("simulate", folder / "cross.toml", "--pressures", "1,2", *model, "-o", folder / "fitted.npz")
    for arguments in (
        ("evaluate", folder / "set", *model, "--all"),
        ("predict", folder / "set", *model, "-o", folder / "f"),
        simulate,
    ):
        hanging.made.clear()
        assert run(*arguments)[0] == 0
        assert hanging.made == ({21, 61} if arguments[0] == "evaluate" else {61})  # evaluate looks for stretches too
    hanging.made.clear()
    assert run(*simulate, "--grid", 21, "--force")[0] == 0
    assert hanging.made == {21}
    hanging.made.clear()
    assert run("calibrate", folder / "set", "--grid", 31, "-o", folder / "coarser.toml")[0] == 0
    assert (hanging.made, read_model(folder / "coarser.toml").points_per_side) == ({21, 31}, 31)
    membrane = json.loads(out)["parameters"]["membrane"]
    assert membrane["factor"] == pytest.approx(1.0)
    assert np.log(membrane["interval90"]) == pytest.approx([-1.645 * 0.15, 1.645 * 0.15], rel=0.01)


@pytest.mark.usefixtures("hanging")
def test_evaluate(run: Run, folder: Path) -> None:
    arguments = ("evaluate", folder / "set", "--model", folder / "model.toml", "--all")
    code, out, err = run(*arguments, "-o", folder / "out", "--json")
    result = json.loads(out)
    assert (code, result["unit"], result["designs"]) == (0, "mm", {})
    assert result["others"]["cross"]["after"]["surface_rms"]["max"] < 1e-3  # mm: the measured points lie on the cloth
    estimate, *counted = err.splitlines()
    assert estimate.startswith("3 trials, ") and len(counted) == 3
    assert (folder / "out" / "evaluation.json").is_file()


def test_diverged_motion_exits_with_1_and_writes_nothing(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.Simulator", Diverging, raising=False)
    code, _, err = run("simulate", folder / "cross.toml", "--pressures", "1,2", "-o", folder / "x.npz")
    assert (code, len(err.splitlines())) == (1, 1)
    assert "diverged at 0.017 s" in err
    assert run("predict", folder / "set", "--model", folder / "model.toml", "-o", folder / "x")[0] == 1
    assert not list(folder.glob("x*"))


def test_place_that_cannot_be_written_is_refused_before_computing(
    run: Run, hanging: type[Hanging], folder: Path
) -> None:
    (folder / "file").write_text("in the way")
    hanging.asked = []
    for arguments in (("simulate", "cross.toml", "--pressures", "1,2"), ("predict", "set", "--model", "model.toml")):
        paths = [folder / word if "." in word or word == "set" else word for word in arguments]
        assert run(*paths, "-o", folder / "file" / "out")[0] == 2
    assert hanging.asked == []


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (
            "simulate cross.toml --pressures 100,0 -o x.mp4",
            "x.mp4: ends in .mp4, another format; expected a name that ends in .npz; fabdesign view x.npz -o x.mp4",
        ),
        ("simulate cross.toml --pressures 100,0 -o x.csv", "x.csv: ends in .csv, another format; expected a name that"),
        ("new cross -o x.json", "x.json: ends in .json, another format; expected a name that ends in .toml"),
        ("calibrate set -o x.npz", "another format; expected a name that ends in .toml"),
        ("train set -o x.safetensors", "another format; expected a name that ends in .toml"),
        *((f"{words} -o x.html", "another format; expected the name of a folder") for words in (
            "predict set --model model.toml", "evaluate set --model model.toml", "export cross.toml", "trace set",
            "fuse set", "rig cross.toml --pressures p.csv", "optimize s.toml", "sensitivity s.toml", "study s.toml",
            "loop s.toml", "demo",
        )),
        ("view set -o x.npz", "expected a name that ends in .html, .png, .gif, .mp4, "),
        ("studies table set -o x.xlsx", "expected a name that ends in .csv, .parquet or .db"),
    ],
)  # fmt: skip
def test_an_ending_of_another_format_is_refused(
    words: str, problem: str, run: Run, folder: Path, hanging: type[Hanging], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    one_line(run(*words.split()), problem)
    assert not [*folder.glob("x*")]


def test_a_motion_that_diverges_on_a_coarse_grid_names_the_grid(folder: Path) -> None:
    """Fixed points 20 mm apart on a grid of 25 mm: 11 points a side follow them."""
    coarse = Diverging(9)
    coarse.points_per_side = 9  # type: ignore[attr-defined]
    with pytest.raises(SimulationError) as caught:
        program = constant_program(np.full(build("basic").channels, 3e5))
        require_motions(coarse, [Case(build("basic"), program)], [np.array([0.0, 0.2])])
    assert str(caught.value) == (
        "basic: the motion diverged at 0.200 s on a grid of 9 points a side, 25 mm apart, wider than the fixed points' "
        "20 mm; expected --grid 11 or more; nothing written"
    )


def test_installed_program_prints_no_traceback(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "fabdesign", "check", str(tmp_path / "none")]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"fabdesign: {tmp_path / 'none'}: no such file\n"

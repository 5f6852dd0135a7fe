"""The command line: help, exit codes, one line for each bad input, and nothing half written."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from fabdesign.catalogue import build, standard
from fabdesign.cli import commands, main
from fabdesign.design_file import read_design, write_design
from fabdesign.forward import Case
from fabdesign.measurement_set import NewTrial, TrialData, write_set
from fabdesign.model import EffectTerm, Model, Parameter
from fabdesign.model_file import read_model, write_model
from tests.conftest import ROOT

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `fabdesign ARGUMENTS...`: exit code, standard output, standard error."""

    monkeypatch.setenv("FABDESIGN_LANES", "8")  # as the simulator of this process has them

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["fabdesign", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        out, err = capsys.readouterr()
        return code, out, err

    return call


class Hanging:
    """A forward model whose cloth stays at rest; it notes what it was asked."""

    asked: list[Case] = []  # noqa: RUF012
    options: dict[str, object] = {}  # noqa: RUF012
    side = 0
    made: set[int] = set()  # noqa: RUF012

    def __init__(self, points_per_side: int = 41, **options: object) -> None:
        Hanging.side, Hanging.options = points_per_side, options
        Hanging.made.add(points_per_side)

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        Hanging.asked = list(cases)
        u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, -0.2, 41))
        faces = [np.stack([u, v, np.full_like(u, z)], axis=-1).reshape(-1, 3) for z in (1e-3, -1e-3)]
        return [np.tile(np.concatenate(faces).astype(np.float32), (len(t), 1, 1)) for t in times]

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        return [motion[0] for motion in self.motions(cases, [np.zeros(1)] * len(cases))]


class Diverging(Hanging):
    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        motions = super().motions(cases, times)
        motions[-1][1:] = np.nan
        return motions


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> type[Hanging]:
    monkeypatch.setattr("sim.Simulator", Hanging, raising=False)
    return Hanging


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A design, a model, a pressure table and a set, all sound."""
    write_design(build("cross"), tmp_path / "cross.toml")
    write_design(standard(), tmp_path / "bare.toml")
    write_model(Model({"membrane": Parameter(1.1, (1.0, 1.2))}), tmp_path / "model.toml")
    (tmp_path / "p.csv").write_text("time_s,channel_0,channel_1\n0,100,0\n0.5,200,50\n")
    cloud = np.random.default_rng(1).integers([-1000, -2000, 0], [1001, 1, 2], (400, 3)) * 1e-4
    cloud[:, 2] = np.where(cloud[:, 2] > 0, 1e-3, -1e-3)  # on one of the faces of the cloth at rest
    trials = [
        NewTrial(
            f"{i:03}", "cross", i, "fit", TrialData(np.array([0.1, 0.2]), np.full((2, 2), 1e5 * i), (cloud, cloud))
        )
        for i in range(3)
    ]
    write_set(tmp_path / "set", {"cross": build("cross")}, trials, name="x")
    return tmp_path


@pytest.mark.parametrize("command", ["", *commands.commands])
def test_help_answers_in_half_a_second(command: str) -> None:
    line = [sys.executable, "-m", "fabdesign", *([command] if command else []), "--help"]
    before = os.times()
    subprocess.run(line, cwd=ROOT, check=True, capture_output=True)
    after = os.times()
    # processor seconds of the one thread: what the wall clock shows where nothing else runs
    assert after.children_user + after.children_system - before.children_user - before.children_system < 0.5


@pytest.mark.parametrize("command", [*commands.commands])
def test_every_command_takes_json(command: str) -> None:
    assert "--json" in [option for parameter in commands.commands[command].params for option in parameter.opts]


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
    assert [line.split(".npz")[0][-3:] for line in err.splitlines()] == ["000", "002"]
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
        assert set(motion) == {"time", "points", "triangles"}
        assert motion["time"].tolist() == [k / 60 for k in range(61)]
        assert (motion["points"].shape, motion["points"].dtype) == ((61, 3362, 3), np.float32)
    assert (hanging.side, hanging.options) == (41, {"self_contact": False})
    options = ("--self-contact", "--grid", 81)
    run("simulate", folder / "bare.toml", "--duration", 0.1, "--frame-rate", 100, *options, "-o", out, "--force")
    assert np.load(out)["time"].tolist() == [k / 100 for k in range(11)]
    assert (hanging.side, hanging.options) == (81, {"self_contact": True})


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
    assert (code, hanging.made) == (0, {41, 61})  # early horizons and differences, the last horizon
    model = ("--model", folder / "fitted.toml")
    simulate = ("simulate", folder / "cross.toml", "--pressures", "1,2", *model, "-o", folder / "fitted.npz")
    for arguments in (
        ("evaluate", folder / "set", *model, "--all"),
        ("predict", folder / "set", *model, "-o", folder / "f"),
        simulate,
    ):
        hanging.side = 0
        assert run(*arguments)[0] == 0
        assert hanging.side == 61
    assert run(*simulate, "--grid", 21, "--force")[0] == 0
    assert hanging.side == 21
    assert run("calibrate", folder / "set", "--grid", 31, "-o", folder / "coarser.toml")[0] == 0
    assert (hanging.side, read_model(folder / "coarser.toml").points_per_side) == (31, 31)
    found = json.loads(out)["parameters"]["membrane"]
    assert found["factor"] == pytest.approx(1.0)
    assert np.log(found["interval90"]) == pytest.approx([-1.645 * 0.15, 1.645 * 0.15], rel=0.01)


@pytest.mark.usefixtures("hanging")
def test_evaluate(run: Run, folder: Path) -> None:
    arguments = ("evaluate", folder / "set", "--model", folder / "model.toml", "--all")
    code, out, err = run(*arguments, "-o", folder / "out", "--json")
    result = json.loads(out)
    assert (code, result["unit"], result["designs"]) == (0, "mm", {})
    assert result["others"]["cross"]["after"]["surface_rms"]["max"] < 1e-3  # mm: the measured points lie on the cloth
    assert len(err.splitlines()) == 3
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


def one_line(result: tuple[int, str, str], problem: str) -> None:
    code, out, err = result
    assert code == 2, err
    assert out == ""
    assert len(err.splitlines()) == 1
    assert problem in err


# what to run in the folder, and what the one line says; OUT is never made
BAD = [
    ("simulate none.toml --pressures 1,2 -o OUT", "none.toml: no such file"),
    ("simulate cross.toml --pressures none.csv -o OUT", "none.csv: no such file"),
    ("simulate cross.toml --pressures none.npz -o OUT", "none.npz: no such file"),
    ("simulate cross.toml -o OUT", "expected --pressures"),
    ("simulate cross.toml --pressures 1 -o OUT", "channel 1 has no pressure"),
    ("simulate cross.toml --pressures 1,2,3 -o OUT", "pressures for 3 channels"),
    ("simulate cross.toml --pressures nan,1 -o OUT", "NaN"),
    ("simulate cross.toml --pressures=-5,1 -o OUT", "-5 kPa"),
    ("simulate cross.toml --pressures 1001,0 -o OUT", "at most 1000 kPa"),
    ("simulate cross.toml --pressures 1,2 --model none.toml -o OUT", "none.toml: no such file"),
    ("simulate cross.toml --pressures 1,2 --model cross.toml -o OUT", 'this version reads "fabdesign.model/1"'),
    ("simulate cross.toml --pressures 1,2 --model effects.toml -o OUT", "effects filling_lag"),
    ("simulate cross.toml --pressures 1,2 --duration -1 -o OUT", "above 0"),
    ("simulate cross.toml --pressures 1,2 --frame-rate 0 -o OUT", "above 0"),
    ("simulate cross.toml --pressures 1,2 --frame-rate fast -o OUT", "valid float"),
    ("simulate cross.toml --pressures 1,2", "Missing option"),
    ("simulate cross.toml --pressures 1,2 --equilibrium --duration 1 -o OUT", "a shape at rest has none"),
    ("simulate cross.toml --pressures 1,2 --mesh OUT.stl -o OUT", ".ply or .obj"),
    ("simulate cross.toml --pressures 1,2 --mesh file/OUT.ply -o OUT", "cannot be written"),
    ("simulate newer.toml --pressures 1,2 -o OUT", "fabdesign.design/7"),
    ("simulate outside.toml --pressures 1,2 -o OUT", "lies outside the cloth"),
    ("simulate cross.toml --pressures 1,2 -o file/OUT", "cannot be written"),
    ("predict set --model none.toml -o OUT", "none.toml: no such file"),
    ("predict none --model model.toml -o OUT", "none: no such file"),
    ("predict set/trials/000.npz --model model.toml -o OUT", "expected --design"),
    ("predict set --model model.toml --design cross.toml -o OUT", "no --design"),
    ("predict cut.npz --model model.toml --design cross.toml -o OUT", "cut short"),
    ("predict set/trials/000.npz --model model.toml --design bare.toml -o OUT", "expected 0 channels"),
    ("predict set --model model.toml -o file/OUT", "cannot be written"),
    ("predict set --model model.toml -o file", "expected a folder"),
    ("check none.toml", "no such file"),
    ("check cut.npz", "cut short"),
    ("check cut.ply", "cut.ply"),
    ("check newer.toml", "fabdesign.design/7"),
    ("check set/trials", "a folder without"),
    ("check picture.png", "is not a text file"),
    ("new basik -o OUT", "did you mean basic"),
    ("new basic --muscles none -o OUT", "valid integer"),
    ("new basic -o set", "is a folder"),
    ("new basic -o file/OUT", "cannot be written"),
    ("export none.toml -o OUT", "no such file"),
    ("export cross.toml -o OUT", "EM20 has no tail_length"),
    ("export cross.toml --tail-length 30 -o OUT", "tail length = 30 m; expected 0 to 1 m"),
    ("export cross.toml --tail-length 0.03 --seam-allowance nan -o OUT", "seam allowance = nan m"),
    ("export cross.toml --tail-length 0.03 --paper a3 -o OUT", "'a4', 'letter', 'none'"),
    ("export cross.toml --tail-length 0.03 -o file", "expected a folder"),
    ("export cross.toml --tail-length 0.03 -o file/OUT", "cannot be written"),
    ("optimize none.toml -o OUT", "none.toml: no such file"),
    ("optimize bare_study.toml -o OUT", "has no muscles"),
    ("optimize empty_study.toml -o OUT", "empty.npz frame 0: the cloud is empty"),
    ("optimize mm_study.toml -o OUT", "in millimetres?"),
    ("optimize ply_study.toml -o OUT", "cut.ply"),
    ("optimize good_study.toml -o file/OUT", "cannot be written"),
    ("rig none.toml --pressures 1,2 -o OUT", "none.toml: no such file"),
    ("rig cross.toml --pressures 1,2 3 -o OUT", "3: channel 1 has no pressure"),
    ("rig cross.toml --pressures 1,2 --key cross.toml -o OUT", 'this version reads "fabdesign.key/1"'),
    ("rig cross.toml --pressures 1,2 -o file/OUT", "cannot be written"),
    ("evaluate none --model model.toml", "none: no such file"),
    ("evaluate set --model none.toml", "none.toml: no such file"),
    ("evaluate set --model effects.toml", "effects filling_lag"),
    ("evaluate set --model model.toml -o OUT", "no trial of role test"),
    ("evaluate set --model model.toml -o file/OUT", "cannot be written"),
    ("calibrate none -o OUT", "none: no such file"),
    ("fuse none -o OUT", "none: no such file"),
    ("fuse set -o OUT", "recording.toml: no such file"),
    ("fuse set --convention up -o OUT", "'forward', 'backward'"),
    ("demo -o file/OUT", "cannot be written"),
    ("exprt cross.toml", "No such command"),
]


@pytest.fixture
def damaged(folder: Path) -> Path:
    """Files that are not sound, beside those that are."""
    design = (folder / "cross.toml").read_text()
    (folder / "newer.toml").write_text(design.replace("design/1", "design/7"))
    (folder / "outside.toml").write_text(design.replace("0.185", "0.385"))
    trial = (folder / "set" / "trials" / "000.npz").read_bytes()
    (folder / "cut.npz").write_bytes(trial[: len(trial) // 2])
    (folder / "file").write_text("in the way")
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n")
    write_model(Model(effects=(EffectTerm("filling_lag"),)), folder / "effects.toml")
    with np.load(folder / "set" / "trials" / "000.npz") as archive:
        arrays = dict(archive)
    np.savez(folder / "mm.npz", **{**arrays, "scale": np.float64(0.1)})
    np.savez(folder / "empty.npz", **{**arrays, "points": np.zeros((0, 3)), "offsets": np.zeros(3, int)})
    header = (
        "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (folder / "cut.ply").write_text(header + "0 0 0\n0 0 0.1\n")
    for name, start, target in (
        ("good", "cross.toml", "set/trials/000.npz"),
        ("bare", "bare.toml", "set/trials/000.npz"),
        ("empty", "cross.toml", "empty.npz"),
        ("mm", "cross.toml", "mm.npz"),
        ("ply", "cross.toml", "cut.ply"),
    ):
        lines = ['kind = "optimize"', f'design = "{start}"', "[target]", f'file = "{target}"']
        (folder / f"{name}_study.toml").write_text("\n".join(lines))
    return folder


@pytest.mark.parametrize(("line", "problem"), BAD)
@pytest.mark.usefixtures("hanging")
def test_bad_input_is_one_line_and_leaves_nothing(
    line: str, problem: str, run: Run, damaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(damaged.rglob("*"))
    monkeypatch.chdir(damaged)
    one_line(run(*line.split()), problem)
    assert sorted(damaged.rglob("*")) == before


def test_installed_program_prints_no_traceback(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "fabdesign", "check", str(tmp_path / "none")]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"fabdesign: {tmp_path / 'none'}: no such file\n"

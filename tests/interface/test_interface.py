"""Python's functions and the commands of their names: the same calls, the same figures; results as tables."""

import __future__

import inspect
import json
import pydoc
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import fabdesign
from fabdesign.cli import commands
from fabdesign.cli.command import add_commands
from fabdesign.errors import InputError, SimulationError
from fabdesign.files.measurement_set import NewTrial, write_set
from fabdesign.files.model_file import write_model
from fabdesign.files.motion_file import Motion, read_motion
from fabdesign.files.pressure_file import constant_program
from fabdesign.interface import files
from fabdesign.interface.verb import VERBS as VERBS_OF_COMMANDS
from fabdesign.interface.verb import Shown
from fabdesign.interface.verb import verb as declare_verb
from fabdesign.nouns.forward import HOLD, RISE, Case
from fabdesign.nouns.model import Covariance, Model, Parameter, Provenance
from fabdesign.study_files.study_file import KINDS
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run
from tests.conftest import ROOT

VERBS = [
    "simulate",
    "equilibrium",
    "sweep",
    "sensitivity",
    "optimize",
    "layouts",
    "unseen",
    "calibrate",
    "train",
    "predict",
    "evaluate",
    "trace",
]


class Cloth(AnalyticCloth):
    """In place of the simulator; it notes how it was made and what it was asked."""

    asked: list[Any] = []  # noqa: RUF012

    def __init__(self, points_per_side: int = 41, **options: object) -> None:
        super().__init__()
        self.made = (points_per_side, sorted(({"rise": RISE, "hold": HOLD, "self_contact": False} | options).items()))

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        self.asked += [(self.made, case, time.tolist()) for case, time in zip(cases, times, strict=True)]
        return super().motions(cases, times)

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        self.asked += [(self.made, case) for case in cases]
        return super().equilibria(cases)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Callable[[], list[str]]:
    """What the stand-in was asked since the last call."""
    monkeypatch.setattr("sim.Simulator", Cloth, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.chdir(folder)
    Cloth.asked = []

    def since() -> list[str]:
        Cloth.asked, calls = [], [repr(one) for one in Cloth.asked]
        return calls

    return since


def test_simulate(run: Run, asked: Callable[[], list[str]]) -> None:
    options = ["--model", "model.toml", "--without", "rig", "--duration", "0.2", "--frame-rate", "30", "--order", "2"]
    assert run("simulate", "cross.toml", "--pressures", "200,50", *options, "-o", "m.npz", "--grid", 21)[0] == 0
    before = asked()
    motion = fabdesign.simulate(
        "cross.toml", [200, 50], model="model.toml", without=["rig"], duration=0.2, frame_rate=30, order=2, grid=21
    )
    written = read_motion(Path("m.npz"))
    assert np.array_equal(motion.points, written.points) and np.array_equal(motion.time, written.time)
    assert asked() == before


def test_equilibrium(run: Run, asked: Callable[[], list[str]]) -> None:
    assert run("simulate", "cross.toml", "--pressures", "p.csv", "--equilibrium", "--rise", 2, "-o", "m.npz")[0] == 0
    before = asked()
    shape = fabdesign.equilibrium("cross.toml", "p.csv", rise=2.0)
    assert asked() == before
    assert np.array_equal(shape.points, read_motion(Path("m.npz")).points)


def test_predict_and_evaluate(run: Run, asked: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.prediction.evaluation_report.write_histogram", lambda _, path: path.touch())  # is slow
    assert run("predict", "set", "--model", "model.toml", "-o", "out")[0] == 0
    before = asked()
    motions = fabdesign.predict(fabdesign.read_set("set"), "model.toml")
    assert asked() == before and [*motions] == ["000", "001", "002"]
    for name, motion in motions.items():
        assert np.array_equal(motion.points, read_motion(Path(f"out/trials/{name}.npz")).points)
    _, out, _ = run("evaluate", "set", "--model", "model.toml", "--all", "--json")
    asked()
    evaluation = fabdesign.evaluate("set", fabdesign.read_model("model.toml"), all_trials=True)
    assert evaluation.to_json() | {"skipped": []} == json.loads(out)
    assert evaluation.to_table()["chamfer_after"].to_numpy() == pytest.approx(
        [1e3 * t.after.chamfer for table in evaluation.others.values() for t in table.trials]
    )


# of each: what is called below, the command, and the same in Python
BELOW = {
    "calibrate": (
        "studies.calibration.calibrate.calibrate_sets",
        "calibrate set --fit 0,2 --free air_drag --fix damping --model model.toml --grid 31 --seed 3 -o m.toml",
        lambda: fabdesign.calibrate(
            "set", "m.toml", fit=[0, 2], free=["air_drag"], fix=["damping"], model="model.toml", grid=31, seed=3
        ),
    ),
    "train": (
        "studies.training.train.train_on",
        "train set --model model.toml --free air_drag --hold-out cross --seed 2 --skip-bad -o m.toml",
        lambda: fabdesign.train(
            ["set"], "m.toml", model="model.toml", free=["air_drag"], hold_out=["cross"], seed=2, skip_bad=True
        ),
    ),
    "trace": (
        "studies.tracing.run.trace_set",
        "trace set --model model.toml --tolerance 0.7 --seed 4 -o traced",
        lambda: fabdesign.trace("set", "traced", model="model.toml", tolerance=0.7e-3, seed=4),
    ),
    "defaults of calibrate": (
        "studies.calibration.calibrate.calibrate_sets",
        "calibrate set -o m.toml",
        lambda: fabdesign.calibrate("set", "m.toml"),
    ),
    "rig": (
        "studies.rig.run_rig",
        "rig cross.toml p.csv --test-trials 1 --key key.toml -o measured",
        lambda: fabdesign.rig(Path("cross.toml"), ["p.csv"], Path("measured"), test_trials=1, key=Path("key.toml")),
    ),
    "fuse": (
        "studies.fusion.fuse.fuse_all",
        "fuse recording --points 500 --convention backward --per-frame --seed 3 -o fused",
        lambda: fabdesign.fuse(
            [Path("recording")], Path("fused"), points=500, convention="backward", per_frame=True, seed=3
        ),
    ),
    "loop": (
        "studies.loop.run.run_loop",
        "loop loop.toml -o looped --seconds 50",
        lambda: fabdesign.loop("loop.toml", Path("looped"), seconds=50.0),
    ),
    "defaults of trace": ("studies.tracing.run.trace_set", "trace set -o t", lambda: fabdesign.trace("set", "t")),
}


@pytest.mark.parametrize("name", BELOW)
def test_the_command_and_the_function_ask_the_same(
    name: str, run: Run, asked: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    below, line, function = BELOW[name]
    Path("loop.toml").write_text('kind = "loop"\n')
    calls: list[dict[str, Any]] = []

    def note(*arguments: Any, **options: Any) -> None:
        calls.append({"arguments": arguments} | options)
        raise InputError("seen")

    monkeypatch.setattr(below, note)
    assert run(*line.split())[2].endswith("fabdesign: seen\n")
    with pytest.raises(InputError, match=r"^seen$"):
        function()
    first, second = ({k: _plain(v) for k, v in call.items() if not callable(v)} for call in calls)
    assert first == second
    assert first


def _plain(value: Any) -> Any:
    """To compare by; folders that are written to have names by chance."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, Cloth):
        return value.made
    return (
        "path"
        if isinstance(value, Path) and value.suffix in (".toml", "") and "fabdesign" in str(value)
        else repr(value)
    )


def test_files_are_written_checked_and_shown_as_by_the_commands(run: Run, asked: Callable[[], list[str]]) -> None:
    assert run("new", "vertical", "--width", "0.3", "--muscles", 4, "-o", "a.toml")[0] == 0
    assert fabdesign.new("vertical", "b.toml", width=0.3, muscles=4) == fabdesign.read_design("a.toml")
    assert Path("a.toml").read_bytes() == Path("b.toml").read_bytes()
    with pytest.raises(InputError, match=r"^b.toml: exists; --force replaces it"):
        fabdesign.new("vertical", "b.toml")
    Path("cut.npz").write_bytes(b"PK")
    code, out, _ = run("check", "a.toml", "cut.npz", "--json")
    findings = fabdesign.check(["a.toml", "cut.npz"])
    assert code == 2
    assert {name: [*of.problems] for name, of in findings.items()} == {
        name: of["problems"] for name, of in json.loads(out)["files"].items()
    }
    made = fabdesign.export("a.toml", "templates", tail_length=0.03, paper="none")
    _, out, _ = run("export", "a.toml", "--tail-length", 0.03, "--paper", "none", "-o", "again", "--json")
    assert [file.name for file in made.files] == [Path(file).name for file in json.loads(out)["files"]]
    fabdesign.simulate("cross.toml", [100, 0], "m.npz", duration=0.05)
    panels = fabdesign.view(["m.npz"], "tip.csv", markers=["tip=0.1,0.2"])
    _, out, _ = run("view", "m.npz", "--marker", "tip=0.1,0.2", "-o", "again.csv", "--json")
    assert panels == json.loads(out)["panels"] and Path("tip.csv").read_bytes() == Path("again.csv").read_bytes()


def test_benches(run: Run, asked: Callable[[], list[str]]) -> None:
    Path("strip").mkdir()
    records = ""
    for k in range(4):
        rows = [f"{1 + 0.004 * i},{520 * 0.05 * 0.004 * i}" for i in range(26)]
        Path(f"strip/r{k}.csv").write_text("\n".join(["stretch,force_n", *rows]) + "\n")
        records += f'[[records]]\nfile = "r{k}.csv"\n' + 'role = "test"\n' * (k == 3)
    head = 'format = "fabdesign.bench/1"\nspecimen = "strip"\nwidth = 0.05\ninput = ["stretch"]\noutput = "force_n"\n'
    Path("strip/bench.toml").write_text(head + records)
    _, out, _ = run("calibrate", "strip", "-o", "a.toml", "--json")
    (fitted,) = fabdesign.calibrate("strip", "b.toml")
    assert fitted.to_json() | {"files": ["a.toml", "a_law.csv"]} == json.loads(out)
    assert fitted.files == ("b.toml", "b_law.csv")
    assert Path("a_law.csv").read_bytes() == Path("b_law.csv").read_bytes()
    assert fitted.to_table()["name"].tolist() == [*fitted.constants]
    _, out, _ = run("evaluate", "strip", "--model", "a.toml", "--json")
    assert fabdesign.evaluate("strip", "b.toml").to_json() == json.loads(out)
    _, out, _ = run("trace", "strip", "-o", "traced", "--tolerance", 3, "--json")
    assert fabdesign.trace("strip", tolerance=0.03).to_json() == json.loads(out)


def test_results_are_listed_shown_and_compared(run: Run, asked: Callable[[], list[str]]) -> None:
    for name in ("a", "b"):
        fabdesign.new("vertical", f"{name}.toml", name=name)
        fabdesign.export(f"{name}.toml", f"out/{name}", tail_length=0.03, paper="none")
    _, out, _ = run("studies", "list", "out", "--json")
    assert [str(one.path) for one in fabdesign.studies.list("out")] == [
        one["folder"] for one in json.loads(out)["results"]
    ]
    assert fabdesign.studies.show("out/a").made_by == "export"
    assert fabdesign.studies.compare(["out/a", "out/b"]) == {}
    with pytest.raises(InputError, match=r"^out/a: one folder; expected two or more to compare"):
        fabdesign.studies.compare(["out/a"])


def test_a_command_has_what_its_function_has() -> None:
    for words, verb in VERBS_OF_COMMANDS.items():
        command: Any = commands
        for word in words.split():
            command = command.commands[word]
        parameters = inspect.signature(verb.function).parameters
        shared = {"force", "effects", "cluster", "unit", "place", "rotation"}
        for parameter in command.params:
            name = parameter.name
            assert name in {*parameters, *shared, "as_json"}, f"{words}: {name}"
            assert name == "as_json" or isinstance(parameter, click.Argument) or parameter.help, f"{words}: {name}"


def test_a_new_verb_takes_one_declaration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also as CONTRIBUTING.md has it."""
    verbs: dict[str, Any] = {}
    monkeypatch.setattr("fabdesign.cli.command.VERBS", verbs)
    monkeypatch.setattr("fabdesign.interface.verb.VERBS", verbs)
    monkeypatch.setattr(commands, "commands", {})

    @declare_verb(lambda area, given: Shown({"area_m2": area}, f"{area:.4f} m^2 at {given['pitch']:g} m"), "DESIGN")
    def area(design: "File", *, pitch: "float" = 0.02, sides: "Sequence[str]" = ()) -> float:  # noqa: F821
        """Say how large the cloth of a DESIGN is.

        pitch: Distance between fixed points, m.
        sides: Faces that count, separated by commas.
        """
        assert [*sides] in ([], ["front", "back"])
        return fabdesign.build("cross").fabric.width ** 2

    recipe = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Add a verb")[1]
    code = recipe.split("```python\n")[1].split("```")[0]
    exec(compile(code, "recipe", "exec", __future__.annotations.compiler_flag), dict(vars(files)))
    fabdesign.new("cross", tmp_path / "d.toml")
    add_commands()
    with pytest.raises(SystemExit):
        commands.commands["cloth"].main([str(tmp_path / "d.toml"), "--seam", "0.01", "--json"])
    assert json.loads(capsys.readouterr().out) == {"area_m2": pytest.approx(0.22**2)}
    with pytest.raises(SystemExit):
        commands.commands["area"].main(["cross.toml", "--pitch", "0.01", "--sides", "front,back"])
    assert capsys.readouterr().out == "0.0400 m^2 at 0.01 m\n"
    with pytest.raises(SystemExit):
        commands.commands["area"].main(["--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert (
        "Usage: " in text and "DESIGN Say how large the cloth of a DESIGN is. Options: --pitch NUMBER Distance" in text
    )


STUDY = """kind = "optimize"
design = "cross.toml"
model = "model.toml"
seed = 3
start_pressures = [120.5, 80]
[target]
file = "target.npz"
[variables]
muscles = { min = 1, max = 2, sides = ["front"] }
[limits]
pressure = [0, 250.5]
evaluations = 300
"""


def test_optimize(run: Run, asked: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    goal = AnalyticCloth().equilibria([Case(fabdesign.build("cross"), constant_program([2e5, 5e4]))])[0]
    points = goal[::4].astype(float)
    np.savez("target.npz", points=points)
    Path("study.toml").write_text(STUDY)
    seen: list[Any] = []

    def note(study: Any, targets: Any, starts: Any, *_: Any, **__: Any) -> None:
        target = targets[0].points.tolist(), targets[0].noise
        content = {f.name: getattr(study, f.name) for f in fields(study) if f.name not in ("name", "targets")}
        seen.append(({k: repr(v) for k, v in content.items()}, target, [x.tolist() for _, x in starts]))
        raise InputError("seen")

    monkeypatch.setattr("studies.layouts.run.searched", note)
    assert run("optimize", "study.toml", "-o", "out", "--seconds", 50)[2].endswith("fabdesign: seen\n")
    with pytest.raises(InputError, match=r"^seen$"):
        fabdesign.optimize(
            "cross.toml", points, model="model.toml", seed=3, muscles=(1, 2), sides=["front"], seconds=50.0,
            limits={"pressure": [0, 250.5]}, evaluations=300, start_pressures=[120.5, 80],
        )  # fmt: skip
    (mine, *others), (its, *its_others) = seen
    assert {name for name in mine if mine[name] != its[name]} == set()
    assert others == its_others
    with pytest.raises(InputError, match=r"target: an array of shape \(4,\); expected points \(n, 3\) in m"):
        fabdesign.optimize("cross.toml", np.zeros(4))


def test_optimize_ends_with_a_design_and_its_table(asked: Callable[[], list[str]]) -> None:
    vertical, shares = fabdesign.build("vertical", muscles=1), [0.0]
    goal = AnalyticCloth().equilibria([Case(vertical, constant_program([2e5]))])[0]
    result = fabdesign.optimize(vertical, goal[::4], evaluations=40, progress=lambda line, share: shares.append(share))
    assert result.pressures == pytest.approx(np.array([[200.0]]), abs=5)
    assert len(result.to_table()) == result.to_json()["evaluations"] and shares[-1] > 0
    assert result.shapes[0].points.shape[0] == 1 and result.objective < 5e-3


OUTPUT = "height of corner (0.2, 0.2)"
UNCERTAIN = Model(
    {"muscle_gain": Parameter(1.0, scope="muscle_types.EM20")},
    covariance=Covariance(("muscle_gain",), np.array([[0.01]])),
)
STUDIES = {
    "layouts": (
        "studies.layout_grid.run.GridSearch",
        '[target]\nfile = "target.npz"\n[grid]\nmuscles = [1, 3]\nsides = ["front"]\n[limits]\nevaluations = 90\n'
        "pressure = [0, 250.5]\n",
        lambda: fabdesign.layouts(
            "cross.toml", "target.npz", model="fitted.toml", seed=3, muscles=[1, 3], sides=["front"], evaluations=90,
            limits={"pressure": [0, 250.5]}, outputs=[OUTPUT],
        ),
    ),
    "unseen": (
        "studies.unseen.run.unsewn_result",
        "pressures = [[200.5, 0]]\nsamples = 9\npoints_per_side = 15\n[rig_limits]\nrate = 400\n"
        '[measured]\nset = "pair"\ntrials = 2\nfree = ["air_drag"]\n',
        lambda: fabdesign.unseen(
            "cross.toml", "fitted.toml", seed=3, pressures=[[200.5, 0]], samples=9, grid=15, rig_limits={"rate": 400},
            measured="pair", trials=2, free=["air_drag"], outputs=[OUTPUT],
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", STUDIES)
def test_studies_are_the_same_from_a_file_and_from_arguments(
    name: str, run: Run, asked: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    below, further, function = STUDIES[name]
    np.savez(
        "target.npz", points=AnalyticCloth().equilibria([Case(fabdesign.build("cross"), constant_program([2e5, 0]))])[0]
    )
    one = fabdesign.read_set("set").trials[0]
    designs = {each: fabdesign.build("cross", name=each) for each in ("one", "two")}
    write_set(Path("pair"), designs, [NewTrial(each, each, 0, "fit", one.load()) for each in designs], name="pair")
    write_model(UNCERTAIN, Path("fitted.toml"))
    head = f'kind = "{name}"\nname = "cross"\ndesign = "cross.toml"\nmodel = "fitted.toml"\nseed = 3\n'
    Path("study.toml").write_text(f'{head}outputs = ["{OUTPUT}"]\n{further}')
    seen: list[Any] = []

    def note(*arguments: Any, **_: Any) -> None:
        seen.append(next(each for each in arguments if hasattr(each, "seed") or hasattr(each, "search")))
        raise InputError("seen")

    monkeypatch.setattr(below, note)
    assert run("study", "study.toml", "-o", "out")[2].endswith("fabdesign: seen\n")
    with pytest.raises(InputError, match=r"^seen$"):
        function()
    its, mine = ([repr(cell) for cell in study.cells] if name == "layouts" else _fields(study) for study in seen)
    assert [text.replace(f"{Path.cwd()}/", "") for text in mine] == its


def _fields(study: Any) -> list[str]:
    """But the set, which is read twice, and its folder, which arguments do not keep."""
    return [repr(getattr(study, f.name)) for f in fields(study) if f.name not in ("name", "folder", "measured")]


def test_layouts_side_by_side_end_as_a_table(asked: Callable[[], list[str]]) -> None:
    vertical = fabdesign.build("vertical", muscles=1)
    goal = AnalyticCloth().equilibria([Case(vertical, constant_program([2e5]))])[0]
    grid_result = fabdesign.layouts(vertical, goal[::4], muscles=[1], sides=["front"], evaluations=30, outputs=[OUTPUT])
    table = grid_result.to_table()
    assert table["name"].tolist() == ["1_EM20_front"] and table["front"].tolist() == [True]
    shape = grid_result.front[0].result.shapes[0]
    assert table[OUTPUT][0] == pytest.approx(1e3 * shape.faces[0, :, -1, -1, 1].mean(), abs=1e-3)


def test_what_is_not_sewn_yet_has_intervals(asked: Callable[[], list[str]]) -> None:
    cross = fabdesign.build("cross", muscles=2)
    table = fabdesign.unseen(cross, UNCERTAIN, pressures=[[200, 0]], outputs=[OUTPUT], samples=8).to_table()
    assert table["output"].tolist() == ["tip_x", "tip_y", "tip_z", "mean_curvature", OUTPUT]
    assert (table["low90"] <= table["middle"]).all() and (table["middle"] <= table["high90"]).all()
    with pytest.raises(InputError, match=r"a design or a model alone; expected both"):
        fabdesign.unseen(cross, measured="set")


SWEEP = """kind = "sensitivity"
design = "cross.toml"
method = "sobol"
samples = 8
[parameters.pressure.0]
low = 50
high = 300
[parameters.position.1.u]
low = -0.01
high = 0.01
"""


def test_sensitivity(run: Run, asked: Callable[[], list[str]]) -> None:
    Path("study.toml").write_text(SWEEP)
    assert run("sensitivity", "study.toml", "-o", "out")[0] == 0
    before = asked()
    parameters = {"pressure.0": (50.0, 300.0), "position.1.u": (-0.01, 0.01)}
    sensitivities = fabdesign.sensitivity("cross.toml", parameters, method="sobol", samples=8)
    assert asked() == before
    written = json.loads(Path("out/result.json").read_text())
    assert sensitivities.to_json()["outputs"] == written["outputs"]
    assert sensitivities.indices("tip_z")["pressure.0"]["total"] > 0.2
    assert set(sensitivities.to_table()["parameter"]) == set(parameters)
    with pytest.raises(InputError, match=r"low = 300, high = 50; expected low < high, from 0 to "):
        fabdesign.sensitivity("cross.toml", {"pressure.0": (300, 50)})


def test_ctrl_c_keeps_what_is_done(asked: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def some(self: Cloth, cases: Sequence[Case]) -> list[np.ndarray]:
        calls.append(len(cases))
        if len(calls) > 2:
            raise KeyboardInterrupt
        return AnalyticCloth().equilibria(cases)

    monkeypatch.setattr(Cloth, "equilibria", some)
    rows = np.linspace(0, 300, 300).reshape(150, 2)
    sweep = fabdesign.sweep("cross.toml", rows, {"forward": lambda motion: motion.points[0, :, 2].mean()})
    assert not sweep.complete and len(sweep) == 128 and calls == [64, 64, 22]
    table = sweep.to_table()
    assert table["channel_1_kpa"].iloc[-1] == rows[127, 1] and table["forward"].iloc[0] == sweep["forward"][0]
    assert json.loads(json.dumps(sweep.to_json())) == {**{k: [*v] for k, v in table.items()}, "complete": False}
    calls.clear()
    with pytest.warns(UserWarning, match="interrupted, with the first 128 of 150 motions"):
        shapes = fabdesign.equilibrium("cross.toml", rows)
    assert len(shapes) == 128 and shapes[1].points.shape == (1, 3362, 3)
    with pytest.raises(KeyboardInterrupt):  # at once: nothing is done yet
        fabdesign.equilibrium("cross.toml", rows)
    calls.clear()
    swept = fabdesign.sensitivity("cross.toml", {"pressure.0": (0, 300)}, method="sobol", samples=64)
    assert not swept.complete and "Interrupted, with " in swept.sentences[0]


def test_ctrl_c_keeps_the_trials_that_are_done(asked: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.prediction.predict.AT_ONCE", 1)
    monkeypatch.setattr("studies.prediction.evaluate.AT_ONCE", 1)
    batches: list[int] = []

    def some(self: Cloth, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        batches.extend([1] * (self.made[0] == 31))  # not those that look for sensitive stretches
        if len(batches) == 3:
            raise KeyboardInterrupt
        return AnalyticCloth().motions(cases, times)

    monkeypatch.setattr(Cloth, "motions", some)
    with pytest.warns(UserWarning, match="interrupted, with the first 2 of 3 trials"):
        assert [*fabdesign.predict("set", "model.toml", grid=31)] == ["000", "001"]
    batches.clear()
    with pytest.warns(UserWarning, match="interrupted, with the first 1 of 3 trials"):  # the second is being compared
        evaluation = fabdesign.evaluate("set", "model.toml", all_trials=True, grid=31)
    assert [trial.trial for table in evaluation.others.values() for trial in table.trials] == ["000"]


def test_a_batch_is_what_each_is_alone(asked: Callable[[], list[str]]) -> None:
    designs = [fabdesign.build("cross", muscles=2), fabdesign.build("vertical", muscles=2)]
    both = fabdesign.equilibrium(designs, [[100, 200], [300, 0]])
    for shape, design, row in zip(both, designs, [[100, 200], [300, 0]], strict=True):
        assert np.array_equal(shape.points, fabdesign.equilibrium(design, row).points)
    assert len(fabdesign.simulate(designs, [100, 200], duration=0.05)) == 2
    assert len(fabdesign.equilibrium(designs[0], np.zeros((3, 2)))) == 3
    with pytest.raises(InputError, match=r"2 designs with 3 pressures; expected as many, or one of either"):
        fabdesign.simulate(designs, np.zeros((3, 2)))
    with pytest.raises(InputError, match=r"cross: has 2 channels; expected --pressures for them"):
        fabdesign.simulate(designs)


def test_a_motion_that_diverges_is_an_error_or_nan(asked: Callable[[], list[str]], monkeypatch: Any) -> None:
    monkeypatch.setattr(Cloth, "equilibria", lambda _, cases: AnalyticCloth(fail_above=250e3).equilibria(cases))
    cross = fabdesign.build("cross", muscles=2)
    sweep = fabdesign.sweep(cross, [[100, 0], [300, 0]], {"x": lambda motion: float(motion.points[0, 0, 0])})
    assert np.isnan(sweep["x"]).tolist() == [False, True]
    with pytest.raises(SimulationError, match=r"^cross: no shape at rest was found"):
        fabdesign.equilibrium(cross, [300, 0])


CROSS = fabdesign.build("cross", muscles=2)


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (
            lambda: fabdesign.simulate(CROSS, ["a", "b"]),
            "pressures of cross: ['a', 'b']; expected kPa of every channel",
        ),
        (lambda: fabdesign.simulate(CROSS, 5), "pressures: 5; expected a list of them"),
        (lambda: fabdesign.simulate(None, [1, 2]), "designs: None; expected a list of them"),
        (lambda: fabdesign.equilibrium([3], [1, 2]), "design: 3; expected a Design or its file"),
        (lambda: fabdesign.equilibrium(CROSS, [1, 2], model=3), "model: 3; expected a Model or its file"),
        (lambda: fabdesign.equilibrium(CROSS, np.zeros((2, 2, 2))), "expected kPa of every channel"),
        (lambda: fabdesign.sweep(CROSS, [[1, 2]], {"a": 3}), "outputs: a: 3; expected a function of a motion"),
        (lambda: fabdesign.optimize(CROSS, np.zeros((3, 3))), "^target: of 3 points 3 without depth"),
        (lambda: fabdesign.optimize(CROSS, [["a", "b", "c"]]), "target: no array of numbers"),
        (lambda: fabdesign.optimize(CROSS, np.ones((9, 3)), muscles=4), "muscles: 4; expected two, the least and the"),
        (lambda: fabdesign.sensitivity(CROSS, {"membrane": 5}), "parameters: membrane: 5; expected two, the least and"),
        (lambda: fabdesign.sensitivity(CROSS, {"membrane": None}, outputs={"a": "tip"}), "outputs: a: 'tip'; expected"),
        (lambda: fabdesign.calibrate([]), "no measurement set; expected one or more"),
        (lambda: fabdesign.train([5], "m.toml"), "measurement set: 5; expected a MeasurementSet or its file"),
    ],
)
def test_arguments_of_another_kind_are_one_line(call: Callable[[], Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem if problem.startswith("^") else re.escape(problem)):
        call()


def test_a_stale_model_is_a_warning(asked: Callable[[], list[str]]) -> None:
    old = replace(Model({"membrane": Parameter(1.1)}), provenance=Provenance(versions={"simulator": "1"}))
    with pytest.warns(UserWarning, match="the model was made by version 1 of the simulator"):
        fabdesign.equilibrium(fabdesign.build("cross", muscles=2), [100, 0], model=old)


def test_tables_files_and_named_axes(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas", reason="the extra tables is not installed")
    points = np.random.default_rng(1).normal(size=(2, 3362, 3)).astype(np.float32)
    motion = Motion(np.array([0.0, 0.1]), points)
    table = motion.to_table()
    assert len(table) == 2 * 3362
    row = table[(table.time == 0.1) & (table.face == "back") & (table.row == 3) & (table.column == 7)]
    assert row[["x", "y", "z"]].to_numpy()[0].tolist() == motion.faces[1, 1, 3, 7].tolist()
    motion.to_parquet(tmp_path / "motion.parquet")
    assert pandas.read_parquet(tmp_path / "motion.parquet").equals(table)
    named = motion.to_array().sel(time=0.1, face="back", axis="z")
    assert named.dims == ("row", "column") and float(named[3, 7]) == motion.faces[1, 1, 3, 7, 2]


def test_what_is_missing_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"^needs pandas; install it with: pip install 'fabdesign\[tables\]'$"):
        Motion(np.zeros(1), np.zeros((1, 3362, 3), np.float32)).to_table()


def test_dir_and_help_list_what_a_user_needs() -> None:
    assert dir(fabdesign) == sorted([*fabdesign.__all__, "__version__"])
    assert {*VERBS} <= {*fabdesign.__all__}
    assert all(getattr(fabdesign, name).__doc__ for name in fabdesign.__all__)
    studies = {"layouts", "unseen"}  # by the command `study`
    assert {verb for verb in VERBS if verb not in ("equilibrium", "sweep")} - studies <= {*commands.commands}
    assert studies <= {*KINDS}
    text = pydoc.plain(pydoc.render_doc(fabdesign))
    assert "sensitivity(" in text and "TYPE_CHECKING" not in text


def test_import_stays_light() -> None:
    loaded = "[m for m in sys.modules if m.startswith('fabdesign.')], 'numpy' in sys.modules"
    script = f"import sys, fabdesign; print({loaded})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == ["[]", "False"]

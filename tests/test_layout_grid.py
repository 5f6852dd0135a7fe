"""A grid of searches for one target, and studies of any kind by one command."""

import json
from pathlib import Path

import numpy as np
import pytest

from fabdesign.catalogue import build
from fabdesign.design_file import write_design
from fabdesign.errors import SimulationError
from fabdesign.forward import Case
from fabdesign.layouts_file import read_layouts
from fabdesign.pressure_file import constant_program
from optimize.evaluations import Evaluations
from studies.layout_grid.run import run_layouts
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line

STUDY = """format = "fabdesign.study/1"
kind = "layouts"
design = "d.toml"
[target]
file = "target.xyz"
[grid]
muscles = [1, 2]
sides = ["front"]
[limits]
evaluations = 250
seconds = 600
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    design = build("vertical")
    write_design(design, tmp_path / "d.toml")
    shape = AnalyticCloth().equilibria([Case(design, constant_program([300e3, 0, 300e3]))])[0]
    np.savetxt(tmp_path / "target.xyz", shape[::8])
    (tmp_path / "s.toml").write_text(STUDY)
    return tmp_path


def test_a_grid_finds_its_front_and_goes_on_where_it_was(folder: Path) -> None:
    class Stop(BaseException):
        pass

    def killed(cell: object, number: int, total: int, evaluations: Evaluations) -> None:
        if number == 2:
            raise Stop

    with pytest.raises(Stop):
        run_layouts(folder / "s.toml", folder / "out", forward=AnalyticCloth(), progress=killed)
    begun: set[int] = set()
    run_layouts(
        folder / "s.toml", folder / "out", forward=AnalyticCloth(), progress=lambda _, number, *__: begun.add(number)
    )
    assert begun == {2}  # what was finished is not searched again
    result = json.loads((folder / "out" / "result.json").read_text())
    cells = {cell["name"]: cell for cell in result["cells"]}
    assert set(cells) == {"1_EM20_front", "2_EM20_front"}
    assert all(cell["evaluations"] <= 125 for cell in cells.values())
    assert result["front"] == ["1_EM20_front", "2_EM20_front"]  # the target was made with two
    front = [cells[name]["objective_mm"] for name in result["front"]]
    assert front == sorted(front, reverse=True)
    page = (folder / "out" / "report.html").read_text()
    assert page.count("<svg") == 1 + len(front)
    assert (folder / "out" / "cells" / "2_EM20_front" / "report.html").is_file()


def test_a_cell_without_room_is_told(folder: Path) -> None:
    text = STUDY.replace("[1, 2]", "[1, 9]")
    (folder / "s.toml").write_text(text.replace("250", "80") + "spacing = 0.04\n")
    result = run_layouts(folder / "s.toml", folder / "out", forward=AnalyticCloth()).as_json()
    assert "no layout of 9 muscles keeps the limits" in result["cells"][1]["why_not"]
    assert result["front"] == ["1_EM20_front"]
    (folder / "s.toml").write_text(text.replace("[1, 9]", "[9]") + "spacing = 0.04\n")
    with pytest.raises(SimulationError, match="no cell has a result"):
        run_layouts(folder / "s.toml", folder / "none", forward=AnalyticCloth())


def test_a_cell_has_one_type_and_its_share(folder: Path) -> None:
    study = read_layouts(folder / "s.toml")
    cells = [*study.cells]
    assert [cell.study.limits.seconds for cell in cells] == [300.0] * 2
    assert {tuple(cell.study.design.muscle_types) for cell in cells} == {("EM20",)}
    assert [cell.study.muscles.counts for cell in cells if cell.study.muscles] == [range(1, 2), range(2, 3)]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("muscles = [1, 2]", "muscles = [0]", "numbers of muscles from 1"),
        ("muscles = [1, 2]", "", "muscles is missing"),
        ('sides = ["front"]', 'sides = ["top"]', '"front", "back", "both"'),
        ("[limits]", 'types = ["EM2"]\n[limits]', "did you mean EM20?"),
        ("[limits]", "[variables]\nmuscles = { max = 2 }\n[limits]", "expected a [grid] alone"),
        ('"layouts"', '"loop"', "expected one source of measurements, [rig] or [laboratory]"),
        ('"layouts"', '"layout"', "did you mean layouts?"),
    ],
)
def test_bad_studies_are_refused_in_a_line(folder: Path, run: Run, old: str, new: str, problem: str) -> None:
    (folder / "s.toml").write_text(STUDY.replace(old, new))
    one_line(run("study", folder / "s.toml", "-o", folder / "out"), problem)
    assert not (folder / "out").exists()


def test_one_command_runs_studies_of_any_kind(folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim.Simulator", lambda *_, **__: AnalyticCloth(), raising=False)
    head = 'format = "fabdesign.study/1"\ndesign = "d.toml"\n'
    target = '[target]\nfile = "target.xyz"\n'
    (folder / "o.toml").write_text(head + 'kind = "optimize"\n' + target + "[limits]\nevaluations = 33\n")
    (folder / "m.toml").write_text(
        head + 'kind = "sensitivity"\nmethod = "morris"\ntrajectories = 4\n[parameters.pressure.0]\nlow = 1\nhigh = 9\n'
    )
    (folder / "s.toml").write_text(STUDY.replace("250", "40").replace("[1, 2]", "[1]"))
    for name, key in (("o", "objective_mm"), ("m", "outputs"), ("s", "front")):
        assert run("check", folder / f"{name}.toml")[0] == 0
        code, out, err = run("study", folder / f"{name}.toml", "-o", folder / name, "--json")
        assert code == 0, err
        assert key in json.loads(out)
        assert (folder / name / "report.html").is_file()

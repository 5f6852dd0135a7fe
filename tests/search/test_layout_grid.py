"""A grid of searches for one target, and studies of any kind by one command."""

import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import SimulationError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.layouts_file import LayoutsStudy
from optimize.search.evaluations import Evaluations
from optimize.search.search_state import as_row, of_row
from studies.layout_grid.run import run_layouts
from studies.layout_grid.turns import CellResult, CellTurns, GridResult, next_turn, seeds_of
from studies.layouts.result import StudyResult
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line

STUDY = """format = "fabdesign.study/1"
kind = "layouts"
design = "d.toml"
outputs = ["height of corner (0.2, 0.2)"]
[target]
file = "target.xyz"
[grid]
muscles = [1, 2]
sides = ["front"]
[limits]
evaluations = 250
seconds = 600
"""


SECONDS = 60.0  # of a clock that stands still but for shapes
CASE = 0.1  # s that a shape takes on it


class Timed(AnalyticCloth):
    """A cloth whose every shape takes CASE s on a clock of its own, so that no test hangs on the machine's."""

    now = 0.0

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        self.now += CASE * len(cases)
        return super().motions(cases, times)

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        self.now += CASE * len(cases)
        return super().equilibria(cases)

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    _write(tmp_path, STUDY)
    return tmp_path


def _write(folder: Path, study: str) -> None:
    design = build("vertical")
    write_design(design, folder / "d.toml")
    shape = AnalyticCloth().equilibria([Case(design, constant_program([300e3, 0, 300e3]))])[0]
    np.savetxt(folder / "target.xyz", shape[::8])
    (folder / "s.toml").write_text(study)


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
    for cell in cells.values():
        height = cell["outputs"]["height of corner (0.2, 0.2)"]
        assert height["unit"] == "mm" and -200 < height["values"][0] < -100  # curled, the corner has come up a little
    page = (folder / "out" / "report.html").read_text()
    assert page.count("height of corner (0.2, 0.2): -") == len(cells)
    assert page.count("<svg") == 1 + len(cells)
    assert page.count("data:image/png") == len(cells)  # each shape beside the target
    assert (folder / "out" / "cells" / "2_EM20_front" / "report.html").is_file()


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> GridResult:
    """One and two muscles, on the front and on both faces."""
    folder = tmp_path_factory.mktemp("timed")
    _write(folder, STUDY.replace('["front"]', '["front", "both"]').replace("250", "100000"))
    cloth = Timed(21)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fabdesign.runtime.working_time.seconds", cloth.monotonic)
        return run_layouts(folder / "s.toml", folder / "out", forward=cloth, seconds=SECONDS)


def test_a_grid_keeps_its_seconds(timed: GridResult) -> None:
    result = timed
    assert len(result.cells) == result.total == 4
    assert 0.5 * SECONDS < result.wall_s < 1.05 * SECONDS
    assert all(f.result and f.result.loading_path is None for f in result.cells if f not in result.front)


def test_more_muscles_and_a_second_face_are_never_worse(timed: GridResult) -> None:
    result = timed
    reached = {f.cell: best.objective for f in result.cells for best in [result.nearest(f.cell)] if best}
    assert [cell.name for cell in reached] == ["1_EM20_front", "1_EM20_both", "2_EM20_front", "2_EM20_both"]
    for one, other in itertools.product(reached, reached):
        assert not one.includes(other) or reached[one] <= reached[other]
    rows = {row["name"]: row for row in result.to_json()["cells"]}
    for f in result.cells:
        assert 1e3 * reached[f.cell] == rows[f.cell.name]["objective_mm"] <= rows[f.cell.name]["searched_mm"]


def test_a_cell_begins_at_its_neighbours_with_idle_muscles(timed: GridResult) -> None:
    result = timed
    one, _, _, both = result.cells
    assert one.result is not None
    seeds = seeds_of(both.cell, result.cells)
    decoded = [space.decode(x) for space, x in seeds]
    assert {len(design.muscles) for design, _ in decoded} == {2}
    assert all(space.feasible(x) for space, x in seeds)
    path = np.array(one.result.design.muscles[0].path)
    grown = [p for d, p in decoded if np.allclose(d.muscles[0].path, path, rtol=0, atol=1e-9) and p[0, 1] == 0]
    assert grown  # with an idle one
    assert all(pressures[0, 0] == pytest.approx(one.result.pressure[0, 0]) for pressures in grown)
    rows = json.loads(json.dumps([as_row(seed) for seed in seeds]))
    again = [of_row(row, both.cell.study.design, seeds[0][0].limits) for row in rows]
    assert [space.design for space, _ in again] == [design for design, _ in decoded]
    assert not seeds_of(one.cell, result.cells)


def test_time_goes_where_it_still_gains(timed: GridResult) -> None:
    result = timed
    going = tuple(replace(f, result=replace(f.result, stop_reason="time used")) for f in result.cells if f.result)
    result = replace(result, cells=going)
    one, _, two, _ = going
    turns = {f.cell.name: CellTurns(seconds=10, turns=1, beneath=0.0) for f in going}
    assert next_turn(result, turns, 5.0) is None
    turns[one.cell.name].gained = 0.1 * one.objective
    assert next_turn(result, turns, 5.0) is one
    turns[two.cell.name].gained = one.objective + two.objective
    assert next_turn(result, turns, 5.0) is two
    ended = replace(two, result=replace(two.result, stop_reason="at the floor: no nearer"))
    assert next_turn(replace(result, cells=(one, ended)), turns, 5.0) is one
    worse = replace(two, result=_at(two, 9.0))  # one muscle has got ahead of two since these began
    turns[two.cell.name].beneath = 8.0
    assert next_turn(replace(result, cells=(one, worse)), turns, 5.0) is worse


def _at(cell_result: CellResult, chamfer: float) -> StudyResult:
    assert cell_result.result is not None
    return replace(cell_result.result, errors=replace(cell_result.result.errors, chamfer=chamfer))


def test_what_did_not_help_is_said(timed: GridResult) -> None:
    result = timed
    front, both = result.cells[2:]
    assert front.result is not None
    worse = replace(both, result=_at(both, 9.0))
    statements = replace(result, cells=(front, worse)).statements(both.cell)
    assert statements[0].startswith("2 muscles on both faces did not help: 2 on the front are nearer, at ")
    assert statements[0].endswith("its own search came to 9000.00 mm.")
    one_face = replace(both, result=replace(front.result, pressure=np.array([[300e3, 0.0]])))
    assert one_face.sides_used == "front"
    statements = replace(result, cells=(one_face,)).statements(both.cell)
    assert statements == ["1 of its 2 muscles is idle.", "Only the front pulls: a second face did not help."]


def test_a_cell_without_room_is_told(folder: Path) -> None:
    text = STUDY.replace("[1, 2]", "[1, 9]")
    (folder / "s.toml").write_text(text.replace("250", "80") + "spacing = 0.04\n")
    result = run_layouts(folder / "s.toml", folder / "out", forward=AnalyticCloth()).to_json()
    assert "no layout of 9 muscles keeps the limits" in result["cells"][1]["why_not"]
    assert result["front"] == ["1_EM20_front"]
    (folder / "s.toml").write_text(text.replace("[1, 9]", "[9]") + "spacing = 0.04\n")
    with pytest.raises(SimulationError, match="no cell has a result"):
        run_layouts(folder / "s.toml", folder / "none", forward=AnalyticCloth())


def test_a_cell_has_one_type_and_its_share(folder: Path) -> None:
    study = LayoutsStudy.read(folder / "s.toml")
    cells = [*study.cells]
    assert [cell.study.limits.seconds for cell in cells] == [300.0] * 2
    assert {tuple(cell.study.design.muscle_types) for cell in cells} == {("EM20",)}
    assert [cell.study.muscles.counts for cell in cells if cell.study.muscles] == [range(1, 2), range(2, 3)]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("muscles = [1, 2]", "muscles = [0]", "numbers of muscles from 1"),
        ("muscles = [1, 2]", "", "muscles is missing; expected numbers of muscles from 1 to 256, such as [1, 2, 4]"),
        ("muscles = [1, 2]", "[variables]\nmuscles = { max = 2 }", "such as [1, 2, 4], and none in [variables]"),
        ('sides = ["front"]', 'sides = ["top"]', '"front", "back", "both"'),
        ("height of corner (0.2, 0.2)", "height of corner (0.3, 0.2)", "expected places on the cloth, 0.2 by 0.2 m"),
        ("height of corner (0.2, 0.2)", "height of corner", 'expected "height of NAME (u, v)"'),
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

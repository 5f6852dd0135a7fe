"""Lines that a person reads: what was probably meant, what is shown of a design, a result and a function."""

import pydoc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fabdesign
from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_record
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.law_tables import read_bench_table
from fabdesign.files.motion_file import Motion
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.catalogue import build, standard
from fabdesign.nouns.model import Model, Parameter
from fabdesign.study_files.study_file import read_head, read_study
from studies.benches.write import origin_of
from studies.check.design import design_findings
from studies.layouts.result import write_best
from studies.measured.used_frames import UsedFrames
from studies.prediction.evaluation_report import SetEvaluation, draw_distribution, tables_markdown
from tests.report_pages import search_result


def test_a_design_without_types_is_asked_for_one(tmp_path: Path) -> None:
    text = (
        'format = "fabdesign.design/1"\nname = "d"\n[fabric]\nwidth = 0.2\nheight = 0.2\nthickness = 0.002\n'
        "areal_density = 0.6\nmembrane_stiffness = 520\nshear_stiffness = 130\npoisson = 0.25\n"
        'bending_stiffness = 0.006\n[[muscles]]\ntype = "OWN"\n'
    )
    (tmp_path / "d.toml").write_text(text)
    with pytest.raises(InputError, match=r"expected \[muscle_types.OWN\] in this file") as caught:
        read_design(tmp_path / "d.toml")
    assert "none" not in str(caught.value)


def test_a_diameter_in_mm_is_called_one() -> None:
    wide = replace(standard().muscle_types["EM20"], outer_diameter=2.8)
    with pytest.raises(InputError, match=r"outer_diameter is in m, and 2\.8 was probably given in mm"):
        build("basic", muscle_type=wide)
    design = replace(build("basic"), muscle_types={"EM20": wide})
    assert "and 2.8 was probably given in mm" in design_findings(design, "d").problems[0]


def test_a_bench_without_source_ends_its_comment() -> None:
    bench = Bench("SLEEVE28B", "muscle", (), "force", {}, (BenchRecord("r", {}, {}),))
    assert origin_of(bench) == "fitted to the bench SLEEVE28B"
    assert origin_of(replace(bench, source="own")) == "fitted to the bench SLEEVE28B: own"


def test_print_and_a_notebook_show_some_lines() -> None:
    design = build("vertical", muscles=3)
    result = search_result(0.24, 0.15)
    motion = Motion(np.arange(3.0), np.zeros((3, 3362, 3), np.float32))
    for shown in (design, result, motion):
        assert 3 <= len(str(shown).splitlines()) <= 12, shown
        assert "<table>" in shown._repr_html_()
    assert str(design).splitlines()[1].split()[:4] == ["muscle", "type", "side", "channel"]
    assert "pressures: channel 0: 320 kPa" in str(result)
    assert "<svg" in design._repr_html_() and "0: 320" in result._repr_html_()
    assert motion._repr_html_().count("<g ") == 3 and len(motion._repr_html_()) < 20_000
    many = str(build("vertical", width=2.0, muscles=40))
    assert "40 rows in all" in many and len(many.splitlines()) <= 12


@pytest.mark.parametrize("name", ["optimize", "layouts", "sensitivity", "calibrate", "trace", "simulate", "unseen"])
def test_help_fits_a_screen(name: str) -> None:
    lines = pydoc.plain(pydoc.render_doc(getattr(fabdesign, name))).splitlines()
    assert sum(1 + len(line) // 120 for line in lines) <= 40
    assert "numpy._typing" not in "".join(lines)


def test_an_evaluation_repeats_what_the_fit_called_not_reliable() -> None:
    model = Model(parameters={"bending": Parameter(1.0, (0.9, 1.1), reliable=False), "shear": Parameter(1.0)})
    evaluation = SetEvaluation({}, UsedFrames(None, 0.0), unreliable=model.unreliable)
    assert "intervals of bending are not reliable" in tables_markdown(evaluation)
    assert evaluation.to_json()["unreliable"] == ["bending"]


def test_errors_of_a_few_trials_are_marks_not_bars_of_height_one() -> None:
    from types import SimpleNamespace as Made

    from matplotlib.figure import Figure

    axes = Figure().subplots()
    trials = [Made(before=Made(chamfer=k * 1e-3), after=Made(chamfer=1e-3)) for k in range(4)]
    draw_distribution(axes, Made(trials=trials), "chamfer")
    assert not axes.patches and axes.lines[0].get_xdata().tolist() == [0.0, 1.0, 2.0, 3.0]


def test_a_heading_without_its_unit_is_told_how_to_write_it(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("Time [s],Pressure,Force [N]\n0,1,2\n1,1,2\n")
    with pytest.raises(InputError, match=r"Pressure has no unit; .*such as Pressure \[kPa\]"):
        read_record(tmp_path / "r.csv", ("pressure_kpa",))
    (tmp_path / "t.csv").write_text("Pressure,contraction,force_n\n0,0,1\n")
    with pytest.raises(InputError, match=r"Pressure has no unit; .*such as Pressure \[kPa\]"):
        read_bench_table(tmp_path / "t.csv")


def test_a_design_where_a_study_is_expected_is_told_what_to_write(tmp_path: Path) -> None:
    write_design(build("basic"), tmp_path / "d.toml")
    for read in (read_head, read_study):
        with pytest.raises(InputError, match=r'd\.toml: a design; expected a study.*design = "d\.toml"') as caught:
            read(tmp_path / "d.toml")
        assert "\n" not in str(caught.value)


def test_pressures_of_a_result_are_written_in_steps_that_a_regulator_resolves(tmp_path: Path) -> None:
    design = build("cross")
    pressures = np.array([[123.4567890123e3, 399.99999999999e3]])
    write_best(tmp_path, design, pressures, {}, [None])
    assert (tmp_path / "pressures.csv").read_text().splitlines()[-1].split(",")[1:] == ["123.4", "400"]

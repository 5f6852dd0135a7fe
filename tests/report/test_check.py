"""`check`: what a workshop cannot make is a problem, what is implausible a warning, and what people have is sound."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fabdesign.clouds.ply import write_ply
from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import LAYOUTS, build, standard
from fabdesign.nouns.muscle import BenchTable, Muscle
from studies.check.design import design_findings
from studies.check.files import inspect
from studies.check.findings import FABRIC, MUSCLE_TYPE, beyond

ONE = build("vertical", muscles=1)
KIND = ONE.muscle_types["EM20"]
HOOK = ((0.02, 0.02), (0.02, 0.1), (0.03, 0.02))  # turns by 173 degrees


def changed(**values: object) -> object:
    return replace(ONE, muscle_types={"EM20": replace(KIND, **values)})


def laid(*paths: tuple[tuple[float, float], ...], side: str = "front", **values: object) -> object:
    muscles = tuple(Muscle("EM20", side, channel, path, 0.02) for channel, path in enumerate(paths))
    return replace(changed(**values), muscles=muscles)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_catalogue_is_sound_and_plausible(layout: str) -> None:
    findings = design_findings(build(layout), "d")
    assert findings.problems == ()
    assert len(findings.warnings) == (layout == "cross")  # whose muscles cross on one face


@pytest.mark.parametrize(
    ("design", "problem"),
    [
        (
            changed(stock_length=0.25, tail_length=0.05),
            "needs 284.0 mm with tails of 50 mm; expected at most stock_length",
        ),
        (changed(bench=BenchTable((0.0, 4e5), (0.0, 0.1), (1.0, 5.0))), "muscle_types.EM20: bench has 2 rows"),
        (changed(stock_length=0.18), "needs 184.0 mm; expected at most stock_length, 180 mm of EM20"),
        (laid(HOOK, min_bend_radius=0.01), "no arc of more than 5.0 mm rounds; expected min_bend_radius, 10 mm"),
        (laid(((0.02, 0.0), (0.02, 0.2)), ((0.0215, 0.0), (0.0215, 0.2))), "lie 1.5 mm apart on the front"),
    ],
)
def test_what_cannot_be_made_is_a_problem(design: object, problem: str) -> None:
    (line,) = design_findings(design, "d").problems
    assert problem in line


@given(length=st.floats(0.05, 0.2), tail=st.floats(0, 0.1), stock=st.floats(0.01, 0.5))
def test_stock_is_what_the_cut_needs(length: float, tail: float, stock: float) -> None:
    design = laid(((0.1, 0.0), (0.1, length)), stock_length=stock, tail_length=tail)
    assert bool(design_findings(design, "d").problems) == (length + 2 * tail > stock + 1e-6)


WARNINGS = [
    (replace(ONE, fabric=replace(ONE.fabric, bending_stiffness=(6.0, 6.0))), "bending_stiffness = 6 N m"),
    (replace(ONE, fabric=replace(ONE.fabric, bending_stiffness=(6.0, 6.0))), "is it in N mm"),
    (replace(ONE, fabric=replace(ONE.fabric, areal_density=600.0)), "areal_density = 600 kg/m^2; cloth: 0.02 to 5"),
    (replace(ONE, fabric=replace(ONE.fabric, areal_density=600.0)), "is it in g/m^2"),
    (replace(ONE, fabric=replace(ONE.fabric, membrane_stiffness=(5.0, 520.0))), "membrane_stiffness = 5 N/m"),
    (replace(ONE, fabric=replace(ONE.fabric, thickness=0.5)), "thickness = 0.5 m on a cloth of 0.2 m"),
    (replace(ONE, fabric=replace(ONE.fabric, gravity=(0.0, 981.0, 0.0))), "gravity = 981 m/s^2"),
    (changed(max_pressure=400.0), r"max_pressure = 0.4 kPa; thin muscles: 30 to 1000 kPa (is it in MPa?)"),
    (changed(max_pressure=9e5), "its bench ends at 400"),
    (changed(axis_offset=1.5), "is it in mm"),
    (changed(axis_offset=0.009), "expected at most half the thickness and the muscle's diameter, 0.003 m"),
    (laid(((0.0, 0.0), (0.0, 0.2)), ((0.004, 0.0), (0.004, 0.2))), "lie 4 mm apart on the front; optimize keeps 6 mm"),
    (laid(((0.0, 0.0), (0.2, 0.2)), ((0.2, 0.0), (0.0, 0.2))), "cross on the front"),
    (replace(ONE, muscles=(replace(ONE.muscles[0], fixed_point_pitch=0.15),)), "fixed_point_pitch = 0.15 m leaves one"),
    (replace(ONE, muscles=(replace(ONE.muscles[0], channel=3),)), "channel 0 has no muscle"),
    (changed(bench=replace(KIND.bench, contraction=tuple(6 * x for x in KIND.bench.contraction))), "that still pulls"),
    (changed(bench=replace(KIND.bench, force=tuple(1e3 * x for x in KIND.bench.force))), "over pressure times"),
    (changed(bench=replace(KIND.bench, force=tuple(-x for x in KIND.bench.force))), "force rises with contraction"),
]


@pytest.mark.parametrize(("design", "warning"), WARNINGS, ids=[warning for _, warning in WARNINGS])
def test_what_is_implausible_is_a_warning(design: object, warning: str) -> None:
    findings = design_findings(design, "d")
    assert findings.problems == ()
    assert any(warning in line for line in findings.warnings), findings.warnings


@pytest.mark.parametrize(("diameter", "message"), [(1.8, "and 1.8 was probably given in mm"), (0.06, "at most 0.05 m")])
def test_a_muscle_wider_than_any_is_one_line(diameter: float, message: str) -> None:
    [line] = design_findings(changed(outer_diameter=diameter), "d").problems
    assert message in line and "muscle_types.EM20: outer_diameter" in line


def test_of_many_pairs_the_first_are_named_and_the_rest_counted() -> None:
    findings = design_findings(build("basic", muscles=100), "d")  # 4 mm apart, each from its neighbours on its face
    assert findings.problems == ()
    assert len(findings.warnings) == 4
    assert findings.warnings[-1] == "d: and so 95 more pairs of muscles on one face"


@given(st.sampled_from([*FABRIC.items(), *MUSCLE_TYPE.items()]), st.floats(-3, 3))
def test_a_range_holds_what_lies_in_it_and_nothing_else(item: tuple[str, object], place: float) -> None:
    name, expected = item
    shown = expected.low + place * (expected.high - expected.low)
    lines = [*beyond(name, shown / expected.shown, expected)]
    inside = expected.low + 1e-9 * abs(expected.low) < shown < expected.high - 1e-9 * abs(expected.high)
    outside = shown < expected.low - 1e-6 or shown > expected.high + 1e-6
    assert not (inside and lines)
    assert len(lines) == 1 or not outside


def test_warnings_leave_exit_0_and_problems_exit_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from click.testing import CliRunner

    from fabdesign.cli.console import commands

    soft = replace(ONE, fabric=replace(ONE.fabric, areal_density=600.0))
    write_design(soft, tmp_path / "soft.toml")
    write_design(changed(stock_length=0.1), tmp_path / "short.toml")
    warned = CliRunner().invoke(commands, ["check", str(tmp_path / "soft.toml"), "--json"])
    assert warned.exit_code == 0
    assert '"sound": true, "problems": [], "warnings": ["' in warned.output
    assert f"warning: {tmp_path / 'soft.toml'}: fabric: areal_density = 600 kg/m^2" in warned.output
    refused = CliRunner().invoke(commands, ["check", str(tmp_path / "short.toml")])
    assert refused.exit_code == 2
    assert len(refused.output.splitlines()) == 1


@pytest.fixture
def kinds(tmp_path: Path) -> Path:
    """One sound file of every kind that stands alone, beside the demo's own."""
    write_design(build("basic"), tmp_path / "basic.toml")
    (tmp_path / "key.toml").write_text('format = "fabdesign.key/1"\nseed = 3\n[parameters]\nbending = 1.1\n')
    (tmp_path / "p.csv").write_text("time_s,channel_0\n0,100\n0.5,200\n")
    (tmp_path / "curve.csv").write_text("strain,tension_n_per_m\n0,0\n0.1,40\n")
    (tmp_path / "record.csv").write_text("time_s,stretch,force_n\n0,1,0\n1,1.2,3\n")
    (tmp_path / "law.toml").write_text(
        'format = "fabdesign.bench-law/1"\n[law]\nspecimen = "actuator"\noutput = "displacement"\ntable = "law.csv"\n'
    )
    (tmp_path / "law.csv").write_text("pressure_kpa,displacement_m\n0,0\n100,0.01\n")
    shutil.copy(tmp_path / "em20_bench.csv", tmp_path / "type_bench.csv")
    (tmp_path / "type.toml").write_text(
        "[muscle_types.A]\nouter_diameter = 0.002\nmass_per_length = 0.004\naxis_offset = 0.001\n"
        'bench = "type_bench.csv"\n'
    )
    (tmp_path / "cloth.toml").write_text('format = "fabdesign.design/1"\n[fabric]\nmembrane_curve = "curve.csv"\n')
    cloud = (np.random.default_rng(0).uniform(0, 0.2, (300, 3)) - [0.1, 0.2, 0.1]) * [1, 1, 0.01]
    write_ply(tmp_path / "cloud.ply", cloud)
    (tmp_path / "cloud.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, p)) for p in cloud))
    (tmp_path / "cloud.xyz").write_text("\n".join(" ".join(map(str, p)) for p in cloud))
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 -0.1 0\nf 1 2 3\n")
    np.savez(tmp_path / "cloud.npz", points=cloud)
    np.savez(tmp_path / "motion.npz", time=[0.0, 0.1], points=np.zeros((2, 18, 3), np.float32))
    (tmp_path / "study.toml").write_text('kind = "optimize"\ndesign = "basic.toml"\n[target]\nfile = "cloud.ply"\n')
    return tmp_path


def test_every_kind_of_file_is_known_and_sound(kinds: Path) -> None:
    files = sorted(kinds.iterdir())
    assert len(files) == 18
    assert {file.name: inspect(file).problems for file in files} == {file.name: () for file in files}


SPOILT = [
    ("key.toml", "bending", "bendin", "unknown parameter bendin"),
    ("p.csv", "0.5", "0", "does not rise"),
    ("p.csv", "channel_0", "valve_0", "columns are time_s,valve_0"),
    ("curve.csv", "40", "-1", "does not rise"),
    ("curve.csv", "strain", "stretching", "expected pressures"),
    ("record.csv", "1.2", "wide", "expected a finite number"),
    ("law.toml", "actuator", "muscle", "expected one of strip, cylinder, actuator"),
    ("law.toml", "law.csv", "none.csv", "no such file"),
    ("law.csv", "0.01", "0", "displacement_m does not rise"),
    ("type.toml", "axis_offset = 0.001", "axis_offset = -0.001", "expected a number from 0"),
    ("type.toml", "axis_offset", "axis_offzet", "is axis_offzet meant"),
    ("type_bench.csv", "400", "4o0", "expected a finite number"),
    ("cloth.toml", "membrane_curve", "membrane_curv", "unknown key membrane_curv"),
    ("cloth.toml", "curve.csv", "none.csv", "no such file"),
    ("basic.toml", "fixed_point_pitch = 0.02", "fixed_point_pitch = 20", "metres (is it in millimetres?)"),
    ("study.toml", "cloud.ply", "cut.ply", "cut.ply"),
    ("study.toml", "[target]", "[variable]", "expected one [target]"),
]


@pytest.mark.parametrize(("name", "old", "new", "problem"), SPOILT)
def test_a_spoilt_file_is_one_line(kinds: Path, name: str, old: str, new: str, problem: str) -> None:
    (kinds / "cut.ply").write_bytes((kinds / "cloud.ply").read_bytes()[:-40])
    text = (kinds / name).read_text()
    assert old in text
    (kinds / name).write_text(text.replace(old, new, 1))
    (line,) = inspect(kinds / name).problems
    assert problem in line
    assert "\n" not in line


def test_a_study_opens_its_targets_and_weighs_its_start(kinds: Path) -> None:
    (kinds / "empty.xyz").write_text("# nothing\n")
    targets = '[[targets]]\nfile = "empty.xyz"\n[[targets]]\nfile = "cloud.ply"\n'
    write_design(build("cross"), kinds / "cross.toml")
    (kinds / "study.toml").write_text(
        f'kind = "optimize"\ndesign = "cross.toml"\n{targets}[variables]\npositions = true\n'
    )
    findings = inspect(kinds / "study.toml")
    assert len(findings.problems) == 1
    assert "empty.xyz" in findings.problems[0]
    assert any("the search starts outside its limits" in line for line in findings.warnings)


def test_a_study_of_more_muscles_than_fit_is_judged_as_its_command_does(kinds: Path) -> None:
    """A search refuses it; a grid goes on without that cell, and does not begin at the design's crossed muscles."""
    write_design(build("cross"), kinds / "cross.toml")
    head = 'design = "cross.toml"\n[target]\nfile = "cloud.ply"\n'
    (kinds / "many.toml").write_text(f'kind = "optimize"\n{head}[variables]\nmuscles = {{ min = 60, max = 60 }}\n')
    (line,) = inspect(kinds / "many.toml").problems
    assert line.endswith("many.toml: no layout of 60 muscles keeps the limits; expected wider ones")
    (kinds / "grid.toml").write_text(f'kind = "layouts"\n{head}[grid]\nmuscles = [2, 60]\nsides = ["front"]\n')
    findings = inspect(kinds / "grid.toml")
    assert not findings.problems
    assert [line for line in findings.warnings if "60_EM20_front: no layout of 60 muscles" in line]
    assert not any("outside its limits" in line for line in findings.warnings)


def test_pressures_that_are_no_kilopascals_or_seconds_are_warned_of(tmp_path: Path) -> None:
    for rows, line in (
        ("0,0.1\n0.5,0.4", "is it in MPa"),
        ("0,1\n0.5,4", "is it in bar"),
        ("0,100\n500,0", "is it in ms"),
    ):
        (tmp_path / "p.csv").write_text(f"time_s,channel_0\n{rows}\n")
        (warning,) = inspect(tmp_path / "p.csv").warnings
        assert line in warning


def test_a_bench_table_in_megapascals_is_refused(tmp_path: Path) -> None:
    write_design(standard(), tmp_path / "d.toml")
    rows = [line.split(",") for line in (tmp_path / "em20_bench.csv").read_text().split()]
    lines = [",".join(rows[0]), *(f"{float(p) / 1e3!r},{e},{f}" for p, e, f in rows[1:])]
    (tmp_path / "em20_bench.csv").write_text("\n".join(lines) + "\n")
    for name in ("em20_bench.csv", "d.toml"):
        (line,) = inspect(tmp_path / name).problems
        assert "largest pressure is 0.4 kPa; expected kPa (is it in MPa?)" in line


@pytest.mark.parametrize(
    ("specimen", "header", "sizes", "problem"),
    [
        ("strip", "time_s,force_n,displacement_m", "", "no column stretch, which a strip needs"),
        ("muscle", "pressure_kpa,contraction,force_n", "outer_diameter = 0.002", "lack mass_per_length, axis_offset"),
        ("actuator", "pressure_kpa,displacement_m", "", "no column time"),
        ("muscle", "pressure_kpa,stroke,load_n", "", "no column contraction"),
    ],
)
def test_a_bench_is_asked_what_calibrate_will_ask(
    specimen: str, header: str, sizes: str, problem: str, tmp_path: Path
) -> None:
    names = header.split(",")
    (tmp_path / "bench.toml").write_text(
        f'format = "fabdesign.bench/1"\nspecimen = "{specimen}"\ninput = ["{names[0]}"]\noutput = "{names[-1]}"\n'
        f'{sizes}\n[[records]]\nfile = "r.csv"\n'
    )
    (tmp_path / "r.csv").write_text(
        f"{header}\n" + "".join(",".join([str(90 + i), "0.5", "1"][: len(names)]) + "\n" for i in range(2))
    )
    assert any(problem in line for line in inspect(tmp_path).problems), inspect(tmp_path).problems


def test_a_key_of_a_bench_that_nothing_reads_is_warned_of(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(
        'format = "fabdesign.bench/1"\nspecimen = "strip"\nspeciment = "cloth"\ninput = ["stretch"]\n'
        'output = "force_n"\ngauge_length = 0.1\n[constants]\nwidht = 0.05\n[[records]]\nfile = "r.csv"\n'
    )
    (tmp_path / "r.csv").write_text("stretch,force_n\n1,0\n1.1,1\n1.2,2\n")
    findings = inspect(tmp_path)
    assert findings.problems == ()
    speciment, widht = findings.warnings
    assert speciment.endswith("speciment is a text that nothing reads (did you mean specimen?)")
    assert widht.endswith("widht is a constant that nothing reads (did you mean width?)")


def test_measured_data_are_sound(data: Path) -> None:
    benches = [file.parent for file in data.glob("bench/**/bench.toml")]
    meshes = [*data.glob("targets/*")]
    for path in (*data.glob("rig_[bcd]"), *data.glob("rig_a/*.toml"), *benches, *meshes):
        if path.name != "set.toml":  # of 124 trials; test_impossible_data reads some
            assert inspect(path).problems == ()

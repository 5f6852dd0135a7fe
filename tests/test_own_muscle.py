"""A user's muscle type in a layout of the catalogue: from what a bench's calibration wrote, or from a table."""

from dataclasses import replace
from pathlib import Path

import pytest

from fabdesign.catalogue import build
from fabdesign.design_file import read_design, write_design
from fabdesign.errors import InputError, InputNote
from fabdesign.model import EffectTerm, Quantity
from fabdesign.own_muscle import read_own_muscle
from studies.benches.calibrate import calibrate_bench, next_step, write_bench_type
from tests.command_line import Run, one_line
from tests.conftest import ROOT

BENCH = ROOT / "examples" / "practice_bench"


def test_a_bench_becomes_a_design_with_its_effects(tmp_path: Path, run: Run) -> None:
    values = {"friction": Quantity(1e-5, "N/kPa"), "friction_at_zero": Quantity(0.1, "N"), "slip": Quantity(1e-3, "1")}
    friction = EffectTerm("braid_hysteresis", values)
    fitted = replace(calibrate_bench(BENCH / "muscle", fit=["000kpa", "200kpa"]), effects=(friction,))
    write_bench_type(fitted, tmp_path / "own.toml")
    assert next_step(fitted, Path("own.toml")).startswith("fabdesign new LAYOUT --muscle-type OWN25 --bench own.toml")
    words = ["--muscle-type", "OWN25", "--bench", str(tmp_path / "own.toml"), "-o", str(tmp_path / "mine.toml")]
    assert run("new", "basic", *words)[0] == 0
    design = read_design(tmp_path / "mine.toml")
    (kind,) = design.muscle_types.values()
    assert (kind.name, kind.outer_diameter, kind.axis_offset) == ("OWN25", 0.0025, 0.0015)
    assert kind.max_pressure == max(kind.bench.pressure)
    assert [effect.name for effect in design.effects] == ["braid_hysteresis"]
    with pytest.raises(InputError, match="has no muscle type OWN; it has OWN25"):
        read_own_muscle(tmp_path / "own.toml", "OWN")


def test_a_table_takes_the_sizes_of_the_standard_muscle_and_says_so(tmp_path: Path) -> None:
    write_design(build("basic"), tmp_path / "basic.toml")
    with pytest.warns(InputNote, match="are those of EM20"):
        kind, effects = read_own_muscle(next(tmp_path.glob("*bench.csv")), "MINE")
    assert kind.name == "MINE" and kind.outer_diameter == 0.002 and effects == ()
    with pytest.raises(InputError, match="a folder; expected the file that `fabdesign calibrate"):
        read_own_muscle(BENCH, "MINE")


def test_a_name_without_a_bench_is_refused(tmp_path: Path, run: Run) -> None:
    result = run("new", "basic", "--muscle-type", "MINE", "-o", str(tmp_path / "d.toml"))
    one_line(result, "expected both")
    assert not (tmp_path / "d.toml").exists()

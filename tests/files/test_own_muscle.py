"""A user's muscle type in a layout of the catalogue: from what a bench's calibration wrote, or from a table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError, InputNote
from fabdesign.files.design_file import read_design, read_part, write_design
from fabdesign.nouns.catalogue import build, read_muscle_type
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.runtime.effort import bench_fit_seconds
from studies.benches.calibrate import calibrate_bench, next_step
from studies.benches.write import write_bench_type
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
        read_muscle_type(tmp_path / "own.toml", "OWN")


def test_a_table_takes_the_sizes_of_the_standard_muscle_and_says_so(tmp_path: Path) -> None:
    write_design(build("basic"), tmp_path / "basic.toml")
    with pytest.warns(InputNote, match="are those of EM20"):
        kind, effects = read_muscle_type(next(tmp_path.glob("*bench.csv")), "MINE")
    assert kind.name == "MINE" and kind.outer_diameter == 0.002 and effects == ()
    with pytest.raises(InputError, match="a folder; expected the file that `fabdesign calibrate"):
        read_muscle_type(BENCH, "MINE")


def test_a_name_without_a_bench_is_refused(tmp_path: Path, run: Run) -> None:
    result = run("new", "basic", "--muscle-type", "MINE", "-o", str(tmp_path / "d.toml"))
    one_line(result, "expected both")
    assert not (tmp_path / "d.toml").exists()


def test_strips_cut_across_and_down_become_one_cloth(tmp_path: Path, run: Run) -> None:
    folders = [str(BENCH / name) for name in ("cloth_down", "cloth_across")]
    assert run("calibrate", *folders, "-o", str(tmp_path / "cloth.toml"))[0] == 0
    assert run("new", "basic", "-o", str(tmp_path / "d.toml"))[0] == 0
    text = (tmp_path / "d.toml").read_text(encoding="utf-8")
    (tmp_path / "d.toml").write_text(text.replace("\nname = ", '\ninclude = ["cloth.toml"]\nname = ', 1))
    curve = read_design(tmp_path / "d.toml").fabric.membrane_curve
    assert curve is not None
    across, down = (np.interp(0.1, s, t) for s, t in zip(curve.strain, curve.tension, strict=True))
    assert across / down == pytest.approx(1.6, rel=0.05)  # as the practice bench was made
    assert run("evaluate", folders[0], "--all", "--model", str(tmp_path / "cloth.toml"))[0] == 0
    twice = run("calibrate", folders[0], folders[0], "-o", str(tmp_path / "no.toml"))
    one_line(twice, "expected one strip across")
    mixed = run("calibrate", folders[0], str(BENCH / "muscle"), "-o", str(tmp_path / "no.toml"))
    one_line(mixed, "the specimen is a muscle; expected strips of one cloth")
    assert not (tmp_path / "no.toml").exists()


def test_a_second_calibration_leaves_a_design_as_it_is(tmp_path: Path, run: Run) -> None:
    bench_type, mine = tmp_path / "own25.toml", tmp_path / "mine.toml"
    assert run("calibrate", str(BENCH / "muscle"), "-o", str(bench_type))[0] == 0
    assert run("new", "basic", "--muscle-type", "OWN25", "--bench", str(bench_type), "-o", str(mine))[0] == 0
    before = read_design(mine)
    assert run("calibrate", str(BENCH / "muscle"), "--fit", "000kpa,300kpa", "-o", str(bench_type), "--force")[0] == 0
    assert read_part(bench_type).types["OWN25"].bench != before.muscle_types["OWN25"].bench
    assert read_design(mine) == before


def test_a_bench_shows_an_estimate_and_its_steps_with_their_share() -> None:
    shown: list[tuple[str, float | None]] = []
    calibrate_bench(
        BENCH / "muscle", free=["braid_hysteresis"], progress=lambda line, share: shown.append((line, share))
    )
    (estimate, none), *steps = shown
    assert estimate.startswith("4 records, 480 rows, 3 unknowns of effects: about ") and none is None
    shares = [share for _, share in steps if share is not None]
    assert shares == sorted(shares) and shares[0] == 0 and 0.8 <= shares[-1] < 1
    assert steps[-1][0] == "fitting OWN25, record 4 of 4 left out"
    assert bench_fit_seconds(12, 48000, 3) == pytest.approx(97, rel=0.4)  # CPU s measured
    assert bench_fit_seconds(8, 16000, 5) == pytest.approx(60, rel=0.4)
    assert bench_fit_seconds(12, 48000, 0) == pytest.approx(3.6, rel=0.5)

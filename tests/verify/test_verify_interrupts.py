"""Ctrl-C in four commands, after four delays, five times each; and commands without a home, in full."""

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from tests.house.test_guests import homeless
from tests.interrupted import ROOT, interrupted, snapshot

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
WITHIN = 2.0  # s
SET = ROOT / "fabdesign" / "data" / "demo_set"
MODEL = ROOT / "fabdesign" / "data" / "demo_model.toml"
STUDY = """
kind = "optimize"
design = "d.toml"
[target]
[[target.wishes]]
edge = "bottom"
forward = 0.03
[limits]
seconds = 600
"""
SENSITIVITY = """
kind = "sensitivity"
design = "d.toml"
outputs = ["tip"]
[parameters.pressure.0]
low = 100
high = 300
"""
COMMANDS = {
    "simulate": "simulate in/d.toml --pressures 300,300,0,0,0,0,0,0 --duration 600 --frame-rate 1 -o new/m.npz",
    "optimize": "optimize in/study.toml -o out",
    "sensitivity": "sensitivity in/sensitivity.toml -o out",
    "evaluate": f"evaluate {SET} --model {MODEL} --all -o out",
}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    write_design(build("basic"), tmp_path / "in" / "d.toml")
    (tmp_path / "in" / "study.toml").write_text(STUDY)
    (tmp_path / "in" / "sensitivity.toml").write_text(SENSITIVITY)
    return tmp_path


@pytest.mark.parametrize("after", [0.05, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("command", COMMANDS)
def test_ctrl_c(command: str, after: float, place: Path, request: pytest.FixtureRequest) -> None:
    cache = {"FABDESIGN_CACHE": str(place / "cache")}  # what a fit keeps there is no output
    os.environ.update(cache)
    request.addfinalizer(lambda: os.environ.pop("FABDESIGN_CACHE"))
    before = snapshot(place)
    slowest = 0.0
    for time in range(5):
        ended = interrupted(COMMANDS[command].split(), place, after=after, group=time % 2 == 0)
        ended.require_interrupted(WITHIN)
        slowest = max(slowest, ended.seconds)
        shutil.rmtree(place / "cache", ignore_errors=True)
        after_it = snapshot(place)
        assert not [name for name in after_it if ".unfinished" in name]
        if command in ("simulate", "evaluate"):
            assert after_it == before
        else:
            assert ("out keeps what was done" in ended.err) == ("out" in after_it)
    print(f"{command} after {after} s: 130 within {slowest:.2f} s")


def test_an_interrupted_search_goes_on_and_ends_as_one_that_was_not(place: Path) -> None:
    text = STUDY.replace("seconds = 600", "seconds = 600\nevaluations = 150")
    (place / "in" / "study.toml").write_text(text)
    for after in (8.0, 12.0):
        interrupted(COMMANDS["optimize"].split(), place, after=after).require_interrupted(WITHIN)
    for folder in ("out", "straight"):
        done = run_to_the_end(["optimize", "in/study.toml", "-o", folder], place)
        assert done == 0
    assert (place / "out" / "pressures.csv").read_bytes() == (place / "straight" / "pressures.csv").read_bytes()


def run_to_the_end(line: list[str], place: Path) -> int:
    from tests.interrupted import start

    process = start(line, place)
    process.communicate(timeout=1200)
    return process.returncode


def test_commands_without_a_home(tmp_path: Path) -> None:
    def run(*line: str) -> "tuple[int, list[str]]":
        done = homeless(tmp_path, ["-m", "fabdesign", *line])
        return done.returncode, [line for line in done.stderr.splitlines() if "cannot be written" in line]

    assert run("new", "vertical", "-o", "d.toml")[0] == 0
    simulate = ["simulate", "d.toml", "--pressures", "90,90,90", "--grid", "15", "--duration", "0.1", "-o", "m.npz"]
    instead = tmp_path / f"fabdesign-cache-{os.getuid()}"
    note = f"note: /proc/.cache: cannot be written; {instead} takes its place (XDG_CACHE_HOME sets another)"
    for line in (
        simulate,
        ["view", "m.npz", "-o", "x.png"],
        ["evaluate", str(SET), "--model", str(MODEL), "--all", "--grid", "21", "-o", "evaluated"],
    ):
        assert run(*line) == (0, [note])
    with np.load(tmp_path / "m.npz") as motion:
        assert np.isfinite(motion["points"]).all()

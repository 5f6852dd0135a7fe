"""The tutorial and the page on own muscles and cloth run as they are printed, and print what they show."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from fabdesign.files.design_file import read_design
from tests.conftest import ROOT

# a step more or less is another machine's rounding, as are its seconds; muscles that work against each other leave
# pressures open
CHANCE = re.compile(r"\d+ (?=iterations|kPa|of at most)|about \d+ (s|min) at its pace")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")


class Step(NamedTuple):
    commands: str
    shown: str  # on standard output
    within: float  # of a number, besides 5 % of it


def steps(page: str) -> list[Step]:
    """The ```sh blocks with the ```text that follows; a comment `within N` between them widens the tolerance."""
    block = r"```sh\n(.*?)```\n(?:\n(?:<!-- within ([\d.]+) -->\n)?```text\n(.*?)```\n)?"
    return [Step(match[1], match[3] or "", float(match[2] or 0.06)) for match in re.finditer(block, page, re.DOTALL)]


def differences(shown: str, printed: str, within: float) -> list[str]:
    """Lines that differ in more than the size of their numbers."""
    pairs = list(zip(shown.splitlines(), printed.splitlines(), strict=False))
    bad = [f"{a!r} is {b!r}" for a, b in pairs if not _alike(a, b, within)]
    if len(shown.splitlines()) != len(printed.splitlines()):
        bad.append(f"{len(shown.splitlines())} lines are {len(printed.splitlines())}:\n{printed}")
    return bad


def _alike(shown: str, printed: str, within: float) -> bool:
    shown, printed = CHANCE.sub("", shown), CHANCE.sub("", printed)
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    pairs = zip(NUMBER.finditer(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a[0]) - float(b)) <= _tolerance(shown, a, within) for a, b in pairs)


def _tolerance(shown: str, number: re.Match[str], within: float) -> float:
    """A per cent is rounded to a whole one, which another machine's last bit may turn."""
    rounded_percent = "." not in number[0] and shown[number.end() :].startswith(" %")
    return max(within + 0.05 * abs(float(number[0])), 1.0 if rounded_percent else 0.0)


def test_comparison_sees_what_differs() -> None:
    assert differences("a 1.00\nb 2\n", "a 1.05\nb 2\n", 0.06) == []
    assert differences("a 1.00\n", "a 1.50\n", 0.06)
    assert differences("a 1.00\n", "c 1.00\n", 0.06)
    assert differences("a 1.00\n", "a 1.00\nb\n", 0.06)
    assert differences("a +8 %\n", "a +9 %\n", 0.06) == []
    assert differences("a +8 %\n", "a +10 %\n", 0.06)
    assert differences("a 8\n", "a 9\n", 0.06)


def run_page(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the page's commands one after another, beside the examples, and compare what they print."""
    (folder / "examples").symlink_to(ROOT / "examples")
    program = folder / "bin" / "fabdesign"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m fabdesign "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("FABDESIGN_LANES", raising=False)
    page_steps = steps((ROOT / "docs" / page).read_text(encoding="utf-8"))
    assert len(page_steps) >= 8
    place = folder
    for step in page_steps:
        script = f"set -eu\n{step.commands}\npwd > '{folder}/place'\n"
        ran = subprocess.run(["bash", "-c", script], cwd=place, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
        assert not step.shown or differences(step.shown, ran.stdout, step.within) == [], step.commands
        place = Path((folder / "place").read_text().strip())


def test_tutorial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ezdxf")
    run_page("tutorial.md", tmp_path, monkeypatch)
    assert (tmp_path / "tutorial" / "result" / "report.html").is_file()
    assert (tmp_path / "tutorial" / "templates" / "design_a4.pdf").is_file()


def test_own_muscle_and_cloth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_page("own_muscle_and_cloth.md", tmp_path, monkeypatch)
    design = read_design(tmp_path / "own" / "mine.toml")
    assert [*design.muscle_types] == ["OWN25"] and design.muscle_types["OWN25"].outer_diameter == 0.0025
    assert design.fabric.membrane_curve is not None
    assert (tmp_path / "own" / "own25_trace" / "report.html").is_file()

"""What a fresh attack on the program has found: each gesture with what is right."""

import json
import os
import time
from pathlib import Path

import pytest

from fabdesign.errors import InputError
from fabdesign.output import new_file, read_mark, sweep
from studies.report.page import _in_script
from tests.command_line import Run, one_line


def test_nothing_of_others_is_swept(tmp_path: Path) -> None:
    """Names that look like unfinished output, and links that look like its folders."""
    notes, chapters, victim = tmp_path / ".unfinished-notes.txt", tmp_path / ".unfinished-work", tmp_path / "victim"
    notes.write_text("mine")
    hour_ago = time.time() - 7200
    os.utime(notes, (hour_ago, hour_ago))
    for folder in (chapters, victim):
        folder.mkdir()
        (folder / "lock").write_text("")
        (folder / "text").write_text("mine")
    (tmp_path / ".unfinished-link").symlink_to(victim)
    lone = tmp_path / f".unfinished-{'0' * 32}.npz"
    lone.write_text("ours")
    os.utime(lone, (hour_ago, hour_ago))
    sweep(tmp_path)
    assert notes.read_text() == "mine" and not lone.exists()
    assert [(folder / "text").read_text() for folder in (chapters, victim)] == ["mine", "mine"]


def test_no_output_is_written_through_a_link_of_another(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "text").write_text("mine")
    (tmp_path / ".unfinished-d.toml").symlink_to(victim)
    with pytest.raises(InputError, match="is a link"), new_file(tmp_path / "d.toml"):
        pass
    assert [path.name for path in victim.iterdir()] == ["text"]


@pytest.mark.parametrize("name", ["", ".", "loop", "loop/x"])
def test_an_output_that_is_no_name_is_refused(
    name: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    one_line(run("new", "basic", "-o", name), "expected")
    assert [path.name for path in tmp_path.iterdir()] == ["loop"]


def test_an_empty_name_is_not_this_folder(run: Run) -> None:
    one_line(run("check", ""), "an empty name")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("p.csv", "time_s,channel_0\n0,sNaN\n"),
        ("p.csv", "time_s,channel_0\nsNaN,1\n"),
        ("count.pts", "9" * 5000 + "\n0 0 0\n"),
        ("count.ply", "ply\nformat ascii 1.0\nelement vertex " + "9" * 6000 + "\nproperty float x\nend_header\n"),
    ],
)
def test_numbers_that_are_none_are_one_line(name: str, text: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    one_line(run("check", tmp_path / name), "expected")


def test_deep_json_is_no_mark(tmp_path: Path) -> None:
    (tmp_path / ".fabdesign").write_text("[" * 100_000)
    assert read_mark(tmp_path) is None


def test_no_name_ends_a_script() -> None:
    text = _in_script({"name": "<!--<script></script>"})
    assert "<" not in text and json.loads(text) == {"name": "<!--<script></script>"}

"""Output is whole or not there, whatever interrupts it."""

from pathlib import Path

import pytest

from fabdesign.errors import InputError
from fabdesign.output import new_file, new_folder


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_interrupted_file_leaves_what_was_there(stop: type[BaseException], tmp_path: Path) -> None:
    old = tmp_path / "old.txt"
    old.write_text("old")
    for path in (old, tmp_path / "a" / "b" / "new.txt"):
        with pytest.raises(stop), new_file(path) as unfinished:
            unfinished.write_text("half")
            raise stop
    assert old.read_text() == "old"
    assert list(tmp_path.iterdir()) == [old]


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_interrupted_folder_leaves_what_was_there(stop: type[BaseException], tmp_path: Path) -> None:
    old = tmp_path / "old"
    old.mkdir()
    (old / "x").write_text("old")
    for path in (old, tmp_path / "a" / "b"):
        with pytest.raises(stop), new_folder(path) as unfinished:
            (unfinished / "x").write_text("half")
            raise stop
    assert (old / "x").read_text() == "old"
    assert sorted(tmp_path.rglob("*")) == [old, old / "x"]


def test_folder_keeps_other_files(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("old")
    (tmp_path / "y").write_text("old")
    with new_folder(tmp_path) as unfinished:
        (unfinished / "deep").mkdir()
        (unfinished / "deep" / "z").write_text("new")
        (unfinished / "x").write_text("new")
    assert {p.name: p.read_text() for p in tmp_path.rglob("*") if p.is_file()} == {"x": "new", "y": "old", "z": "new"}


def test_file_and_folder_in_each_others_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a folder"), new_file(tmp_path):
        pass
    with pytest.raises(InputError, match="is a file"), new_folder(tmp_path / "file"):
        pass

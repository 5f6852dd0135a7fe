"""Output is whole or not there, whatever interrupts it, and takes nothing's place unasked."""

import json
import os
from pathlib import Path

import pytest

from fabdesign.errors import InputError
from fabdesign.output import MARK, new_file, new_files, new_folder, read_mark, work_folder, write_text


def content(folder: Path) -> dict[str, str]:
    """Every file but marks: relative path to text."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != MARK)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def fill(folder: Path, *, force: bool = False, **files: str) -> None:
    with new_folder(folder, made_by="test", force=force) as unfinished:
        for name, text in files.items():
            write_text(unfinished / name.replace("__", "/"), text)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_interrupted_file_leaves_what_was_there(stop: type[BaseException], tmp_path: Path) -> None:
    old = tmp_path / "old.txt"
    old.write_text("old")
    for path in (old, tmp_path / "a" / "b" / "new.txt"):
        with pytest.raises(stop), new_file(path, force=True) as unfinished:
            unfinished.write_text("half")
            raise stop
    assert old.read_text() == "old"
    assert list(tmp_path.iterdir()) == [old]


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_interrupted_folder_leaves_what_was_there(stop: type[BaseException], tmp_path: Path) -> None:
    fill(tmp_path / "old", x="old")
    for path in (tmp_path / "old", tmp_path / "a" / "b"):
        with pytest.raises(stop), new_folder(path, made_by="test", force=True) as unfinished:
            (unfinished / "x").write_text("half")
            raise stop
    assert content(tmp_path) == {"old/x": "old"}
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "old", tmp_path / "old" / MARK, tmp_path / "old" / "x"]


def test_file_is_replaced_when_asked_and_stays_until_then(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(InputError, match=r"x.txt: exists; --force replaces it$"), new_file(path):
        raise AssertionError("computed all the same")
    with new_file(path, force=True) as unfinished:
        unfinished.write_text("new")
        assert (unfinished.name, path.read_text()) == ("x.txt", "old")
    assert content(tmp_path) == {"x.txt": "new"}


def test_folder_is_replaced_when_asked_and_stays_until_then(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    fill(folder, x="old", deep__y="old", same="old")
    with pytest.raises(InputError, match=r"out: exists, made by fabdesign test; --force replaces it$"):
        fill(folder, x="new")
    with new_folder(folder, made_by="other", force=True) as unfinished:
        (unfinished / "same").write_text("new")
        (unfinished / "z").mkdir()
        (unfinished / "z" / "z").write_text("new")
        assert {path.name for path in folder.iterdir()} >= {"x", "deep", "same"}
        assert (folder / "same").read_text() == "old"
    assert content(folder) == {"same": "new", "z/z": "new"}
    assert not (folder / "deep").exists()
    mark = read_mark(folder)
    assert mark is not None
    assert (mark.made_by, mark.files) == ("other", {"same", "z/z"})


def test_empty_folder_serves_and_stays_the_one_that_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # as in `-o .`
    before = tmp_path.stat().st_ino
    fill(Path(), x="new")
    fill(Path(), x="newer", force=True)
    assert (content(tmp_path), tmp_path.stat().st_ino) == ({"x": "newer"}, before)


@pytest.mark.parametrize("added", ["notes.txt", "deep/notes.txt", ".hidden", "link"])
def test_folder_with_other_files_is_never_replaced(added: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    fill(folder, x="old", deep__y="old")
    if added == "link":
        (folder / added).symlink_to(tmp_path)
    else:
        (folder / added).write_text("mine")
    for force in (False, True):
        with pytest.raises(InputError, match=f"holds {added}, which fabdesign did not make there"):
            fill(folder, x="new", force=force)
    assert (folder / added).exists()
    assert (folder / "x").read_text() == "old"


@pytest.mark.parametrize("mark", ["", "[]", '{"format": "fabdesign.output/9", "made_by": "rig", "files": ["x"]}'])
def test_folder_whose_mark_cannot_be_read_is_somebody_elses(mark: str, tmp_path: Path) -> None:
    fill(tmp_path / "out", x="old")
    (tmp_path / "out" / MARK).write_text(mark)
    with pytest.raises(InputError, match="which fabdesign did not make"):
        fill(tmp_path / "out", x="new", force=True)
    assert content(tmp_path / "out") == {"x": "old"}


def test_a_mark_does_not_reach_out_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    fill(tmp_path / "out", x="old")
    text = json.loads((tmp_path / "out" / MARK).read_text())
    (tmp_path / "out" / MARK).write_text(json.dumps(text | {"files": ["x", "../mine"]}))
    fill(tmp_path / "out", x="new", force=True)
    assert content(tmp_path) == {"mine": "mine", "out/x": "new"}


def test_a_folder_in_it_may_be_of_our_making_too(tmp_path: Path) -> None:
    fill(tmp_path / "out" / "inner", x="inner")
    with pytest.raises(InputError, match=r"out: exists; --force replaces it$"):
        fill(tmp_path / "out", y="new")
    fill(tmp_path / "out", y="new", force=True)
    assert content(tmp_path) == {"out/y": "new"}


def test_without_locks_output_is_written_and_nothing_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fabdesign.output.atomic.try_lock", lambda stream: None)
    with new_file(tmp_path / "x.txt") as first:
        first.write_text("first")
        with new_file(tmp_path / "y.txt") as second:
            second.write_text("second")
    assert content(tmp_path) == {"x.txt": "first", "y.txt": "second"}


def test_file_and_folder_in_each_others_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a folder"), new_file(tmp_path, force=True):
        pass
    with pytest.raises(InputError, match="is a file"):
        fill(tmp_path / "file", force=True)
    with pytest.raises(InputError, match="is not a regular file"), new_file(os.devnull, force=True):
        pass


def test_companions_are_refused_all_or_none_and_kept_where_they_are_the_same(tmp_path: Path) -> None:
    def write(*, force: bool = False) -> None:
        with new_files(tmp_path / "a.toml", force=force) as unfinished:
            unfinished.write_text("new")
            unfinished.with_name("bench.csv").write_text("bench")

    (tmp_path / "bench.csv").write_text("another's")
    with pytest.raises(InputError, match=r"bench.csv: exists; --force"):
        write()
    assert content(tmp_path) == {"bench.csv": "another's"}
    (tmp_path / "bench.csv").write_text("bench")
    write()
    (tmp_path / "bench.csv").write_text("another's")
    write(force=True)
    assert content(tmp_path) == {"a.toml": "new", "bench.csv": "bench"}
    known = new_files(tmp_path / "b.toml", companions=["bench.csv"])
    with pytest.raises(InputError, match=r"bench.csv: exists; --force"), known:
        raise AssertionError("computed all the same")


def test_an_input_is_never_an_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By another name, through links, as a file that an input names, within one, and around one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "bench.csv").write_text("bench")
    (tmp_path / "d.toml").write_text('name = "out"\nbench = "deep/bench.csv"')
    (tmp_path / "link").symlink_to("d.toml")
    os.link(tmp_path / "d.toml", tmp_path / "hard")
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "set.toml").write_text('a = { file = "../far.npz" }')
    (tmp_path / "far.npz").write_text("trial")
    before = content(tmp_path)
    for name in ("d.toml", "deep/../d.toml", "link", "hard", "deep/bench.csv", "set/set.toml", "far.npz"):
        with pytest.raises(InputError, match="input"), new_file(name, force=True, inputs=["d.toml", "set", "1,2" * 99]):
            pass
    (tmp_path / "set" / "old.toml").write_text("")
    within = new_file("set/old.toml", force=True, inputs=["set"])
    with pytest.raises(InputError, match="part of the input set"), within:
        pass
    (tmp_path / "set" / "old.toml").unlink()
    fill(tmp_path / "own", x="")
    (tmp_path / "own" / "x.toml").write_text("")
    for name, inputs in ((".", ["d.toml"]), ("deep", ["d.toml"]), ("set", ["set"]), ("own", ["own/x.toml"])):
        around = new_folder(name, made_by="test", force=True, inputs=inputs)
        with pytest.raises(InputError, match="input"), around:
            pass
    assert {name: text for name, text in content(tmp_path).items() if not name.startswith("own")} == before
    with new_folder("out", made_by="test", inputs=["d.toml"]):  # which is the design's name, and no file
        pass
    with new_file("set/new.toml", inputs=["set"]) as unfinished:  # beside what is read
        unfinished.touch()


def test_output_through_a_link_goes_where_it_leads(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "far" / "x.txt")
    with new_file(tmp_path / "link") as unfinished:
        unfinished.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "far" / "x.txt").read_text() == "new"


def test_second_at_once_is_refused_and_disturbs_nothing(tmp_path: Path) -> None:
    with new_folder(tmp_path / "out", made_by="test") as first, new_file(tmp_path / "x.txt") as file:
        (first / "x").write_text("first")
        for force in (False, True):
            with pytest.raises(InputError, match="out: another run is writing there"):
                fill(tmp_path / "out", force=force)
            with pytest.raises(InputError, match=r"x.txt: another run"), new_file(tmp_path / "x.txt", force=force):
                pass
        with new_file(tmp_path / "y.txt") as other:  # sweeps what nobody holds
            other.write_text("other")
        file.write_text("first")
    assert content(tmp_path) == {"out/x": "first", "x.txt": "first", "y.txt": "other"}


def test_file_that_came_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="exists"), new_file(tmp_path / "x.txt") as unfinished:
        unfinished.write_text("new")
        (tmp_path / "x.txt").write_text("another's")
    assert content(tmp_path) == {"x.txt": "another's"}


@pytest.mark.parametrize("moved", range(6))
def test_replacement_that_was_cut_off_is_finished(moved: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed after any number of its moves: the next run first goes on with them."""
    folder = tmp_path / "out"
    fill(folder, a="old", b="old", d="old", only__old="old")
    moves, replace = [0], Path.replace

    def killed(source: Path, goal: Path) -> Path:
        if folder == goal.parent:
            moves[0] += 1
            if moves[0] > moved:
                raise OSError("killed")
        return replace(source, goal)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        patch.setattr("fabdesign.output.atomic.Scratch.discard", lambda held: held._lock.close())
        if moved < 4:  # three files and the mark
            with pytest.raises(OSError, match="killed"):
                fill(folder, force=True, a="new", b="new", c="new")
        else:
            fill(folder, force=True, a="new", b="new", c="new")
    with pytest.raises(InputError, match="exists, made by fabdesign test; --force"):
        fill(folder, a="newer")
    assert content(folder) == {"a": "new", "b": "new", "c": "new"}
    fill(folder, a="newest", force=True)
    assert content(folder) == {"a": "newest"}


def test_work_goes_on_in_its_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt), work_folder(out, made_by="search") as work:
        with work.adding() as files:
            (files / "best").write_text("1")
        raise KeyboardInterrupt
    assert content(out) == {"best": "1"}
    with work_folder(out, made_by="search") as work:
        assert (work.folder, work.anew) == (out, False)
        with work.adding() as files:
            (files / "best").write_text("2")
    with pytest.raises(InputError, match="made by fabdesign search"), work_folder(out, made_by="loop"):
        pass
    assert content(out) == {"best": "2"}
    with pytest.raises(KeyboardInterrupt), work_folder(tmp_path / "idle", made_by="search"):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == [out]


def test_work_anew_leaves_the_old_until_it_is_complete(tmp_path: Path) -> None:
    def old() -> dict[str, str]:
        return {name: text for name, text in content(tmp_path / "out").items() if not name.startswith(".")}

    def work_on(best: str, *, complete: bool, error: type[BaseException] | None = None) -> None:
        with work_folder(tmp_path / "out", made_by="search", force=True) as work:
            seen.append((work.folder / "best").read_text() if (work.folder / "best").exists() else "none")
            with work.adding() as files:
                (files / "best").write_text(best)
            work.complete = complete
            if error:
                raise error

    seen: list[str] = []
    fill(tmp_path / "out", best="old", report="old")
    with pytest.raises(KeyboardInterrupt):
        work_on("1", complete=True, error=KeyboardInterrupt)
    work_on("2", complete=False)
    assert old() == {"best": "old", "report": "old"}
    work_on("3", complete=True)
    assert seen == ["none", "1", "2"]
    assert content(tmp_path / "out") == {"best": "3"}
    work_on("4", complete=True)
    assert seen[-1] == "none"

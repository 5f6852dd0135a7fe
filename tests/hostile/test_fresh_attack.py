"""What a fresh attack on the program has found: each gesture with what is right."""

import errno
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fabdesign.clouds.cloud_file import read_geometry
from fabdesign.errors import InputError, InputNote, why_not_loaded
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.motion_file import write_motion
from fabdesign.nouns.catalogue import build
from fabdesign.output import atomic_file, new_file, read_mark, sweep
from fabdesign.runtime import shortage
from studies.check.files import inspect
from studies.report.charts import chart, curve
from studies.report.page import html_of
from studies.studio.widgets.declared import markdown
from tests.command_line import Run, one_line

ROOT = Path(__file__).parents[2]
full_device = pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux")


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
    name = "<!--<script></script>"
    page = html_of("t", [chart("c", [curve(name, [0], [1])], x="x")])
    text = page[page.rindex('id="figures">') + len('id="figures">') :].partition("</script>")[0]
    assert "<" not in text and json.loads(text)["c"]["data"][0]["name"] == name


# --- what could mean two things, and what can be no cloth -------------------------------------------------------------

POINTS = "v 0 0 0{}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
ELEMENT = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
PCD = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\n{}DATA ascii\n1 2 3\n"
TWO_MEANINGS = {
    "weight.obj": (POINTS.format(" 0.5"), "weight is not 1"),
    "far.obj": (POINTS.replace("0 1 0", "0 1e6 0").format(""), r"a coordinate is 1e\+06; expected at most 100000"),
    "huge.obj": (POINTS.replace("0 1 0", "0 1e299 0").format(""), r"a coordinate is 1e\+299; expected at most 100000"),
    "huge.xyz": ("1e299 0 0\n0 1e299 0\n0 0 1e299\n", r"a coordinate is 1e\+299; expected at most 100000"),
    "twice.ply": (f"ply\nformat ascii 1.0\n{ELEMENT}{ELEMENT}end_header\n0 0 0\n1 0 0\n", "two elements of one name"),
    "moved.pcd": (PCD.format("VIEWPOINT 0 0 1 1 0 0 0\n"), "VIEWPOINT is 0 0 1 1 0 0 0"),
    "odd.pcd": (PCD.format("VIEWPOINT 0 0 0\n"), "VIEWPOINT is 0 0 0, by which"),
}


@pytest.mark.parametrize("name", TWO_MEANINGS)
def test_geometry_that_could_mean_two_things_is_refused(name: str, tmp_path: Path) -> None:
    text, message = TWO_MEANINGS[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_geometry(tmp_path / name)


def test_weights_of_one_and_no_viewpoint_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(POINTS.format(" 1.0"))
    (tmp_path / "a.pcd").write_text(PCD.format("VIEWPOINT 0 0 0 1.0 0 0 0\n"))
    assert len(read_geometry(tmp_path / "a.obj").points) == 3
    np.testing.assert_array_equal(read_geometry(tmp_path / "a.pcd").points, [[1, 2, 3]])


def test_an_array_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "points.npy", np.eye(3))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.write(tmp_path / "points.npy", "points.npy")
        archive.write(tmp_path / "points.npy", "points")
    with pytest.raises(InputError, match="has the array points twice"):
        read_geometry(tmp_path / "a.npz")


def test_frames_that_lie_33_s_apart_get_a_warning(tmp_path: Path) -> None:
    motion = np.random.default_rng(3).normal(0, 0.1, (3, 50, 3)).astype(np.float32)
    write_motion(tmp_path / "m.npz", 33.3 * np.arange(3), motion)
    assert inspect(tmp_path / "m.npz").warnings == (
        f"{tmp_path / 'm.npz'}: frames lie 33.3 s apart; expected seconds (is it in ms?)",
    )
    write_motion(tmp_path / "m.npz", 5.0 * np.arange(3), motion)
    assert inspect(tmp_path / "m.npz").warnings == ()


@pytest.mark.parametrize("mark", [";", "\t"])
def test_decimal_commas_that_could_part_thousands_are_said(mark: str, tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text(f"x{mark}y{mark}z\n1,000{mark}2,000{mark}3,000\n")
    with pytest.warns(InputNote, match="line 2: '1,000' is read as 1.000, and so are all commas"):
        assert read_geometry(tmp_path / "c.csv").points.tolist() == [[1, 2, 3]]


# --- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [r"\u001b[2J", r"a\u0000b", r"a\rb", r"\u009b31m", r"a\u2028b", r"\u202egnp.exe"])
def test_names_with_control_characters_are_refused(name: str, tmp_path: Path) -> None:
    write_design(build("cross"), tmp_path / "d.toml")
    text = (tmp_path / "d.toml").read_text()
    for old in ('"cross"', "muscle_types.EM20"):
        new = f'"{name}"' if old[0] == '"' else f'muscle_types."{name}"'
        (tmp_path / "e.toml").write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match=r"has control characters; expected none") as caught:
            read_design(tmp_path / "e.toml")
        assert str(caught.value).isprintable()


def test_a_terminal_is_commanded_by_no_name(run: Run) -> None:
    one_line(run("check", "\x1b[31m\u202e.toml"), r"\x1b[31m\u202e.toml: no such file")


def test_the_studio_shows_no_html_of_names() -> None:
    assert markdown("`<img src=x onerror=alert(1)>` & *b*") == "`&lt;img src=x onerror=alert(1)>` & *b*"


# --- full devices, full folders, modules of the user ------------------------------------------------------------------


def program(folder: Path, *line: str, out: str | None = None, err: str | None = None) -> tuple[int, str]:
    """Exit code and standard error of the program, whose streams may lead to devices."""
    command = [sys.executable, "-m", "fabdesign", *line]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with Path(out or os.devnull).open("w") as stdout, Path(err or os.devnull).open("w") as stderr:
        done = subprocess.run(
            command, cwd=folder, env=environment, stdout=stdout, stderr=stderr if err else subprocess.PIPE, text=True,
            timeout=120,
        )  # fmt: skip
    return done.returncode, done.stderr or ""


@full_device
def test_a_full_standard_output_throws_nothing_away(tmp_path: Path) -> None:
    (tmp_path / "http.py").write_text("raise SystemExit(9)")  # nor does a file of the user stand for a module
    (tmp_path / "random.py").write_text("raise SystemExit(9)")
    message = "fabdesign: standard output cannot be written (No space left on device); expected room for it\n"
    assert program(tmp_path, "new", "cross", "-o", "a.toml", out="/dev/full") == (2, message)
    assert program(tmp_path, "new", "basic", "-o", "b.toml", err="/dev/full") == (0, "")
    assert read_design(tmp_path / "a.toml").name == "cross" and read_design(tmp_path / "b.toml").name == "basic"


def test_what_does_not_load_names_the_file_in_its_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert why_not_loaded(ImportError("libX11.so.6: cannot open")) == "; on Debian: apt install libx11-6"
    missing = ModuleNotFoundError("No module named 'http.server'; 'http' is not a package", name="http.server")
    assert why_not_loaded(missing) == ""
    monkeypatch.setitem(sys.modules, "http", type(sys)("http"))
    sys.modules["http"].__file__ = str(tmp_path / "http.py")
    assert (
        why_not_loaded(missing)
        == f"; {tmp_path / 'http.py'} is loaded in place of Python's http: expected another name"
    )


def test_a_full_cache_folder_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def __enter__(self) -> "Full":
            return self

        def __exit__(self, *_: object) -> None: ...

        def write(self, content: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    assert shortage.is_writable(tmp_path)
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda dir: Full())
    assert not shortage.is_writable(tmp_path)


def test_the_line_of_a_full_disk_names_the_file_and_counts_what_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []
    inner = tmp_path / "set" / ".unfinished" / "new" / "set" / ".unfinished" / "new" / "set" / "trials" / "000.npz"

    def free_bytes(path: Path) -> int:
        seen.append(any(inner.parent.glob(".unfinished-*")))  # while the unfinished file is still there
        return 0

    monkeypatch.setattr("fabdesign.runtime.shortage.free_bytes", free_bytes)
    with pytest.raises(InputError, match=r"set/trials/000.npz: cannot be written") as caught, atomic_file(inner):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert ".unfinished" not in str(caught.value)
    assert seen == [True]

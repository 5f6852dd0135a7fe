"""Ctrl-C, and other ends: one line and the exit code, whatever the program is about, and nothing half written."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from fabdesign.output import new_files, new_folder
from fabdesign.runtime.supervisor import GRACE
from tests.interrupted import MODULE, SCRIPT, descendants, interrupted, snapshot, start, wait_for_program

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
BUSY = 20.0  # s: where others use the machine; tests/verify asks for 2 s
SIMULATE = ("simulate", "in/d.toml", "--pressures", "300,300", "-o", "new/m.npz")

# a command that holds unfinished output and does not answer: within C code that has Python's lock, or catching all
DEAF = """
import itertools, pathlib, signal, time
from fabdesign import __main__ as program, cli
from fabdesign.output import new_file, atomic_file, work_folder, write_text

@cli.commands.command()
@cli.console.click.argument("how")
def deaf(how):
    with new_file("new/deep/m.npz") as unfinished, work_folder("out", made_by="deaf") as work, atomic_file("own/f.txt"):
        unfinished.write_text("half")
        if how != "idle":
            work.claim("best.txt")
            write_text(work.folder / "best.txt", "1")
        pathlib.Path("begun").touch()
        while how == "swallows":
            try:
                time.sleep(60)
            except BaseException:
                pass
        if how == "idle":
            time.sleep(60)
        any(itertools.repeat(0, 10**14))

program.command_line = cli.main
signal.signal(signal.SIGQUIT, signal.SIG_DFL)  # which a shell ignores in what it runs in the background
program.main()
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    write_design(build("vertical", muscles=2), tmp_path / "in" / "d.toml")
    return tmp_path


@pytest.mark.parametrize("how", [MODULE, SCRIPT])
@pytest.mark.parametrize("group", [False, True])
def test_from_the_first_instruction_on(how: tuple[str, ...], group: bool, place: Path) -> None:
    before = snapshot(place)
    interrupted(SIMULATE, place, after=0.0, how=how, group=group).require_interrupted(BUSY)
    assert snapshot(place) == before


def test_while_the_program_loads_and_computes(place: Path) -> None:
    before = snapshot(place)
    for after in (0.2, 1.5):
        interrupted(SIMULATE, place, after=after, group=True).require_interrupted(BUSY)
        assert snapshot(place) == before


def made(place: Path) -> set[str]:
    return {name for name in snapshot(place) if not name.startswith("in")}


def deaf(how: str, place: Path, times: int, number: int = signal.SIGINT) -> tuple[int, str, float]:
    """Exit code, what is said and s to the end of such a command after signals."""
    process = start(["deaf", how], place, ("-c", DEAF))
    while not (place / "begun").exists():
        assert process.poll() is None
        time.sleep(0.02)
    begun = time.monotonic()
    for _ in range(times):
        process.send_signal(number)
        time.sleep(0.1)
    out, err = process.communicate(timeout=60)
    assert out == ""
    return process.returncode, err, time.monotonic() - begun


@pytest.mark.parametrize("how", ["computes", "swallows"])
@pytest.mark.parametrize("times", [1, 2])
def test_a_command_that_does_not_answer_is_ended(how: str, times: int, place: Path) -> None:
    code, err, seconds = deaf(how, place, times)
    kept = "out keeps what was done, and the same command goes on from there"
    assert (code, err) == (130, f"fabdesign: interrupted; {kept}\n")
    assert seconds < BUSY
    if times == 2:
        assert seconds < GRACE  # a second Ctrl-C waits for nothing
    assert made(place) == {"begun", "out", "out/.fabdesign", "out/best.txt"}


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="no processes beside it")
def test_processes_that_still_load_say_nothing(place: Path) -> None:
    (place / "in" / "p.csv").write_text("time_s,channel_0,channel_1\n0,100,0\n1,200,50\n")
    before = snapshot(place)
    process = start(["rig", "in/d.toml", "in/p.csv", "in/p.csv", "-o", "set"], place)
    while sum(b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes() for child in descendants(process.pid)) < 2:
        assert process.poll() is None
        time.sleep(0.02)
    time.sleep(0.2)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    estimate, *lines = err.splitlines()
    assert estimate.startswith("2 trials, ")
    assert (process.returncode, out, lines) == (130, "", ["fabdesign: interrupted"])
    assert snapshot(place) == before


def test_what_was_not_begun_leaves_no_folder(place: Path) -> None:
    code, err, _ = deaf("idle", place, 1, signal.SIGTERM)
    assert (code, err) == (143, "fabdesign: terminated by SIGTERM\n")
    assert made(place) == {"begun"}


def test_the_first_signal_names_the_end(place: Path) -> None:
    kept = "; out keeps what was done, and the same command goes on from there\n"
    process = start(["deaf", "computes"], place, ("-c", DEAF))
    while not (place / "begun").exists():
        time.sleep(0.02)
    for number in (signal.SIGTERM, signal.SIGINT):
        os.killpg(process.pid, number)
        time.sleep(0.1)  # of two that wait the system gives the lower number first
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (143, f"fabdesign: terminated by SIGTERM{kept}")


@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGUSR1, signal.SIGXCPU], ids=lambda number: number.name)
def test_every_signal_that_asks_to_end_leaves_nothing(number: signal.Signals, place: Path) -> None:
    code, err, _ = deaf("idle", place, 1, number)
    assert (code, err) == (128 + number, f"fabdesign: terminated by {number.name}\n")
    assert made(place) == {"begun"}


STARTING = """
        import subprocess
        for apart in (False, True):  # as a browser is, which stays
            subprocess.Popen("exec sleep 60 >/dev/null 2>&1", shell=True, start_new_session=apart)
        pathlib.Path("all").touch()
"""


def test_what_a_killed_command_had_started_ends_with_it(place: Path) -> None:
    process = start(["deaf", "computes"], place, ("-c", DEAF.replace("        any(", f"{STARTING}        any(")))
    while not (place / "all").exists():
        assert process.poll() is None
        time.sleep(0.02)
    _, *sleeping = descendants(process.pid)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert [Path(f"/proc/{child}").exists() for child in sleeping] == [False, True]
    os.kill(sleeping[1], signal.SIGKILL)


def test_who_does_the_work_ends_with_the_program_and_is_missed(place: Path) -> None:
    process = start(["deaf", "computes"], place, ("-c", DEAF))
    while not (place / "begun").exists():
        time.sleep(0.02)
    [worker] = descendants(process.pid)
    process.kill()
    process.communicate(timeout=60)
    ended = Path(f"/proc/{worker}/cmdline")  # empty of a process that nobody has waited for yet
    assert not ended.exists() or not ended.read_bytes()
    (place / "begun").unlink()
    before = set(place.rglob(".unfinished*"))  # a kill leaves them to the next run, or for an hour
    process = start(["deaf", "computes"], place, ("-c", DEAF))
    while not (place / "begun").exists():
        time.sleep(0.02)
    os.kill(next(descendants(process.pid)), signal.SIGKILL)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 137
    assert err.startswith("fabdesign: terminated by SIGKILL (where memory is short the system does that); out keeps")
    assert set(place.rglob(".unfinished*")) < before


def test_interrupts_that_are_ignored_stay_ignored(place: Path) -> None:
    ignoring = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"  # as nohup and `&` leave it
    process = start(["deaf", "idle"], place, ("-c", ignoring + DEAF))
    while not (place / "begun").exists():
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    time.sleep(0.2)
    assert process.poll() is None
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (143, "fabdesign: terminated by SIGTERM\n")


def test_exit_codes_and_output_are_those_of_the_command(place: Path) -> None:
    for line, code, out in ((["--version"], 0, "version"), (["new", "no", "-o", "x.toml"], 2, "")):
        process = start(line, place)
        wait_for_program(process)
        printed, _ = process.communicate(timeout=60)
        assert process.returncode == code and out in printed


@pytest.mark.parametrize("kind", ["files", "folder"])
def test_an_interrupt_while_output_moves_to_its_place(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved, replace = [], Path.replace

    def once_interrupted(self: Path, target: Path) -> Path:
        moved.append(target.name)
        if len(moved) == 2:
            raise KeyboardInterrupt
        return replace(self, target)

    def write() -> None:
        if kind == "files":
            with new_files(tmp_path / "a.ply", companions=["b.ply", "c.ply"]) as first:
                for name in "abc":
                    (first.parent / f"{name}.ply").write_text(name)
                monkeypatch.setattr(Path, "replace", once_interrupted)
        else:
            with new_folder(tmp_path / "set", made_by="rig") as folder:
                for name in "abc":
                    (folder / f"{name}.ply").write_text(name)
                monkeypatch.setattr(Path, "replace", once_interrupted)
                moved.append(".fabdesign")  # the mark is written, by a replace too
                moved.clear()

    with pytest.raises(KeyboardInterrupt):
        write()
    monkeypatch.undo()
    names = sorted(path.name for path in tmp_path.rglob("*.ply"))
    assert names in (["a.ply", "b.ply", "c.ply"], [])
    assert names or kind == "folder"
    assert not list(tmp_path.rglob(".unfinished*"))

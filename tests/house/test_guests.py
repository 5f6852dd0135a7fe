"""Beside other code in one process: Taichi that is shared, a fork, a home that cannot be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fabdesign.runtime import shortage

ROOT = Path(__file__).parents[2]


def homeless(folder: Path, line: list[str], **changed: str) -> "subprocess.CompletedProcess[str]":
    """A Python that has no home to write to."""
    others = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "TI_", "MPL"))}
    environment = others | {"PYTHONPATH": str(ROOT), "HOME": "/proc", "TMPDIR": str(folder)} | changed
    command = [sys.executable, *line]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=600)


SHARED = """
import taichi as ti

ti.init(arch=ti.cpu)
theirs = ti.field(ti.f32, shape=3)
theirs[1] = 5.0
from fabdesign.errors import InputError
from sim.kernels import fields

def allocate(side):
    try:
        fields.allocate(side * side, 96, side, blocks=1)
        return "made"
    except InputError as error:
        return error

print("before:", allocate(43), theirs[1])
ti.reset()
del theirs
print("given up:", allocate(43))
ti.init(arch=ti.cpu)
print("other start:", allocate(43), fields.F.node.shape[0])
own = ti.field(ti.f32, shape=3)
own[1] = 7.0
print("room:", allocate(43), own[1])
print("larger:", allocate(83), own[1])
ti.init(arch=ti.cpu)
new = ti.field(ti.f32, shape=3)
print("after:", allocate(43))
"""
HELD = (
    "other code of this process has fields in Taichi, which fabdesign would drop; expected it in a process of its own "
    "(multiprocessing, spawn), or ti.reset() where its fields are no longer needed"
)

FORKED = """
import os, sys
from fabdesign.errors import InputError
from sim.kernels import fields

fields.allocate(43 * 43, 96, 43, blocks=1)
fields.lock.acquire()  # as a thread that simulates
child = os.fork()
if child == 0:
    try:
        with fields.lock:
            fields.allocate(43 * 43, 96, 43, blocks=1)
    except InputError as error:
        print(error, flush=True)
    sys.exit(3)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def printed(code: str) -> list[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return [line for line in done.stdout.splitlines() if not line.startswith("[Taichi]")]


def test_taichi_is_not_taken_from_other_code() -> None:
    assert printed(SHARED) == [
        f"before: {HELD} 5.0",
        "given up: made",
        "other start: made 1",
        "room: made 7.0",
        f"larger: {HELD} 7.0",
        f"after: {HELD}",
    ]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_says_spawn_and_ends() -> None:
    message, code = printed(FORKED)
    assert message.endswith('expected a process started by spawn: multiprocessing.get_context("spawn")')
    assert code == "3"


# a kernel and the end of Taichi, which was a segmentation fault without a folder
KERNEL = """
import taichi as ti
from sim.kernels import fields

@ti.kernel
def three() -> ti.i32:
    return 3

fields.allocate(43 * 43, 96, 43, blocks=1)
print(three())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc, and XDG_CACHE_HOME")
@pytest.mark.parametrize("given", [{}, {"TI_OFFLINE_CACHE": "0"}, {"TI_OFFLINE_CACHE_FILE_PATH": "kernels"}])
def test_a_home_that_cannot_be_written(given: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels/ticache.lock").touch()  # a killed process has left it
    os.utime(tmp_path / "kernels/ticache.lock", (0, 0))
    done = homeless(tmp_path, ["kernel.py"], **given)
    instead = tmp_path / f"fabdesign-cache-{os.getuid()}"
    note = f"/proc/.cache: cannot be written; {instead} takes its place (XDG_CACHE_HOME sets another)"
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "3"), done.stderr
    assert done.stderr.count("cannot be written") == 2 and note in done.stderr  # a warning, and its line of code
    assert "Lock" not in done.stderr
    assert instead.stat().st_mode & 0o777 == 0o700
    kept = {path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("*.tic")}
    assert kept == {instead.name if not given else given.get("TI_OFFLINE_CACHE_FILE_PATH")} - {None}


@pytest.mark.skipif(sys.platform != "linux", reason="/proc, and XDG_CACHE_HOME")
def test_a_folder_for_kernels_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    done = homeless(tmp_path, ["-c", KERNEL], TI_OFFLINE_CACHE_FILE_PATH="/proc/kernels")
    line = "TI_OFFLINE_CACHE_FILE_PATH is '/proc/kernels': cannot be written; expected another folder"
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, f"fabdesign.errors.InputError: {line}")


def test_a_temporary_folder_of_others_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    mine = tmp_path / f"fabdesign-cache-{os.getuid()}"
    assert shortage.temporary_folder() == mine == shortage.temporary_folder()
    mine.chmod(0o777)  # others may have put kernels there
    assert shortage.temporary_folder() != mine
    mine.rmdir()
    mine.symlink_to(tmp_path)
    assert shortage.temporary_folder() not in (mine, tmp_path)

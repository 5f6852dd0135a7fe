"""The program as a process of its own that is asked to end by signals."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULE = ("-m", "fabdesign")
SCRIPT = ("-c", "from fabdesign.__main__ import main; main()")  # as the console script
INTERRUPTED = "fabdesign: interrupted"


@dataclass(frozen=True)
class Ended:
    code: int
    out: str
    err: str
    seconds: float  # from the first signal on

    def require_interrupted(self, within: float) -> None:
        """The one line, 130, and in time."""
        assert (self.code, self.out) == (130, ""), self
        assert self.err.splitlines()[0].startswith(INTERRUPTED) and len(self.err.splitlines()) == 1, self
        assert self.seconds < within, self


def start(line: Sequence[str], folder: Path, how: Sequence[str] = MODULE) -> "subprocess.Popen[str]":
    """Start a command, which answers SIGINT, whatever of that this process ignores."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [sys.executable, *how, *line], cwd=folder, env=environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
    finally:
        signal.signal(signal.SIGINT, before)


def wait_for_program(process: "subprocess.Popen[str]") -> None:
    """Return where the program begins, with its child: until then it is Python that starts, and answers as it does."""
    end = time.monotonic() + 60
    while process.poll() is None and not any(descendants(process.pid)):
        assert time.monotonic() < end
        time.sleep(0.002)


def interrupted(
    line: Sequence[str], folder: Path, *, after: float, how: Sequence[str] = MODULE, times: int = 1, group: bool = False
) -> Ended:
    """What comes of a command that gets SIGINT so many s after its first instruction. group: as from a terminal, which
    sends it to all processes."""
    process = start(line, folder, how)
    wait_for_program(process)
    time.sleep(after)
    begun = time.monotonic()
    for _ in range(times):
        if process.poll() is None:
            (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
            time.sleep(0.05)
    out, err = process.communicate(timeout=60)
    return Ended(process.returncode, out, err, time.monotonic() - begun)


def descendants(pid: int) -> Iterator[int]:
    """Processes that a process has started, and those that these have."""
    with suppress(FileNotFoundError, ProcessLookupError):  # it has ended
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            for child in children.read_text().split():
                yield int(child)
                yield from descendants(int(child))


def snapshot(folder: Path) -> dict[str, bytes]:
    """All files and folders there are, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in sorted(folder.rglob("*"))}

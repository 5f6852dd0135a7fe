"""A command works in a child process; the process that was started waits for it and answers signals.

Python runs a signal's handler between two of its own instructions, and Taichi holds Python's lock for as long as it
compiles, which may be many seconds: no handler and no thread of that process can answer meanwhile. So the program forks
before it loads anything. The parent hands the signals that ask a program to end on to the child. Where the child has
not ended after GRACE, or the same signal comes again, the parent kills it and what it had started, and gives up for it
what it has left unfinished. The line that says so, and the exit code, are the parent's. The child ends with its parent,
whatever ends that.

Until `supervised` is called an interrupt is shown by Python, as a traceback: what is imported here loads in no time.
"""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator

GRACE = 1.2  # s that a child has to end by itself
_ASK = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGXCPU")  # to end
SIGNALS = [getattr(signal, name) for name in _ASK if hasattr(signal, name)]
GiveUp = Callable[[list[dict[str, object]]], list[str]]
_DIES_WITH_PARENT, _ADOPTS = 1, 36  # PR_SET_PDEATHSIG; PR_SET_CHILD_SUBREAPER
_shared: list[int] = []  # in a child: the file in memory that its parent reads when it has ended


def supervised(work: Callable[[], None], give_up: GiveUp) -> None:
    """Run `work` in a child process, and exit as it does: 128 + n where signal n ended it, with one line.

    Without Linux, and where no process can be made, run it in this one. give_up: gives up what a killed child held, by
    its records, and returns what is to be said of it."""
    if sys.platform != "linux":
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # as in a child: `work` takes what has no handler
        work()
        return
    # what is ignored stays so, as by `nohup`
    answered = {number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, answered | {signal.SIGCHLD})
    shared, parent = os.memfd_create("fabdesign"), os.getpid()
    try:
        child = os.fork()
    except OSError:
        child = 0
    if child:
        sys.exit(_wait(child, answered, shared, give_up))
    if os.getpid() != parent:
        _shared.append(shared)
        _set(_DIES_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
    if signal.SIGINT in answered:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until `work` has its handler there is nothing to give up
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    work()


def is_supervised() -> bool:
    """Return whether this process is such a child."""
    return bool(_shared)


def record(**content: object) -> None:
    """Leave a record for the parent, which reads all of them when this process has ended; nothing without a parent.
    `ended`: the signal that this process ends by itself for, and `kept`: what to say of its work folders. Others are
    for `give_up`."""
    if _shared:
        import json

        os.write(_shared[0], json.dumps(content).encode() + b"\n")


def ended_by(number: int) -> str:
    """Return what is said of a command that a signal ended."""
    return "interrupted" if number == signal.SIGINT else f"terminated by {signal.Signals(number).name}"


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Return a context in the main thread in which Ctrl-C waits until it is over. Processes that are begun in it do not
    hear it: one that still loads would print a traceback."""
    import threading

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, before)
    if asked:
        signal.raise_signal(signal.SIGINT)


def _set(option: int, value: int) -> None:
    import ctypes

    ctypes.CDLL(None).prctl(option, value)


def _wait(child: int, answered: Iterable[int], shared: int, give_up: GiveUp) -> int:
    """Wait until the child has ended, answer signals, and return this process's exit code."""
    _set(_ADOPTS, 1)
    asked, end = 0, 0.0
    while True:
        rest = max(0.0, end - time.monotonic()) if asked else 3600.0
        come = signal.sigtimedwait({*answered, signal.SIGCHLD}, rest)
        number = 0 if come is None else come.si_signo
        if number in answered and number != asked:
            if not asked:
                asked, end = number, time.monotonic() + GRACE
            os.kill(child, number)
        elif asked and number != signal.SIGCHLD:  # the time is over, or it was asked again
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
            break
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
    import json

    from fabdesign.errors import printable

    code = os.waitstatus_to_exitcode(status)
    records = [json.loads(line) for line in os.pread(shared, os.fstat(shared).st_size, 0).splitlines()]
    ends = [one for one in records if "ended" in one][-1:]
    number = asked or (ends[0]["ended"] if ends else max(-code, 0))  # of several signals the first that came here
    if not number:
        return code
    with contextlib.suppress(OSError):  # a kernel that does not list them
        _kill_adopted()
    try:
        kept = give_up(records)  # what the child has not given up itself
    except Exception as error:  # the line must come whatever is wrong with the disk
        kept = [f"unfinished output is left ({error})"]
    hint = " (where memory is short the system does that)" if not asked and code == -signal.SIGKILL else ""
    line = " ".join("; ".join([ended_by(number) + hint, *(ends[0]["kept"] if ends else kept)]).split())
    # a progress bar has hidden the cursor and stands where ^C was shown
    terminal = "\r\x1b[K\x1b[?25h" if os.isatty(2) else ""
    with contextlib.suppress(OSError):  # nobody reads
        os.write(2, f"{terminal}fabdesign: {printable(line)}\n".encode(errors="replace"))
    return 128 + int(number)


def _kill_adopted() -> None:
    """Kill what an ended child has left at work: processes of this group, which a browser that was opened is not."""
    from pathlib import Path

    listed = Path(f"/proc/self/task/{os.getpid()}/children")
    while ours := [child for child in map(int, listed.read_text().split()) if os.getpgid(child) == os.getpgrp()]:
        for child in ours:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)

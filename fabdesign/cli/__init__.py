"""The command line: `fabdesign.interface` in the shell. Its commands are made from the functions (`command.py`)."""

import atexit
import errno
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter, FileIO, TextIOWrapper
from types import FrameType
from typing import Any

import click

from fabdesign.cli.command import add_commands
from fabdesign.cli.console import commands, notes_shown, tell
from fabdesign.errors import EXTRAS, InputError, SimulationError, needs
from fabdesign.runtime.shortage import line_of
from fabdesign.runtime.supervisor import SIGNALS, ended_by, is_supervised, record

add_commands()


class Terminated(BaseException):
    """A signal, whose number it has, asked the program to end. Like KeyboardInterrupt no Exception, so that all is
    cleaned up on its way."""


def main() -> None:
    """Run the command line: exit 0 on success, 2 on bad input 1 on other failures, 130 and 143 where it was stopped
    by Ctrl-C and by SIGTERM, each with one line."""
    printed = _lasting_streams()
    try:
        with _ended_by_signals(), notes_shown():
            commands.main(prog_name="fabdesign", standalone_mode=False)
        if printed is not None and (failure := printed.failure) is not None:
            if failure.errno == errno.EPIPE:  # who read has seen enough
                sys.exit(1)
            _fail(f"standard output cannot be written ({failure.strerror}); expected room for it", 2)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code)
    except InputError as error:
        _fail(str(error), 2)
    except SimulationError as error:
        _fail(str(error), 1)
    except ModuleNotFoundError as error:
        if error.name not in EXTRAS:
            raise
        _fail(needs(error), 1)
    except Terminated as stop:
        _end(stop, stop.args[0])
    except (click.exceptions.Abort, KeyboardInterrupt) as stop:
        _end(stop, signal.SIGINT)
    except (OSError, MemoryError, ImportError, RuntimeError, SystemError) as error:  # after Abort, a RuntimeError
        if (line := line_of(error)) is None:
            raise
        _fail(line, 2)


class _Lasting(FileIO):
    """A standard stream whose failure ends nothing: a command goes on, and keeps what it has computed."""

    failure: OSError | None = None

    def write(self, content: Any) -> int:
        try:
            return super().write(content)
        except OSError as error:
            self.failure = error
            return memoryview(content).nbytes


def _lasting_streams() -> _Lasting | None:
    """Put such streams in place of those of the system, which also take names of files that their encoding does not
    have. Return that of standard output; None where it is another's."""
    streams = {}
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        buffer = getattr(stream, "buffer", None)
        if isinstance(getattr(buffer, "raw", buffer), FileIO):
            stream.flush()
            streams[name] = _Lasting(stream.fileno(), "w", closefd=False)
            new = TextIOWrapper(BufferedWriter(streams[name]), stream.encoding, "backslashreplace", line_buffering=True)
            setattr(sys, name, new)
            setattr(sys, f"__{name}__", new)  # Taichi compares them
    return streams.get("stdout")


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Have SIGTERM and SIGHUP, and SIGINT in a supervised process, raise Terminated, once; where they are ignored
    (`nohup`), they stay so. A supervised process then says nothing more: its parent does."""

    stopped: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.append(number)
        for each in before:
            signal.signal(each, signal.SIG_IGN)  # what follows is cleaning up
        if is_supervised():
            nothing = os.open(os.devnull, os.O_WRONLY)
            for stream in (1, 2):
                os.dup2(nothing, stream)
        raise Terminated(number)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: handler for number, handler in before.items() if handler is signal.SIG_DFL}
    for number in before:
        signal.signal(number, stop)
    try:
        yield
    finally:
        if not (stopped and is_supervised()):  # there a second signal is the parent's to answer
            for number, handler in before.items():
                signal.signal(number, handler)


def _end(stop: BaseException, number: int) -> None:
    """Exit with one line, which says what the work folder keeps: the outermost, whose note comes last."""
    kept = getattr(stop, "__notes__", [])[-1:]
    if is_supervised():
        record(ended=number, kept=kept)
        with suppress(OSError):
            sys.stdout.flush()
        atexit._run_exitfuncs()
        os._exit(128 + number)  # no more: Taichi would write its kernels, and a kill meanwhile leave its lock
    _fail("; ".join([ended_by(number), *kept]), 128 + number)


def _fail(message: str, code: int) -> None:
    tell(f"fabdesign: {' '.join(message.split())}")
    sys.exit(code)

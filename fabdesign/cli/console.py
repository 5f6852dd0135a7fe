"""Parts that the commands share: the group, how they print, how notes are shown, and progress on standard error: on a
terminal a bar with the time left, elsewhere lines. While kernels compile, the bar says so, and that time is not
extrapolated."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import TYPE_CHECKING, Any

import click

from fabdesign.errors import InputNote, printable
from fabdesign.formats.json_file import json_text
from fabdesign.runtime import working_time
from fabdesign.runtime.effort import duration
from fabdesign.runtime.shortage import ensure_cache_folder
from fabdesign.version import __version__

if TYPE_CHECKING:
    from rich.progress import Progress

MOST = 10  # notes of a command: a set may have one a trial
_SETTLED = 5.0  # s, before which a share does not tell the time left
_PERIOD = 600.0  # s of steps that the time left is taken from: a step of a fit may last a minute


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def commands() -> None:
    """Design fabric actuators: a cloth with McKibben muscles laced through it.

    Files and options are in metres, seconds, newtons and kPa; errors are shown in millimetres.
    """
    ensure_cache_folder()


def print_result(result: object, text: str, as_json: bool) -> None:
    """Print a result as JSON or as text; nothing where there is none."""
    if as_json or text:
        click.echo(json_text(result) if as_json else printable(text))


def tell(line: str) -> None:
    """Print a line on standard error."""
    click.echo(printable(line), err=True)


@contextmanager
def notes_shown() -> Iterator[None]:
    """Show each `InputNote` once, as "note: ...", and MOST of them; other warnings as Python does."""
    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not isinstance(message, InputNote):
            before(message, category, *place, **more)
        elif str(message) not in shown:
            shown.add(str(message))
            if len(shown) <= MOST:
                tell(f"note: {' '.join(str(message).split())}")
            elif len(shown) == MOST + 1:
                tell("note: there are more of these; fabdesign check lists all of a file or folder")

    with warnings.catch_warnings():
        before = warnings.showwarning
        warnings.simplefilter("always", InputNote)
        warnings.showwarning = show
        yield


@contextmanager
def described(
    title: str, *, interval: float = 0.0, of_search: bool = False
) -> Iterator[Callable[[str, float | None], None]]:
    """Return a context for work that says what it does, and about what share of it is done; without a share a line is
    an answer or an estimate, which stays. Elsewhere than on a terminal steps follow at least `interval` s apart, and
    end with the time that is left. of_search: lines begin with the title, and say themselves how much is left."""
    head = f"{title}: " if of_search else ""
    if not on_terminal():
        begin, shown_at = working_time.seconds(), -inf

        def tell_step(line: str, share: float | None) -> None:
            nonlocal shown_at
            now = working_time.seconds()
            if share is not None and now - shown_at < interval:
                return
            shown_at, elapsed = now, now - begin
            known = share is not None and 0 < share < 1 and elapsed > _SETTLED and not of_search
            rest = f"; about {duration(elapsed * (1 / share - 1))} left" if known and share else ""
            tell(head + line + rest)

        yield tell_step
        return
    with _bar(with_rest=not of_search) as shown:
        task = shown.add_task(title, total=1.0)

        def show(line: str, share: float | None) -> None:
            line = printable(head + line)
            if share is None:
                shown.console.print(line, highlight=False, markup=False, soft_wrap=True)
            else:
                shown.update(task, description=line, completed=share)

        yield show


def _bar(with_rest: bool) -> "Progress":
    """Return a bar on standard error, gone when it is closed: what is done is told by the command's result."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, Task, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Remaining(TimeRemainingColumn):
        """The time left by the clock that stands still while kernels compile, or that they do."""

        def __init__(self) -> None:
            super().__init__()
            self.max_refresh = -1.0  # s: never kept, for that clock stands still

        def render(self, task: Task) -> Text:
            if working_time.wall.stops:
                return Text("compiling the simulator")
            return Text.assemble(super().render(task), " left") if with_rest else Text()

    return Progress(
        TextColumn("{task.description}", markup=False),  # names may look like it
        BarColumn(),
        Remaining(),
        console=Console(stderr=True),
        transient=True,
        speed_estimate_period=_PERIOD,
        get_time=working_time.seconds,
    )


def on_terminal() -> bool:
    from rich.console import Console

    return Console(stderr=True).is_terminal

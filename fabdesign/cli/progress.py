"""Progress on standard error: on a terminal a bar with the time left, elsewhere lines."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.progress import Progress

Counter = Callable[[int, int], None]  # done, of


@contextmanager
def counted(verb: str, what: str = "trials") -> Iterator[Counter]:
    """A context in which things are counted, as in "predicted 3 of 8 trials"."""
    if not _on_terminal():
        yield lambda done, total: click.echo(f"{verb} {done} of {total} {what}", err=True)
        return
    with bar() as shown:
        task = shown.add_task(verb, total=None)

        def show(done: int, total: int) -> None:
            shown.update(task, description=f"{verb} {done} of {total} {what}", completed=done, total=total)

        yield show


@contextmanager
def described(title: str) -> Iterator[Callable[[str, float | None], None]]:
    """A context for work that tells what it does, and about what share of it is done."""
    if not _on_terminal():
        yield lambda line, share: click.echo(line, err=True)
        return
    with bar() as shown:
        task = shown.add_task(title, total=1.0)
        yield lambda line, share: shown.update(task, description=line, completed=share)


def bar() -> "Progress":
    """On standard error, gone when it is closed: what is done is told by the command's result."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    return Progress(*columns, console=Console(stderr=True), transient=True)


def _on_terminal() -> bool:
    from rich.console import Console

    return Console(stderr=True).is_terminal

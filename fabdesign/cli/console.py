"""Parts that the commands share: the group, how they print, and how notes are shown."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from fabdesign.errors import InputNote, printable
from fabdesign.formats.json_file import json_text
from fabdesign.runtime.cache_folder import ensure_cache_folder
from fabdesign.version import __version__


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def commands() -> None:
    """Design fabric actuators: a cloth with McKibben muscles laced through it.

    Files and options are in metres, seconds, newtons and kPa; errors are shown in millimetres.
    """
    ensure_cache_folder()


def print_result(result: Mapping[str, Any], text: str, as_json: bool) -> None:
    """Print a result as JSON or as text; nothing where there is none."""
    if as_json or text:
        click.echo(json_text(result) if as_json else printable(text))


def tell(line: str) -> None:
    """Print a line on standard error."""
    click.echo(printable(line), err=True)


MOST = 10  # lines of a command: a set may have one a trial


@contextmanager
def notes_told() -> Iterator[None]:
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

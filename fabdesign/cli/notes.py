"""What was read otherwise than as a format has it: a line each on standard error."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fabdesign.cli.console import tell
from fabdesign.errors import InputNote

MOST = 10  # lines of a command: a set may have one a trial


@contextmanager
def notes_told() -> Iterator[None]:
    """Show each `InputNote` once, as "note: ...", and MOST of them; other warnings as Python does."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not isinstance(message, InputNote):
            before(message, category, *place, **more)
        elif str(message) not in told:
            told.add(str(message))
            if len(told) <= MOST:
                tell(f"note: {' '.join(str(message).split())}")
            elif len(told) == MOST + 1:
                tell("note: there are more of these; fabdesign check lists all of a file or folder")

    with warnings.catch_warnings():
        before = warnings.showwarning
        warnings.simplefilter("always", InputNote)
        warnings.showwarning = show
        yield

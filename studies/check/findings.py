"""The findings of `check` on one file or folder."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from fabdesign.errors import InputError


@dataclass(frozen=True)
class Findings:
    """A line each. problems: what a command refuses or a workshop cannot make; warnings: what is implausible; notes:
    what was left out, or read otherwise than as the format has it."""

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __add__(self, other: "Findings") -> "Findings":
        """Return both, a line that both have once."""
        return Findings(
            tuple(dict.fromkeys((*self.problems, *other.problems))),
            tuple(dict.fromkeys((*self.warnings, *other.warnings))),
            tuple(dict.fromkeys((*self.notes, *other.notes))),
        )


def failures(reads: Iterable[Callable[[], object]]) -> Findings:
    """Return the lines of those that raise InputError."""
    messages = []
    for read in reads:
        try:
            read()
        except InputError as error:
            messages.append(str(error))
    return Findings(tuple(messages))

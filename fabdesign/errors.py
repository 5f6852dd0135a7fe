"""The exceptions that a user is meant to read, and notes on what was read."""

import warnings


class InputError(ValueError):
    """Bad input, said in one line: what came, where, and what was expected. The command line exits with 2."""


class SimulationError(RuntimeError):
    """Sound input whose motion could not be computed, said in one line. The command line exits with 1."""


class InputNote(UserWarning):
    """What was left out of a file, or read otherwise than as the format has it, in one line."""


def note(line: str) -> None:
    """Say a line of what was read as an `InputNote`: Python shows it as a warning, the command line as "note: ..."."""
    warnings.warn(InputNote(line), stacklevel=2)

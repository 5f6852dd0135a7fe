"""Bad data: an error, or left out and listed."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from fabdesign.errors import InputError
from fabdesign.trial import MeasurementSet


@dataclass
class Tolerance:
    """Whether bad data end the work or are left out, and the list of what was."""

    skip_bad: bool
    skipped: list[str] = field(default_factory=list)

    @contextmanager
    def forgiving(self) -> Iterator[None]:
        """A block whose InputError is noted and passed over, if bad data may be skipped."""
        try:
            yield
        except InputError as error:
            self.note(error)

    def note(self, error: InputError) -> None:
        if not self.skip_bad:
            raise error
        self.skipped.append(str(error))


def sound_trials(measured: MeasurementSet, *, skip_bad: bool) -> tuple[MeasurementSet, tuple[str, ...]]:
    """The set without its unsound trials, and a line on each of them. Every trial is read.

    Raises InputError for the first one unless `skip_bad`, and where none is left.
    """
    tolerance, sound = Tolerance(skip_bad), []
    for trial in measured.trials:
        with tolerance.forgiving():
            trial.load()
            sound.append(trial)
    if not sound:
        raise InputError(f"{measured.name}: no sound trial; the first: {tolerance.skipped[0]}")
    return replace(measured, trials=tuple(sound)), tuple(tolerance.skipped)

"""Bad data: an error, or left out and listed."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from fabdesign.errors import InputError
from fabdesign.nouns.trial import MeasurementSet, Role


@dataclass
class Tolerance:
    """Whether bad data end the work or are left out, and the list of what was."""

    skip_bad: bool
    skipped: list[str] = field(default_factory=list)

    @contextmanager
    def forgiving(self) -> Iterator[None]:
        """Return a block whose InputError is noted and passed over, if bad data may be skipped."""
        try:
            yield
        except InputError as error:
            self.note(error)

    def note(self, error: InputError) -> None:
        if not self.skip_bad:
            raise error
        self.skipped.append(str(error))


def sound_trials(
    measured: MeasurementSet, *, skip_bad: bool, roles: Collection[Role] = ("fit", "test")
) -> tuple[MeasurementSet, tuple[str, ...]]:
    """Return the set's trials of these roles, all of them read, without the unsound ones, and a line on each of those.

    Raises InputError for the first one unless `skip_bad`, and where none is left.
    """
    tolerance, sound = Tolerance(skip_bad), []
    for trial in measured.trials:
        if trial.role in roles:
            with tolerance.forgiving():
                trial.load()
                sound.append(trial)
    if not sound and tolerance.skipped:
        raise InputError(f"{measured.name}: no sound trial; the first: {tolerance.skipped[0]}")
    return replace(measured, trials=tuple(sound)), tuple(tolerance.skipped)

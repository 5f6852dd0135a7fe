"""Which trials are sound, which may be fitted and which are held out: by trial, never by frame.

Bad data are an error, or left out and listed. Trials with the same pressures stay on one side of any split, and trials
of role `test` take no part in fitting.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from fabdesign.errors import InputError
from fabdesign.nouns.trial import MeasurementSet, Role, Trial
from optimize.fit.clouds import evenly

Trials = tuple[Trial, ...]
TRIALS = 16  # fitted at most, spread over those allowed; with many effects more


@dataclass(frozen=True)
class Split:
    fit: Trials
    held_out: Trials


def fit_trials(trials: Sequence[Trial], orders: Collection[int] | None = None) -> Trials:
    """Return the trials of role `fit`, or those of the given orders among them.

    Raises InputError for an order that no trial has or that a trial of role `test` has alone, and for an empty result.
    """
    allowed = tuple(trial for trial in trials if trial.role == "fit")
    if orders is not None:
        known = {trial.order for trial in allowed}
        for order in sorted(set(orders) - known):
            if any(trial.order == order for trial in trials):
                raise InputError(f"trial of order {order} has role test; nothing may be fitted on it")
            raise InputError(f"no trial of order {order}; the set has {', '.join(map(str, sorted(known)))} to fit")
        allowed = tuple(trial for trial in allowed if trial.order in orders)
    if not allowed:
        raise InputError("no trial of role fit; expected at least one")
    return allowed


def split(trials: Sequence[Trial], held_out: float, *, seed: int = 0) -> Split:
    """Fit trials, about the share `held_out` of them kept back. At least one stays on either side.

    Trials of role `test` are in neither. Raises InputError where all trials have the same pressures.
    """
    groups = _several_programs(trials)
    count = min(max(round(held_out * len(groups)), 1), len(groups) - 1)
    chosen = {int(i) for i in np.random.default_rng(seed).permutation(len(groups))[:count]}
    return _split(groups, chosen)


def folds(trials: Sequence[Trial], count: int, *, seed: int = 0) -> tuple[Split, ...]:
    """Return the splits of a cross-validation, `count` (or as many as there are programs), each fit trial held out
    once."""
    groups = _several_programs(trials)
    order = np.random.default_rng(seed).permutation(len(groups))
    return tuple(_split(groups, {int(i) for i in part}) for part in np.array_split(order, min(count, len(groups))))


def by_program(trials: Sequence[Trial]) -> list[Trials]:
    """Return trials with the same pressures together."""
    groups: dict[tuple[bytes, bytes], list[Trial]] = {}
    for trial in trials:
        program = trial.program
        # to a millisecond and the regulator's 0.1 kPa: a repeat is a repeat though the clock jitters
        key = (np.rint(program.time * 1e3).tobytes(), np.rint(program.pressure / 100).tobytes())
        groups.setdefault(key, []).append(trial)
    return [tuple(group) for group in groups.values()]


def of_each_design(trials: Sequence[Trial], most: int) -> list[Trial]:
    """Return at most so many trials of a design, spread over the session."""
    selected = []
    for name in sorted({trial.design_name for trial in trials}):
        of_design = [trial for trial in trials if trial.design_name == name]
        selected += [of_design[k] for k in evenly(len(of_design), most)]
    return selected


def program_of(trials: Sequence[Trial]) -> tuple[int, ...]:
    """Return a number for each trial, which those with the same pressures share."""
    number = {id(trial): k for k, group in enumerate(by_program(trials)) for trial in group}
    return tuple(number[id(trial)] for trial in trials)


def _several_programs(trials: Sequence[Trial]) -> list[Trials]:
    groups = by_program(fit_trials(trials))
    if len(groups) < 2:
        raise InputError("all trials to fit have the same pressures; expected at least two programs to hold one out")
    return groups


def _split(groups: Sequence[Trials], held_out: Collection[int]) -> Split:
    fit = (trial for i, group in enumerate(groups) if i not in held_out for trial in group)
    return Split(tuple(fit), tuple(trial for i in sorted(held_out) for trial in groups[i]))


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
    measured: MeasurementSet, tolerance: Tolerance, roles: Collection[Role] = ("fit", "test")
) -> tuple[MeasurementSet, tuple[str, ...]]:
    """Return the set's trials of these roles, all of them read, without the unsound ones, and a line on each of those.

    Raises InputError for the first one unless it is tolerated, and where none is left.
    """
    sound, before = [], len(tolerance.skipped)
    for trial in measured.trials:
        if trial.role in roles:
            with tolerance.forgiving():
                trial.load()
                sound.append(trial)
    skipped = tuple(tolerance.skipped[before:])
    if not sound and skipped:
        raise InputError(f"{measured.name}: no sound trial; the first: {skipped[0]}")
    return replace(measured, trials=tuple(sound)), skipped

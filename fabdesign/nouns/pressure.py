"""Pressure programs: the regulator's set points over time, what a rig can do, and how far the programs went that a
model was fitted to."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.formats.schema import ABOVE_0, FROM_0, Key, Kilopascal, KilopascalPerSecond, Second, Within
from fabdesign.runtime.effort import LONGEST
from fabdesign.units import in_kpa

if TYPE_CHECKING:
    from fabdesign.nouns.design import Design

RISE_STEPS, RESOLUTION = 60, 100.0  # rows; Pa
LEAST_HOLD = 0.7  # s, after which a cloth stands: shapes at rest cost a fit a hundredth of what a motion costs
LARGEST = 1e6  # Pa, for a muscle type that states no maximum
WINDOW = 0.1  # s, over which a set point's rate is taken: the shorter of the lags that are learned
_SLIGHT = 1e-3  # of a number, that does not count as beyond it


@dataclass(frozen=True, eq=False)
class PressureProgram:
    """Set points that hold from each row's time to the next row's; the last row holds for ever.

    time (R,) s, rising from 0; pressure (R, channels) Pa, gauge; duration: length of the motion in s.
    """

    time: NDArray[np.float64]
    pressure: NDArray[np.float64]
    duration: float

    @classmethod
    def of_rows(cls, time: NDArray[np.float64], pressure: NDArray[np.float64], *, duration: float) -> "PressureProgram":
        """Return the program of these rows; a row that repeats the one before it is dropped."""
        changed = np.concatenate([[True], (pressure[1:] != pressure[:-1]).any(axis=1)])
        return cls(time[changed], pressure[changed], duration)

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, channels) Pa in force just after each of `times` [s]."""
        row = np.searchsorted(self.time, np.asarray(times) + 1e-9, side="right") - 1
        return self.pressure[np.clip(row, 0, None)]

    def means(self, edges: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n - 1, channels) Pa: means between every two of the instants `edges` (n,) s, rising; none before t =
        0."""
        held = self.pressure[:-1] * np.diff(self.time)[:, None]
        until = np.concatenate([np.zeros((1, self.pressure.shape[1])), np.cumsum(held, axis=0)])  # integral to each row
        t = np.maximum(edges, 0.0)
        row = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, None)
        integral = until[row] + self.pressure[row] * (t - self.time[row])[:, None]
        return np.asarray(np.diff(integral, axis=0) / np.diff(edges)[:, None])


def regulated(pressures: NDArray[np.float64], resolution: float = RESOLUTION) -> NDArray[np.float64]:
    """Return pressures as a regulator takes them, whole `resolution` Pa; never above, since a limit may lie there."""
    return np.asarray(resolution * np.floor(pressures / resolution + 1e-6))


def rising_program(last: NDArray[np.float64], rise: float, duration: float) -> PressureProgram:
    """Return a program whose channels rise linearly and together from 0 to `last` (channels,) Pa within `rise` s, in
    RISE_STEPS rows of whole RESOLUTION Pa, then hold until `duration` s."""
    share = (np.arange(RISE_STEPS) + 1) / RISE_STEPS
    rows = np.outer(share, last)
    rows[:-1] = RESOLUTION * np.round(rows[:-1] / RESOLUTION)
    return PressureProgram(rise * np.arange(RISE_STEPS) / RISE_STEPS, rows, duration)


def sequence_program(rows: NDArray[np.float64], rise: float, hold: float) -> PressureProgram:
    """Return a program from 0 to each of `rows` (k, channels) Pa in turn, linearly within `rise` s in RISE_STEPS rows,
    and `hold` s at each."""
    share = (np.arange(RISE_STEPS) + 1)[:, None] / RISE_STEPS
    before = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    steps = np.concatenate([a + share * (b - a) for a, b in zip(before, rows, strict=True)])
    begins = np.arange(len(rows))[:, None] * (rise + hold)
    times = (begins + rise * np.arange(RISE_STEPS) / RISE_STEPS).ravel()
    return PressureProgram(times, steps, len(rows) * (rise + hold))


def limits(design: "Design") -> NDArray[np.float64]:
    """Return (channels,) Pa: the lowest maximum of the muscle types on each channel, 1,000 kPa where none is stated."""
    most = np.full(design.channels, LARGEST)
    for muscle in design.muscles:
        stated = design.muscle_types[muscle.type].max_pressure
        if stated is not None:
            most[muscle.channel] = min(most[muscle.channel], stated)
    return most


def in_words(pressures: NDArray[np.float64]) -> str:
    """Return pressures (channels,) Pa for people: "channel 0: 312 kPa, channel 1: 0 kPa"."""
    return ", ".join(f"channel {k}: {in_kpa(value):.0f} kPa" for k, value in enumerate(pressures))


def poses_in_words(pressures: Sequence[NDArray[np.float64]]) -> list[str]:
    """Return a line for the final pressures of each pose, (channels,) Pa."""
    several = len(pressures) > 1
    return [
        f"pressures{f' of pose {pose}' if several else ''}: {in_words(row)}"
        for pose, row in enumerate(pressures, start=1)
        if len(row)
    ]


def require_pressures(program: PressureProgram, design: "Design", where: str) -> None:
    """Raise InputError unless the program has one pressure for each channel of the design, all of them from 0 Pa to
    the muscles' maximum."""
    given = program.pressure.shape[1]
    if given < design.channels:
        raise InputError(
            f"{where}: channel {given} has no pressure; expected {design.channels} channels for design {design.name}"
        )
    if given > design.channels:
        raise InputError(
            f"{where}: pressures for {given} channels; expected {design.channels} channels for design {design.name}"
        )
    for channel, most in enumerate(limits(design)):
        values = program.pressure[:, channel]
        if np.isnan(values).any() or (values < 0).any():
            worst = "NaN" if np.isnan(values).any() else f"{in_kpa(values.min()):g} kPa"
            raise InputError(f"{where}: channel {channel} has pressure {worst}; expected kPa from 0")
        if (values > most).any():
            raise InputError(
                f"{where}: channel {channel} has pressure {in_kpa(values.max()):g} kPa; "
                f"expected at most {in_kpa(most):g} kPa, the muscle's maximum"
            )


HIGHEST = 300e3  # Pa, of programs that nobody named, where the muscles allow it
# one number, or [lowest, highest] as in [limits]
_HIGHEST = Key(
    form=Annotated[Kilopascal, ABOVE_0] | tuple[Kilopascal, Kilopascal],
    read=lambda value, _: value[1] if isinstance(value, tuple) else value,
)


@dataclass(frozen=True)
class RigLimits:
    """The limits that next experiments keep."""

    pressure: Annotated[Kilopascal, _HIGHEST, "of programs that nobody named"] = HIGHEST
    rate: Annotated[KilopascalPerSecond, ABOVE_0, "of a set point; absent: steps are possible"] = np.inf  # Pa/s
    duration: Annotated[Second, Within(above=0, most=LONGEST), "of a program"] = 3.0
    channels: Annotated[int | None, Within(least=1), "of pressure; absent: any"] = None
    cycle: Annotated[Second, Within(least=0.005, most=1), "of the regulator: a set point holds for so long"] = 0.05
    resolution: Annotated[Kilopascal, Within(least=0.001, most=100), "of a set point"] = 100.0  # Pa
    delay: Annotated[Second, Within(least=0, most=1), "from a set point to the valve"] = 0.0
    supply: Annotated[Kilopascal | None, ABOVE_0, "pressure before the regulator; absent: enough"] = None  # Pa


USUAL_LIMITS = RigLimits()


@dataclass(frozen=True)
class LearnedRange:
    """The farthest of several pressure programs, each quantity by itself."""

    pressure: Annotated[Kilopascal, FROM_0, "the highest set point"]  # Pa
    rate: Annotated[KilopascalPerSecond, FROM_0, "the fastest change of the mean over 0.1 s to the next"]  # Pa/s
    channels: Annotated[int, FROM_0, "that had pressure at once"]

    @staticmethod
    def of(programs: Iterable[PressureProgram]) -> "LearnedRange":
        """Return the range of one program or more."""
        each = [
            (float(p.pressure.max(initial=0.0)), _rate(p), int((p.pressure > 0).sum(axis=1).max(initial=0)))
            for p in programs
        ]
        pressure, rate, channels = (max(values) for values in zip(*each, strict=True))
        return LearnedRange(pressure, rate, channels)

    def beyond(self, programs: Sequence[PressureProgram]) -> str | None:
        """Return a sentence on what of these programs was not learned from; None where all was."""
        asked = LearnedRange.of(programs) if programs else self
        parts = []
        if asked.pressure > (1 + _SLIGHT) * self.pressure:
            parts.append(f"pressures {_up_to(asked.pressure, 'kPa')}; learned from {_up_to(self.pressure, 'kPa')}")
        if asked.rate > (1 + _SLIGHT) * self.rate:
            parts.append(f"rates {_up_to(asked.rate, 'kPa/s')}; learned from {_up_to(self.rate, 'kPa/s')}")
        if asked.channels > self.channels:
            parts.append(f"up to {asked.channels} channels at once; learned from up to {self.channels}")
        return f"beyond what the model has learned: {', '.join(parts)}" if parts else None


def _rate(program: PressureProgram) -> float:
    around = [program.means(np.array([t - WINDOW, t, t + WINDOW])) for t in program.time]
    return max((float(np.abs(np.diff(means, axis=0)).max(initial=0.0)) / WINDOW for means in around), default=0.0)


def _up_to(value: float, unit: str) -> str:
    """Return a bound in words. value: in pascals, or pascals a second."""
    return f"up to {in_kpa(value):.0f} {unit}"

"""Pressure programs: the regulator's set points over time, what a rig can do, and how far the programs went that a
model was fitted to."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.schema import ABOVE_0, FROM_0, Key, Kilopascal, KilopascalPerSecond, Second, Within
from fabdesign.nouns.array import Array
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

    time: Array
    pressure: Array
    duration: float

    @classmethod
    def of_rows(cls, time: Array, pressure: Array, *, duration: float) -> "PressureProgram":
        """Return the program of these rows; a row that repeats the one before it is dropped."""
        changed = np.concatenate([[True], (pressure[1:] != pressure[:-1]).any(axis=1)])
        return cls(time[changed], pressure[changed], duration)

    def at(self, times: Array) -> Array:
        """Return (n, channels) Pa in force just after each of `times` [s]."""
        row = np.searchsorted(self.time, np.asarray(times) + 1e-9, side="right") - 1
        return self.pressure[np.clip(row, 0, None)]

    def means(self, edges: Array) -> Array:
        """Return (n - 1, channels) Pa: means between every two of the instants `edges` (n,) s, rising; none before t =
        0."""
        held = self.pressure[:-1] * np.diff(self.time)[:, None]
        until = np.concatenate([np.zeros((1, self.pressure.shape[1])), np.cumsum(held, axis=0)])  # integral to each row
        t = np.maximum(edges, 0.0)
        row = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, None)
        integral = until[row] + self.pressure[row] * (t - self.time[row])[:, None]
        return np.asarray(np.diff(integral, axis=0) / np.diff(edges)[:, None])


def regulated(pressures: Array, resolution: float = RESOLUTION) -> Array:
    """Return pressures as a regulator takes them, whole `resolution` Pa; never above, since a limit may lie there."""
    return np.asarray(resolution * np.floor(pressures / resolution + 1e-6))


def slewed(rows: Array, change: float, resolution: float = RESOLUTION) -> Array:
    """Return rows (k, channels) Pa that follow others from rest on, changing by at most `change` Pa from each to the
    next, in whole `resolution` Pa, of which one is always possible."""
    most = float(regulated(np.asarray(max(change, resolution)), resolution))
    kept, before = np.empty_like(rows), np.zeros(rows.shape[1])
    for row, wanted in zip(kept, rows, strict=True):
        row[:] = before = np.clip(wanted, before - most, before + most)
    return kept


def rising_program(last: Array, rise: float, duration: float) -> PressureProgram:
    """Return a program whose channels rise linearly and together from 0 to `last` (channels,) Pa within `rise` s, then
    hold until `duration` s."""
    return replace(sequence_program(last[None], rise, 0.0), duration=duration)


def sequence_program(rows: Array, rise: float, hold: float) -> PressureProgram:
    """Return a program from 0 to each of `rows` (k, channels) Pa in turn, linearly within `rise` s in RISE_STEPS rows,
    and `hold` s at each. What lies between is regulated."""
    share = (np.arange(RISE_STEPS) + 1)[:, None] / RISE_STEPS
    before = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    steps = regulated(before[:, None] + share * (rows - before)[:, None])
    steps[:, -1] = rows
    begins = np.arange(len(rows))[:, None] * (rise + hold)
    times = (begins + rise * np.arange(RISE_STEPS) / RISE_STEPS).ravel()
    return PressureProgram(times, np.concatenate(steps), len(rows) * (rise + hold))


def limits(design: "Design") -> Array:
    """Return (channels,) Pa: the lowest maximum of the muscle types on each channel, 1,000 kPa where none is stated."""
    most = np.full(design.channels, LARGEST)
    for muscle in design.muscles:
        stated = design.muscle_types[muscle.type].max_pressure
        if stated is not None:
            most[muscle.channel] = min(most[muscle.channel], stated)
    return most


def poses_in_words(pressures: Sequence[Array]) -> list[str]:
    """Return a line for the final pressures of each pose, (channels,) Pa: "channel 0: 312 kPa, channel 1: 0 kPa"."""
    lines = []
    for pose, row in enumerate(pressures, start=1):
        channels = ", ".join(f"channel {k}: {in_kpa(value):.0f} kPa" for k, value in enumerate(row))
        lines += [f"pressures{f' of pose {pose}' if len(pressures) > 1 else ''}: {channels}"] if len(row) else []
    return lines


def require_pressures(program: PressureProgram, design: "Design", where: str) -> None:
    """Raise InputError unless the program has one pressure for each channel of the design, all of them from 0 Pa to
    the muscles' maximum."""
    given = program.pressure.shape[1]
    if given != design.channels:
        what = f"channel {given} has no pressure" if given < design.channels else f"pressures for {given} channels"
        raise InputError(f"{where}: {what}; expected {design.channels} channels for design {design.name}")
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
    resolution: Annotated[Kilopascal, Within(least=0.001, most=100), "of a set point"] = RESOLUTION  # Pa
    delay: Annotated[Second, Within(least=0, most=1), "from a set point to the valve"] = 0.0
    supply: Annotated[Kilopascal | None, ABOVE_0, "pressure before the regulator; absent: enough"] = None  # Pa


USUAL_LIMITS = RigLimits()


def standard_programs(design: "Design", rig: RigLimits = USUAL_LIMITS) -> dict[str, PressureProgram]:
    """Return steps, staircases and ramps within the limits of the muscles and the rig: every channel alone in turn, one
    face, the other, all. Levels hold for LEAST_HOLD s, as far as the rig's duration allows it."""
    most, seconds = np.minimum(limits(design), rig.pressure), rig.duration
    levels, count = max(1, int(seconds / LEAST_HOLD)), len(most)
    stairs = 2 * int(np.clip(levels // 2, 2, 3))
    on = {(m.channel, m.side) for m in design.muscles}
    faces = {s: np.array([(c, s) in on for c in range(design.channels)]) for s in ("front", "back")}
    groups = {f"the {side}": where for side, where in faces.items() if where.any()}
    candidates: dict[str, PressureProgram] = {}
    for named, where in groups.items():
        p = np.where(where, most, 0.0)
        candidates[f"step of {named}, held"] = _rows([0.0], [p], seconds)
        candidates[f"step of {named} on and off"] = _rows([0.0, seconds / 2], [p, 0 * p], seconds)
        shares = 1 - np.abs(2 * np.arange(1, stairs + 1) / stairs - 1)
        times = np.arange(stairs) * seconds / stairs
        candidates[f"staircase of {named}, up and down"] = _rows(times, shares[:, None] * p, seconds)
        times = np.arange(60) * seconds / 60
        candidates[f"slow ramp of {named}, up and down"] = _rows(
            times, (1 - np.abs(times / seconds * 2 - 1))[:, None] * p, seconds
        )
    for channels in np.array_split(np.arange(count), -(-count // levels)) if count else ():
        which = "each channel" if count <= levels else f"channels {', '.join(map(str, channels))}"
        times = np.arange(len(channels)) * seconds / len(channels)
        candidates[f"{which} alone in turn"] = _rows(times, np.diag(most)[channels], seconds)
    both = np.tril(np.ones((count, count))) * most * 0.7
    candidates["one channel more at a time"] = _rows(np.arange(count) * seconds / count, both, seconds)
    return {name: program for name, program in candidates.items() if fastest(program) <= rig.rate * (1 + 1e-9)}


def fastest(program: PressureProgram) -> float:
    """Return the largest change of a set point over the time to the next, Pa/s; infinite for a step at 0 s."""
    if program.pressure[0].any():
        return float("inf")
    if len(program.time) < 2:
        return 0.0
    return float((np.abs(np.diff(program.pressure, axis=0)).max(axis=1) / np.diff(program.time)).max())


def _rows(times: Any, pressures: Any, seconds: float) -> PressureProgram:
    return PressureProgram(np.asarray(times, dtype=float), np.atleast_2d(np.asarray(pressures, dtype=float)), seconds)


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

"""How far the pressures went that a model's learned coefficients were fitted to: beyond it they are extrapolated."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fabdesign.formats.schema import FROM_0, Kilopascal, KilopascalPerSecond
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.units import in_kpa

WINDOW = 0.1  # s, over which a set point's rate is taken: the shorter of the lags that are learned
_SLIGHT = 1e-3  # of a number, that does not count as beyond it


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

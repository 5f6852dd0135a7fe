"""The findings of `check` on one file or folder, and plausible ranges of parts of cloth and muscle: values beyond them
are possible, and most likely slips.

Ranges are published and measured figures, widened about tenfold where parts differ much. Swimwear knit: 0.20 kg/m^2,
48 to 105 N/m, bending 60 uN m. Elastic tape: 0.3 to 0.6 kg/m^2, 150 to 1000 N/m along and much more across, bending
1e-4 to 1e-3 N m, more with muscles laced in (0.006 on the synthetic rigs). Thin McKibben muscles (EM20): 2 mm,
recommended 300 kPa, at most about 500. A braid shortens until its angle is 54.7 degrees, from 15 by
1 - cos 54.7 / cos 15 = 40 %, and its blocked force is p pi r^2 (3 / tan^2 a - 1 / sin^2 a) at an angle
a (Tondu and Lopez 2000, doi:10.1109/37.833638).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

from fabdesign.errors import InputError


@dataclass(frozen=True)
class Findings:
    """A line each. problems: what a command refuses or a workshop cannot make; warnings: what is implausible; notes:
    what was left out, or read otherwise than as the format has it."""

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    json_keys: ClassVar = "sound", "problems", "warnings", "notes"

    @property
    def sound(self) -> bool:
        return not self.problems

    @staticmethod
    def warned(where: object, lines: Iterable[str]) -> "Findings":
        """Return warnings on a file, or a part of one."""
        return Findings(warnings=tuple(f"{where}: {line}" for line in lines))

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


@dataclass(frozen=True)
class Range:
    """Plausible values, in the unit that files have. slips: what a value would be multiplied by if it stood in another
    unit, and that unit's name."""

    low: float
    high: float
    unit: str
    what: str
    slips: tuple[tuple[float, str], ...] = ()
    shown: float = 1.0  # files' units in one of the code's


_MILLI, _STIFF, _BEND = ((1e-3, "mm"),), ((1e3, "N/mm"), (1e-3, "mN/m")), ((1e-3, "N mm"), (1e-6, "uN m"))
_KILOPASCAL = ((1e3, "MPa"), (100.0, "bar"), (1e-3, "Pa"))
FABRIC: Mapping[str, Range] = {
    "width": Range(0.02, 2.0, "m", "cloth", _MILLI),
    "height": Range(0.02, 2.0, "m", "cloth", _MILLI),
    "thickness": Range(5e-5, 0.01, "m", "cloth", _MILLI),
    "areal_density": Range(0.02, 5.0, "kg/m^2", "cloth", ((1e-3, "g/m^2"),)),
    "membrane_stiffness": Range(10.0, 1e5, "N/m", "cloth", _STIFF),
    "shear_stiffness": Range(1.0, 5e4, "N/m", "cloth", _STIFF),
    "poisson": Range(-0.5, 1.0, "", "cloth"),
    "bending_stiffness": Range(1e-6, 0.1, "N m", "cloth", _BEND),
    "twist_stiffness": Range(0.0, 0.1, "N m", "cloth", _BEND),
    "viscosity": Range(0.0, 200.0, "N s/m", "cloth"),
    "air_damping": Range(0.0, 20.0, "N s/m^3", "air"),
}
MUSCLE_TYPE: Mapping[str, Range] = {
    "outer_diameter": Range(5e-4, 0.02, "m", "thin muscles", _MILLI),
    "mass_per_length": Range(2e-4, 0.2, "kg/m", "thin muscles", ((1e-3, "g/m"),)),
    "axis_offset": Range(1e-5, 0.02, "m", "laced muscles", _MILLI),
    "viscosity": Range(0.0, 500.0, "N s", "thin muscles"),
    "max_pressure": Range(30.0, 1000.0, "kPa", "thin muscles", _KILOPASCAL, 1e-3),
    "stock_length": Range(0.02, 100.0, "m", "muscles", _MILLI),
    "min_bend_radius": Range(0.0, 0.2, "m", "thin muscles", _MILLI),
    "tail_length": Range(0.0, 0.5, "m", "muscles", _MILLI),
}
GRAVITY = Range(9.7, 9.9, "m/s^2", "the earth")
FREE_CONTRACTION = Range(0.02, 0.42, "", "thin muscles at their highest pressure", ((1e-2, "%"),))
PRESSURE = Range(10.0, 1000.0, "kPa", "thin muscles", _KILOPASCAL, 1e-3)
FACTOR = Range(0.2, 5.0, "", "a factor on a data sheet")
# blocked force over pressure times cross-section: 27 at 15 degrees, and as much as half of it from the tube
BLOCKED = Range(0.3, 40.0, "", "braids of 15 degrees or more")


def beyond(name: str, value: float | tuple[float, ...] | None, expected: Range) -> Iterator[str]:
    """Yield a line where a value, in SI, lies outside its range, with the unit that it may be in; a pair counts as
    one."""
    if value is None:
        return
    for number in value if isinstance(value, tuple) else (value,):
        shown = number * expected.shown
        if expected.low <= shown <= expected.high:
            continue
        unit = f" {expected.unit}" if expected.unit else ""
        meant = next((u for by, u in expected.slips if expected.low <= shown * by <= expected.high), None)
        hint = f" (is it in {meant}?)" if meant else ""
        yield f"{name} = {shown:g}{unit}; {expected.what}: {expected.low:g} to {expected.high:g}{unit}{hint}"
        return

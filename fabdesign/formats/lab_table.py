"""Tables as laboratories write them: columns found by what they measure, values taken to SI by their units.

A heading says its quantity and unit, as in `pressure_kpa`, `Druck [bar]` or `force / N`, or a row below the header says
the units. What is written otherwise than this program writes it is said in one line; what could mean two things is
refused, and so is what was surely measured in another unit.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.errors import InputError, note
from fabdesign.formats.csv_table import decimal, read_raw_table
from fabdesign.units import in_kpa

# s between frames. 60 Hz in milliseconds is 17 "s"; a creep test that takes a frame every 5 s still passes.
_SLOWEST = 8.0
# Pa. A regulator resolves 100 Pa and a thin muscle does nothing below some 50 kPa; 400 kPa in MPa is 0.4 "kPa".
_LEAST = 1e3
_MOST = 2e7  # Pa, fifty times what a thin McKibben muscle bears: kPa that were pascals are above it
Dimension = Literal["pressure", "force", "length", "time", "ratio", "tension", "voltage"]


@dataclass(frozen=True)
class Unit:
    dimension: Dimension
    factor: Decimal  # to Pa, N, m, s, 1, N/m, V


_HEADINGS = json.loads(files("fabdesign").joinpath("data", "headings.json").read_text(encoding="utf-8"))
UNITS: Mapping[str, Unit] = {
    symbol: Unit(dimension, Decimal(factor))
    for dimension, factors in _HEADINGS["units"].items()
    for symbol, factor in factors.items()
}
_AS_WRITTEN = {"MN", "mPa"}  # another thing than their lower case
WORDS: Mapping[str, Sequence[str]] = {name: each["words"] for name, each in _HEADINGS["quantities"].items()}
DIMENSIONS: Mapping[str, Dimension] = {name: each["dimension"] for name, each in _HEADINGS["quantities"].items()}
_CHANNEL = re.compile(r"(?:channel|kanal|canal|ch|valve|ventil)_?(\d+)")
# of a pressure, which files have as gauge pressure; a vacuum's sign is the other one
_ABSOLUTE = re.compile(r"(?:^|[\W_])p?abs(?:ol\w*)?(?:[\W_]|\d|$)")
_VACUUM = re.compile(r"vacuum|vakuum|unterdruck|suction|below_atm")
_NUMBERED = re.compile(r"\D*?_?(\d+)")
_BRACKETED = re.compile(r"(.*?)[\s_]*[\[(]([^\[\]()]*)[\])]\s*$")
_SLASHED = re.compile(r"(.*\S)\s+/\s+(\S+)\s*$")
_LAST_WORD = re.compile(r"(.*\S)[\s_]+(\S+)$")
_IN = re.compile(r"\s+in$")


@dataclass(frozen=True)
class Heading:
    text: str  # as it stands in the file
    name: str  # without unit, in lower case, words joined by _
    symbol: str | None  # of the unit

    @property
    def unit(self) -> Unit | None:
        return None if self.symbol is None else unit_of(self.symbol)

    @property
    def quantity(self) -> str | None:
        """Return what it measures, by its name and, of a name of several, its unit: `pressure`, `channel_0`, ..."""
        if matched := _CHANNEL.fullmatch(self.name):
            return f"channel_{int(matched[1])}"
        unit = self.unit
        fitting = (q for q, words in WORDS.items() if self.name in words)
        return next((q for q in fitting if unit is None or unit.dimension == DIMENSIONS[q]), None)

    @property
    def number(self) -> int | None:
        """Return the number at the end of its name, as in `p1` or `muscle 3`."""
        matched = _NUMBERED.fullmatch(self.name)
        return None if matched is None else int(matched[1][:9])


def dimension_of(quantity: str) -> Dimension:
    """Return what `pressure`, `channel_0`, ... is measured in."""
    return DIMENSIONS[quantity.rstrip("0123456789").rstrip("_")]


def without_unit(text: str, dimension: Dimension) -> str:
    """Return what is said of a heading that lacks its unit."""
    example = next(symbol for symbol, unit in UNITS.items() if unit.dimension == dimension)
    return f"{text} has no unit; write it in the heading, such as {text} [{example}]"


def unit_of(symbol: str) -> Unit | None:
    symbol = symbol.strip()
    if symbol in _AS_WRITTEN:
        return None
    return UNITS.get(symbol) or UNITS.get(symbol.lower())


def parse_heading(text: str) -> Heading:
    """Return the name, and the unit where one is written: in brackets, after a slash, or as the last word."""
    text = text.strip().strip('"').strip()
    if text.lower().endswith("_n_per_m"):
        return Heading(text, _plain(text[: -len("_n_per_m")]), "n_per_m")
    if matched := _BRACKETED.match(text):
        return Heading(text, _plain(matched[1]), matched[2].strip() or "-")
    for pattern in (_SLASHED, _LAST_WORD):
        matched = pattern.match(text)
        if matched and not matched[2].isdecimal() and unit_of(matched[2]) is not None:
            return Heading(text, _plain(_IN.sub("", matched[1])), matched[2])
    return Heading(text, _plain(text), None)


def parse_units_row(cells: list[str]) -> list[str] | None:
    """Return the symbols in a row of units below the header ("psi", "[%]", nothing); None where it is no such row."""
    symbols = [cell.strip().strip('"').strip("[]() ") for cell in cells]
    known = [unit_of(symbol) is not None and not symbol.isdecimal() for symbol in symbols]
    return symbols if any(known) and all(k or not s for k, s in zip(known, symbols, strict=True)) else None


def _plain(name: str) -> str:
    return re.sub(r"[\s_\-]+", "_", name.strip().lower()).strip("_")


class LabTable:
    """A table with its headings understood; a column is known by its place. `expected` goes into the messages: the
    format's own columns."""

    def __init__(self, path: Path, expected: str) -> None:
        raw = read_raw_table(path)
        self.path, self.header, self.rows, self._expected = path, raw.header, raw.rows, expected
        self.headings = [parse_heading(text) for text in raw.header]
        self._written = raw.written
        self.taken: dict[int, str] = {}  # place of a column -> quantity
        self.factors: dict[int, Decimal] = {}  # place of a column -> to SI
        self._units_row = parse_units_row(self.rows[0][1])
        if self._units_row is not None:
            self.headings = [self._with(*each) for each in zip(self.headings, self._units_row, strict=True)]
            self.rows = self.rows[1:]
            if not self.rows:
                raise InputError(f"{path}: has a header and units but no rows")

    def _with(self, heading: Heading, symbol: str) -> Heading:
        if symbol and heading.symbol not in (None, symbol):
            raise InputError(f"{self.path}: {heading.text} has the unit {symbol} in the row below; expected one unit")
        return replace(heading, symbol=heading.symbol or symbol or None)

    def find(self, quantity: str, *, default: Decimal | None = None) -> int:
        """Return the place of a quantity's column, by its name, or as the only one with such a unit. default: the
        factor of one without a unit. Raises InputError for none, two, or one without a unit or with another's."""
        words, named, unnamed = WORDS.get(quantity, ()), [], []
        for i, heading in enumerate(self.headings):
            is_of = heading.unit is not None and heading.unit.dimension == dimension_of(quantity)
            if (is_of or heading.unit is None) and (heading.quantity == quantity or heading.name in words):
                named.append(i)
            elif is_of and heading.quantity is None and i not in self.taken:
                unnamed.append(i)
        if len(named := named or unnamed) != 1:
            raise self.bad(f"{len(named) or 'no'} column{'s hold' if named else ' holds'} the {quantity}")
        return self.take(named[0], quantity, default=default)

    def take(self, index: int, quantity: str, *, default: Decimal | None = None) -> int:
        """Take the column at a place as that quantity; return the place. Raises InputError like `find`."""
        heading, dimension = self.headings[index], dimension_of(quantity)
        unit = heading.unit
        if unit is None and heading.symbol is not None:
            raise self.bad(f"{heading.text} has the unit {heading.symbol}")
        if unit is None and default is None and dimension != "ratio":
            raise self.bad(without_unit(heading.text, dimension))
        if unit is not None and unit.dimension != dimension:
            raise self.bad(f"{heading.text} has the unit {heading.symbol}")
        if dimension == "pressure" and _ABSOLUTE.search(heading.name):
            raise self.bad(f"{heading.text} is an absolute pressure; all pressures are gauge pressures")
        if dimension == "pressure" and _VACUUM.search(heading.name):
            raise self.bad(f"{heading.text} is a vacuum; all pressures are gauge pressures from 0")
        self.taken[index] = quantity
        self.factors[index] = unit.factor if unit is not None else default or Decimal(1)
        return index

    def bad(self, what: str) -> InputError:
        expected = f"expected {self._expected}, or headings with units, as pressure [bar]"
        return InputError(f"{self.path}: columns are {','.join(self.header)}; {expected} ({what})")

    def numbers(self, index: int) -> NDArray[np.float64]:
        """Return the column (n,), SI. Raises InputError for what is no number."""
        text, factor = self.headings[index].text, self.factors[index]
        return np.array([float(decimal(row[index], self.path, i, text) * factor) for i, row in self.rows])

    def text(self, index: int, row: int) -> str:
        """Return a number as it is written, with its heading."""
        return f"{self.headings[index].text} = {self.rows[row][1][index]}"

    def refuse(self, bad: NDArray[np.bool_], say: Callable[[int], str]) -> None:
        """Raise InputError for the first row that is bad, with its line."""
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(f"{self.path} line {self.rows[row][0]}: {say(row)}")

    def require_rising(self, name: str, values: NDArray[np.float64], rows: NDArray[np.intp] | None = None) -> None:
        """Raise InputError where values do not rise from row to row, or to the next one of some rows."""
        some = np.arange(len(values)) if rows is None else rows
        falls = np.isin(np.arange(len(values)), some[1:][np.diff(values[some]) <= 0])
        self.refuse(falls, lambda row: f"{name} = {values[row]:g} does not rise from the row before")

    def say(self, usual: Sequence[str]) -> None:
        """Say in one line how the table was read, unless it is written as this program writes it (the `usual`
        header)."""
        if list(usual) == self.header and self._written is None and self._units_row is None:
            return
        read = [f"{self._shown(i)} as {quantity}" for i, quantity in sorted(self.taken.items())]
        untaken = [h.text or "a column without a heading" for i, h in enumerate(self.headings) if i not in self.taken]
        parts = [f"written with {self._written}"] if self._written else []
        parts += (["read " + ", ".join(read)] if read else []) + (
            ["left " + ", ".join(untaken)] if untaken and read else []
        )
        note(f"{self.path}: {'; '.join(parts)}")

    def _shown(self, index: int) -> str:
        heading = self.headings[index]
        return f"{heading.text} in {heading.symbol}" if self._units_row and self._units_row[index] else heading.text


def require_seconds(time: ArrayLike, where: str) -> None:
    """Raise InputError where frames lie so far apart that their times [s] were surely milliseconds."""
    seconds = np.atleast_1d(np.asarray(time, dtype=np.float64))
    if len(seconds) < 2:
        return
    interval = float(np.median(np.diff(seconds)))
    if interval >= _SLOWEST:
        unit = "microseconds" if interval >= 1e3 * _SLOWEST else "milliseconds"
        raise InputError(f"{where}: time has a frame every {interval:.4g} s; expected seconds (is it in {unit}?)")


def require_measured_pressures(pressure: ArrayLike, where: str) -> None:
    """Raise InputError where the largest of measured pressures [Pa] shows that they were not written in kPa."""
    largest = float(np.max(np.asarray(pressure, dtype=np.float64), initial=0.0))
    if 0 < largest <= _LEAST or largest >= _MOST:
        unit = "Pa" if largest >= _MOST else "MPa"
        raise InputError(f"{where}: the largest pressure is {in_kpa(largest):.6g} kPa; expected kPa (is it in {unit}?)")

"""Tables as laboratories write them: columns found by what they measure, values taken to SI by their units.

A heading says its quantity and unit (`pressure_kpa`, `Druck [bar]`), or a row below the header says the units. What is
written otherwise than this program writes it is said in one line; what could mean two things is refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

from fabdesign.errors import InputError, note
from fabdesign.formats.csv_table import decimal, read_raw_table
from fabdesign.formats.headings import WORDS, Heading, dimension_of, parse_heading, parse_units_row, without_unit

_HINT = "or headings with units, as pressure [bar]"


@dataclass(frozen=True)
class TableColumn:
    index: int
    heading: Heading
    factor: Decimal  # to SI


class LabTable:
    """A table with its headings understood. `expected` goes into the messages: the format's own columns."""

    def __init__(self, path: Path, expected: str) -> None:
        raw = read_raw_table(path)
        self.path, self.header, self.rows, self._expected = path, raw.header, raw.rows, expected
        self.headings = [parse_heading(text) for text in raw.header]
        self._written = raw.written
        self.taken: dict[int, str] = {}  # place of a column -> quantity
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

    def find(self, quantity: str, *, default: Decimal | None = None) -> TableColumn:
        """Return the column of a quantity, by its name, or as the only one with such a unit. default: the factor of one
        without a unit. Raises InputError for none, two, or one without a unit or with another quantity's."""
        dimension = dimension_of(quantity)
        named = [i for i, h in enumerate(self.headings) if self._is(h, quantity)]
        if not named:
            units = [h.unit for h in self.headings]
            named = [
                i
                for i, (h, unit) in enumerate(zip(self.headings, units, strict=True))
                if unit is not None and unit.dimension == dimension and h.quantity is None and i not in self.taken
            ]
        if len(named) != 1:
            what = f"{len(named)} columns hold the {quantity}" if named else f"no column holds the {quantity}"
            raise self.bad(what)
        (index,) = named
        return self.take(index, quantity, default=default)

    def take(self, index: int, quantity: str, *, default: Decimal | None = None) -> TableColumn:
        """Return the column at a place as that quantity. Raises InputError like `find`."""
        heading = self.headings[index]
        dimension = dimension_of(quantity)
        unit = heading.unit
        if unit is None and heading.symbol is not None:
            raise self.bad(f"{heading.text} has the unit {heading.symbol}")
        if unit is None and default is None and dimension != "ratio":
            raise self.bad(without_unit(heading.text, dimension))
        if unit is not None and unit.dimension != dimension:
            raise self.bad(f"{heading.text} has the unit {heading.symbol}")
        if dimension == "pressure" and heading.is_absolute:
            raise self.bad(f"{heading.text} is an absolute pressure; all pressures are gauge pressures")
        if dimension == "pressure" and heading.is_vacuum:
            raise self.bad(f"{heading.text} is a vacuum; all pressures are gauge pressures from 0")
        self.taken[index] = quantity
        return TableColumn(index, heading, unit.factor if unit is not None else default or Decimal(1))

    def take_volts(self, index: int) -> TableColumn:
        """Return the column at a place, which has a unit of voltage, in V."""
        unit = self.headings[index].unit
        assert unit is not None
        self.taken[index] = "voltage"
        return TableColumn(index, self.headings[index], unit.factor)

    @staticmethod
    def _is(heading: Heading, quantity: str) -> bool:
        if heading.quantity != quantity and heading.name not in WORDS.get(quantity, ()):
            return False
        dimension = dimension_of(quantity)
        return heading.unit is None or heading.unit.dimension == dimension

    def bad(self, what: str) -> InputError:
        columns = ",".join(self.header)
        return InputError(f"{self.path}: columns are {columns}; expected {self._expected}, {_HINT} ({what})")

    def cells(self, column: TableColumn) -> Iterator[tuple[int, Decimal, Decimal]]:
        """Yield the line, the number as written, and in SI."""
        for line, row in self.rows:
            written = decimal(row[column.index], self.path, line, column.heading.text)
            yield line, written, written * column.factor

    def say(self, written: Sequence[str]) -> None:
        """Say in one line how the table was read, unless its header is that of this program's files (`written`)."""
        if list(written) == self.header and self._written is None and self._units_row is None:
            return
        read = [f"{self._shown(i)} as {quantity}" for i, quantity in sorted(self.taken.items())]
        left = [h.text or "a column without a heading" for i, h in enumerate(self.headings) if i not in self.taken]
        parts = [f"written with {self._written}"] if self._written else []
        parts += (["read " + ", ".join(read)] if read else []) + (["left " + ", ".join(left)] if left and read else [])
        note(f"{self.path}: {'; '.join(parts)}")

    def _shown(self, index: int) -> str:
        heading = self.headings[index]
        return f"{heading.text} in {heading.symbol}" if self._units_row and self._units_row[index] else heading.text

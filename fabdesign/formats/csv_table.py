"""Strict reading and whole writing of tables: a header line, then numbers.

Written with commas and decimal points; read with semicolons, tabs or blanks between the columns too, with decimal
commas, a byte order mark and comment lines (#).
"""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from decimal import Decimal, InvalidOperation
from math import isfinite
from pathlib import Path
from typing import NamedTuple

from fabdesign.errors import InputError, note
from fabdesign.formats.toml_file import LARGEST_TEXT, decode_any, read_bytes
from fabdesign.output import write_text

_MARKS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
_FORMULA = ("=", "+", "-", "@")
_WITH_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}[,.]\d{3}")  # as well a thousand as a decimal
_SEPARATOR_LINE = re.compile(r'\A"?sep=.?"?[ \t]*(?=[\r\n])', re.IGNORECASE)
_WITH_POINT = re.compile(r"[-+]?\d*\.\d*([eE][-+]?\d+)?")


class RawTable(NamedTuple):
    """A table's cells as texts, numbers with decimal points."""

    header: list[str]
    rows: list[tuple[int, list[str]]]  # with the line's number
    mark: str  # between columns
    decimal_comma: bool

    @property
    def written(self) -> str | None:
        """Return how it is written in words, where that is not as this program writes; else None."""
        if self.mark == "," and not self.decimal_comma:
            return None
        return _MARKS[self.mark] + (" and decimal commas" if self.decimal_comma else "")


def read_raw_table(path: Path) -> RawTable:
    """Return the cells as they stand, however the columns are separated. Raises InputError where a row has another
    width, where numbers have points in some cells and commas in others, and where commas may part thousands."""
    text = without_separator_line(decode_any(read_bytes(path, "a text file", largest=LARGEST_TEXT), path))
    mark = separator(next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), ""))
    try:
        rows = [(i, cells) for i, cells in _cells(text, mark) if any(cells) and not cells[0].startswith("#")]
    except csv.Error as error:
        raise InputError(f"{path}: is no sound table ({error})") from None
    if not rows:
        raise InputError(f"{path}: is empty; expected a header line and rows of numbers")
    (_, header), *rows = rows
    if not rows:
        raise InputError(f"{path}: has a header but no rows")
    for line, row in rows:
        if len(row) != len(header):
            raise InputError(f"{path} line {line}: {len(row)} values; the header names {len(header)} columns")
    commas, points = (
        next(((line, cell) for line, row in rows for cell in row if kind.fullmatch(cell)), None)
        for kind in (_WITH_COMMA, _WITH_POINT)
    )
    require_decimals(path, rows, mark, commas=commas is not None)
    if commas is not None:
        if points is not None:
            raise InputError(
                f"{path}: {commas[1]!r} in line {commas[0]} and {points[1]!r} in line {points[0]}; expected decimal "
                "points or decimal commas, not both"
            )
        rows = [(i, [c.replace(",", ".") if _WITH_COMMA.fullmatch(c) else c for c in row]) for i, row in rows]
    return RawTable(header, rows, mark, commas is not None)


def without_separator_line(text: str) -> str:
    """Return the text with an empty first line in the place of Excel's `sep=;`: the header shows the separator too."""
    return _SEPARATOR_LINE.sub("", text)


def is_number(cell: str) -> bool:
    """Return whether a text is a number as programs write it; Python also takes 1_000 and the digits of other
    scripts."""
    try:
        float(cell)
    except ValueError:
        return False
    return cell.isascii() and "_" not in cell


def require_decimals(path: Path, rows: Iterable[tuple[int, Sequence[str]]], mark: str | None, *, commas: bool) -> None:
    """Raise InputError where the commas, or else the points, in numbers may part thousands: where all have three digits
    behind them, and numbers without one stand in the same column, or commas stand where blanks or commas part the
    columns. Elsewhere semicolons or tabs say that they are decimal, and a note says how they are read."""
    parted = mark in (";", "\t")
    if not commas and not parted:
        return
    kind, first = _WITH_COMMA if commas else _WITH_POINT, None
    plain, columns = set(), set()
    for line, row in rows:
        for i, cell in enumerate(row):
            if kind.fullmatch(cell):
                if not _THOUSANDS.fullmatch(cell):
                    return  # it shows that the sign is decimal
                first = first or (f"{path} line {line}: {cell!r}", cell)
                columns.add(i)
            elif is_number(cell):
                plain.add(i)
    if first is None:
        return
    where, number = first
    if columns & plain or not parted:
        thousands, decimal = (number.replace("," if commas else ".", sign) for sign in ("", "."))
        raise InputError(
            f"{where} may be {thousands} or {decimal}; expected numbers that part no thousands, and semicolons between "
            "the columns with as many decimals in every number"
        )
    if commas:
        note(f"{where} is read as {number.replace(',', '.')}, and so are all commas")
    else:
        note(f"{where} is read with a decimal point, and so are all numbers")


def separator(header: str) -> str:
    """Return what stands between the columns of a header line: a semicolon, a tab, a comma or blanks."""
    for mark in (";", "\t", ","):
        if mark in header:
            return mark
    return " " if len(header.split()) > 1 and "[" not in header and "(" not in header else ","


def _cells(text: str, mark: str) -> Iterable[tuple[int, list[str]]]:
    if mark == " ":
        return ((i, line.split() or [""]) for i, line in enumerate(text.splitlines(), start=1))
    lines = csv.reader(io.StringIO(text), delimiter=mark)
    return ((lines.line_num, [cell.strip() for cell in row] or [""]) for row in lines)


def decimal(text: str, path: Path, line: int, column: str) -> Decimal:
    """Return a finite number, exactly as written; InputError otherwise."""
    try:
        value = Decimal(text if is_number(text) else "nan")
    except InvalidOperation:
        value = Decimal("nan")
    if not value.is_finite() or not isfinite(float(value)):
        raise InputError(f"{path} line {line}: {column} = {text!r}; expected a finite number")
    return value


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV whole or not at all. Floats are written so that they read back the same. A word that a spreadsheet
    would take for a formula has an apostrophe before it."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([_harmless(cell) for cell in row] for row in (header, *rows))
    write_text(path, text.getvalue())


def _harmless(cell: object) -> object:
    if not isinstance(cell, str) or not cell.lstrip().startswith(_FORMULA):
        return cell
    return cell if is_number(cell) else f"'{cell}"

"""Strict reading and whole writing of the CSV tables: a header line, then numbers."""

import csv
import io
from collections.abc import Iterable, Sequence
from decimal import Decimal, InvalidOperation
from math import isfinite
from pathlib import Path

from fabdesign.errors import InputError
from fabdesign.output import write_text
from fabdesign.table import read_text


def read_rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The header's names and every row with its line number; InputError where a row has another width."""
    lines = enumerate(csv.reader(io.StringIO(read_text(path))), start=1)
    try:
        rows = [(i, [cell.strip() for cell in row]) for i, row in lines if any(c.strip() for c in row)]
    except csv.Error as error:
        raise InputError(f"{path}: is no sound table ({error})") from None
    if not rows:
        raise InputError(f"{path}: is empty; expected a header line and rows of numbers")
    header = rows[0][1]
    if len(rows) == 1:
        raise InputError(f"{path}: has a header but no rows")
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise InputError(f"{path} line {line}: {len(row)} values; the header names {len(header)} columns")
    return header, rows[1:]


def decimal(text: str, path: Path, line: int, column: str) -> Decimal:
    """A finite number, exactly as written; InputError otherwise."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        value = Decimal("nan")
    if not isfinite(float(value)):
        raise InputError(f"{path} line {line}: {column} = {text!r}; expected a finite number")
    return value


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV whole or not at all. Floats are written so that they read back the same."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(path, text.getvalue())

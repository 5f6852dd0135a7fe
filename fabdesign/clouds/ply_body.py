"""The rows of a PLY, below its header, as columns: ascii and binary, lists of one length or of several.

An ascii element is taken as a binary one of float64, so that both are bytes in which rows follow one another.
"""

from dataclasses import dataclass, replace
from itertools import accumulate, chain
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.formats.bounded_file import require_few
from fabdesign.formats.csv_table import is_number

_TOGETHER = 65536  # lines that become numbers at once
_LONGEST_LIST = 10**9


@dataclass(frozen=True)
class Property:
    name: str
    kind: str  # numpy type without byte order
    count_kind: str | None = None  # of a list


@dataclass(frozen=True)
class Element:
    name: str
    count: int
    properties: tuple[Property, ...]


class PlyColumn(NamedTuple):
    """A property of all rows: the values one after another, and how many a row has."""

    values: NDArray[Any]
    lengths: NDArray[np.intp]


def refuse(path: Path, why: str) -> NoReturn:
    raise InputError(f"{path}: {why}; expected a sound PLY")


class Body:
    """The part of a file that follows the header. order: of bytes, "<" or ">"; "" for ascii."""

    def __init__(self, body: bytes, order: str, path: Path) -> None:
        self._body, self._order, self._path = body, order, path
        self._at = 0  # byte or, of an ascii body, line
        self._lines: list[str] = []
        if not order:
            require_few(body.count(b"\n"), path, "lines")
            text = body.decode("latin-1").replace("_", "?")  # Python takes 1_000 for a number
            self._lines = [line for line in text.splitlines() if line.strip()]

    def read(self, element: Element) -> dict[str, PlyColumn]:
        """Return the columns of the next element by their names. Raises InputError."""
        if self._order:
            starts = _starts(element, self._body, self._order, self._at)
            if len(starts) <= element.count:
                refuse(self._path, f"ends after {len(starts) - 1} of {element.count} {element.name} rows")
            self._at = int(starts[-1])
            return _columns(element, self._body, self._order, starts[:-1])
        body, widths = self._numbers(element)
        element = replace(
            element, properties=tuple(Property(p.name, "f8", p.count_kind and "f8") for p in element.properties)
        )
        starts, lines = _starts(element, body, "<", 0), 8 * np.array([0, *accumulate(widths)])
        if not np.array_equal(starts, lines):
            same = starts == lines[: len(starts)]
            row = int(np.argmin(same)) - 1 if not same.all() else len(starts) - 1
            refuse(self._path, f"{element.name} row {row} has {widths[row]} values; the header says others")
        return _columns(element, body, "<", starts[:-1])

    def _numbers(self, element: Element) -> tuple[bytes, list[int]]:
        """Return the next lines as float64, and how many each has."""
        lines = self._lines[self._at : self._at + element.count]
        if len(lines) < element.count:
            refuse(self._path, f"ends after {len(lines)} of {element.count} {element.name} rows")
        self._at += element.count
        parts, widths = bytearray(), list[int]()
        for first in range(0, len(lines), _TOGETHER):
            rows = [line.split() for line in lines[first : first + _TOGETHER]]
            widths += map(len, rows)
            try:
                parts += np.array([*map(float, chain.from_iterable(rows))], dtype="<f8").tobytes()
            except ValueError:
                row = next(i for i, row in enumerate(rows) if not all(map(is_number, row)))
                refuse(self._path, f"{element.name} row {first + row} is no row of numbers")
        return bytes(parts), widths

    def finish(self) -> None:
        """Raise InputError where something is left."""
        unread = (len(self._body) if self._order else len(self._lines)) - self._at
        if unread:
            refuse(self._path, f"has {unread} {'bytes' if self._order else 'rows'} more than its header says")


def _at_every_byte(body: bytes, kind: str) -> NDArray[Any]:
    """Return the value that would begin at each byte."""
    return np.ndarray(max(len(body) - np.dtype(kind).itemsize + 1, 0), kind, body, strides=(1,))


def _starts(element: Element, body: bytes, order: str, at: int) -> NDArray[np.intp]:
    """Return where the rows begin, with the end of the last; fewer where the body ends, or a list's length is none."""
    steps: list[
        tuple[int, NDArray[Any], int, int]
    ] = []  # bytes before a list's length, lengths, their bytes, a value's
    fixed = 0
    for p in element.properties:
        size = np.dtype(p.kind).itemsize
        if p.count_kind is None:
            fixed += size
        else:
            steps.append((fixed, _at_every_byte(body, order + p.count_kind), np.dtype(p.count_kind).itemsize, size))
            fixed = 0
    if not steps:
        rows = min(element.count, (len(body) - at) // fixed)
        return at + fixed * np.arange(rows + 1)
    starts = [at]
    for _ in range(element.count):
        for before, lengths, bytes_of_length, size in steps:
            at += before
            if at >= len(lengths) or not 0 <= (number := lengths[at].item()) < _LONGEST_LIST or number % 1:
                return np.array(starts)
            at += bytes_of_length + int(number) * size
        at += fixed
        if at > len(body):
            break
        starts.append(at)
    return np.array(starts)


def _columns(element: Element, body: bytes, order: str, starts: NDArray[np.intp]) -> dict[str, PlyColumn]:
    columns, at = {}, starts.astype(np.intp)
    for p in element.properties:
        lengths = np.ones(len(at), dtype=np.intp)
        if p.count_kind is not None:
            lengths = _at_every_byte(body, order + p.count_kind)[at].astype(np.intp)
            at = at + np.dtype(p.count_kind).itemsize
        size = np.dtype(p.kind).itemsize
        places = at if p.count_kind is None else np.repeat(at - size * (np.cumsum(lengths) - lengths), lengths)
        if p.count_kind is not None:
            places = places + size * np.arange(len(places))
        columns[p.name] = PlyColumn(_at_every_byte(body, order + p.kind)[places], lengths)
        at = at + size * lengths
    return columns

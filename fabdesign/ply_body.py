"""The rows of a PLY, below its header, as arrays: ascii and binary, lists of one length or of several."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.bounded_file import require_few
from fabdesign.csv_table import is_number
from fabdesign.errors import InputError

_TOGETHER = 65536  # rows that are gathered at once


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


def refuse(path: Path, why: str) -> NoReturn:
    raise InputError(f"{path}: {why}; expected a sound PLY")


# rows whose lists have the same lengths: their numbers, and by property (n,), or (n, length) of a list
Block = tuple[NDArray[np.intp], dict[str, NDArray[Any]]]


class AsciiBody:
    def __init__(self, body: bytes, path: Path) -> None:
        require_few(body.count(b"\n"), path, "lines")
        self._lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
        self._next = 0
        self._path = path

    def read(self, element: Element) -> list[Block]:
        lines = self._lines[self._next : self._next + element.count]
        if len(lines) < element.count:
            refuse(self._path, f"ends after {len(lines)} of {element.count} {element.name} rows")
        self._next += element.count
        alike: dict[tuple[int, ...], list[int]] = {}
        for row, line in enumerate(lines):
            alike.setdefault(self._lengths(element, line.split(), row), []).append(row)
        return [self._block(element, lengths, rows, lines) for lengths, rows in alike.items()]

    def _lengths(self, element: Element, words: list[str], row: int) -> tuple[int, ...]:
        """How long the row's lists are."""
        lengths: tuple[int, ...] = ()
        at = 0
        for p in element.properties:
            if p.count_kind is None:
                at += 1
                continue
            if at >= len(words) or not words[at].isdecimal() or len(words[at]) > 9:
                break
            lengths += (int(words[at]),)
            at += 1 + lengths[-1]
        else:
            if at == len(words):
                return lengths
        refuse(self._path, f"{element.name} row {row} has {len(words)} values; the header says others")

    def _block(self, element: Element, lengths: tuple[int, ...], rows: list[int], lines: list[str]) -> Block:
        try:
            values = np.loadtxt([lines[i] for i in rows], comments=None, ndmin=2)
        except ValueError:
            odd = next((i for i in rows if not all(map(is_number, lines[i].split()))), rows[0])
            refuse(self._path, f"{element.name} row {odd} is no row of numbers")
        columns, at, sizes = {}, 0, iter(lengths)
        for p in element.properties:
            if p.count_kind is None:
                columns[p.name], at = values[:, at], at + 1
            else:
                size = next(sizes)
                columns[p.name], at = values[:, at + 1 : at + 1 + size], at + 1 + size
        return np.array(rows, dtype=np.intp), columns

    def finish(self) -> None:
        if self._next != len(self._lines):
            refuse(self._path, f"has {len(self._lines) - self._next} rows more than its header says")


class BinaryBody:
    def __init__(self, body: bytes, order: str, path: Path) -> None:
        self._body = body
        self._order = order
        self._at = 0
        self._path = path

    def read(self, element: Element) -> list[Block]:
        if not element.count:
            return []
        starts, lengths = self._walk(element, 1)  # as a rule all rows are as the first
        row = self._row(element, lengths[0])
        counts = [name for name in row.names or () if name.startswith("n ")]
        if self._at + row.itemsize * element.count <= len(self._body):
            rows = np.frombuffer(self._body, row, element.count, self._at)
            if all((rows[name] == rows[name][0]).all() for name in counts):
                self._at += rows.nbytes
                return [(np.arange(len(rows)), {p.name: rows[p.name] for p in element.properties})]
        starts, lengths = self._walk(element, element.count)
        alike: dict[tuple[int, ...], list[int]] = {}
        for number, key in enumerate(lengths):
            alike.setdefault(key, []).append(number)
        self._at = starts[-1]
        return [self._block(element, key, np.array(numbers), np.array(starts)) for key, numbers in alike.items()]

    def _walk(self, element: Element, count: int) -> tuple[list[int], list[tuple[int, ...]]]:
        """Where so many rows begin, with the end of the last, and how long their lists are."""
        steps: list[tuple[int, Any, int]] = []  # bytes before a list's length, what unpacks it, bytes of a value
        fixed = 0
        for p in element.properties:
            size = np.dtype(p.kind).itemsize
            if p.count_kind is None:
                fixed += size
            else:
                steps.append((fixed, struct.Struct((self._order or "<") + np.dtype(p.count_kind).char), size))
                fixed = 0
        body, at, end = self._body, self._at, len(self._body)
        starts, lengths = [], []
        for row in range(count):
            starts.append(at)
            key: tuple[int, ...] = ()
            for before, length, size in steps:
                at += before
                if at + length.size > end or (number := length.unpack_from(body, at)[0]) < 0:
                    at = end + 1
                    break
                key += (number,)
                at += length.size + number * size
            at += fixed
            if at > end:
                refuse(self._path, f"ends after {row} of {element.count} {element.name} rows")
            lengths.append(key)
        return [*starts, at], lengths

    def _row(self, element: Element, lengths: tuple[int, ...]) -> np.dtype[Any]:
        fields: list[tuple[Any, ...]] = []
        sizes = iter(lengths)
        for p in element.properties:
            if p.count_kind is None:
                fields.append((p.name, self._order + p.kind))
            else:
                fields += [("n " + p.name, self._order + p.count_kind), (p.name, self._order + p.kind, (next(sizes),))]
        return np.dtype(fields)

    def _block(
        self, element: Element, lengths: tuple[int, ...], numbers: NDArray[np.intp], starts: NDArray[np.intp]
    ) -> Block:
        row = self._row(element, lengths)
        content, within = np.frombuffer(self._body, np.uint8), np.arange(row.itemsize)
        packed = np.empty((len(numbers), row.itemsize), np.uint8)
        for first in range(0, len(numbers), _TOGETHER):
            part = numbers[first : first + _TOGETHER]
            packed[first : first + len(part)] = content[starts[part][:, None] + within]
        rows = packed.reshape(-1).view(row)
        return numbers, {p.name: rows[p.name] for p in element.properties}

    def finish(self) -> None:
        if self._at != len(self._body):
            refuse(self._path, f"has {len(self._body) - self._at} bytes more than its header says")

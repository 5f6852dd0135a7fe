"""Strict PLY: ascii and binary, either byte order. What is short, long or odd is refused, never guessed.

An ascii element is taken as a binary one of float64, so that both are bytes in which rows follow one another.
Format: Greg Turk, The PLY Polygon File Format (1994).
"""

import re
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.measured_points import LONGEST_HEADER, refuse, require_one_instant
from fabdesign.formats.csv_table import is_number
from fabdesign.formats.toml_file import read_bytes, require_count
from fabdesign.geometry.surface import fans_of
from fabdesign.output import atomic_file

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)  # a line of its own: a comment may name it
_CORNERS = ("vertex_indices", "vertex_index")
_TOGETHER = 65536  # lines that become numbers at once
_LONGEST_LIST = 10**9


class Ply(NamedTuple):
    points: NDArray[np.float64]  # (n, 3), in the file's unit
    triangles: NDArray[np.intp]  # (t, 3); polygons are cut into fans; (0, 3) for a cloud


class Property(NamedTuple):
    """A property of an element. kind: a numpy type without byte order. count_kind: of a list, its length's."""

    name: str
    kind: str
    count_kind: str | None = None


Element = tuple[str, int, list[Property]]  # name, rows, properties
Column = tuple[NDArray[Any], NDArray[np.intp]]  # the values of all rows one after another, and how many each row has


def read_ply(path: Path | str) -> Ply:
    """Return vertices and faces of a PLY. Raises InputError, with one line, for anything that is not a sound file."""
    path = Path(path)
    content = read_bytes(path, "a PLY")
    end = _END.search(content, 0, LONGEST_HEADER)
    if not content.startswith(b"ply") or end is None:
        refuse(path, "has no PLY header")
    order, elements = _header(content[: end.start()].decode("latin-1"), path)
    for name, count, _ in elements:
        require_count(count, path, f"{name} rows")
    body, ends = content[end.end() :], None
    if not order:
        body, ends = _packed(body, elements, path)
        elements = [
            (n, count, [Property(p.name, "f8", p.count_kind and "f8") for p in ps]) for n, count, ps in elements
        ]
    at = row = 0
    points, corners, lengths = None, np.zeros(0, np.intp), np.zeros(0, np.intp)
    for name, count, properties in elements:
        starts = _starts(properties, count, body, order or "<", at)
        if ends is not None:
            _require_widths(starts, ends[row : row + count + 1], name, path)
        if len(starts) <= count:
            refuse(path, f"ends after {len(starts) - 1} of {count} {name} rows")
        columns = _columns(properties, body, order or "<", starts[:-1])
        if name == "vertex":
            points = _points(columns, properties, path)
        elif name == "face" and count:
            corners, lengths = next(columns[corner] for corner in _CORNERS if corner in columns)
        at, row = int(starts[-1]), row + count
    if unread := len(body) - at if ends is None else len(ends) - 1 - row:
        refuse(path, f"has {unread} {'bytes' if order else 'rows'} more than its header says")
    if points is None:
        refuse(path, "it has no vertices")
    if not np.all((np.abs(corners) < 2**31) & (corners == np.rint(corners))):
        refuse(path, "its faces are no lists of whole numbers")
    return Ply(points, fans_of(points, corners, lengths, path))


def write_ply(path: Path | str, points: NDArray[np.floating], triangles: NDArray[np.integer] | None = None) -> None:
    """Write points (n, 3) as float32, and triangles (t, 3) where given, in binary little-endian. InputError where the
    file cannot be written."""
    with atomic_file(Path(path)) as temporary:
        temporary.write_bytes(ply_bytes(points, triangles))


def ply_bytes(points: NDArray[np.floating], triangles: NDArray[np.integer] | None = None) -> bytes:
    """Return the content that `write_ply` writes."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    body = np.asarray(points, dtype="<f4").tobytes()
    if triangles is not None:
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
        rows["n"], rows["corners"] = 3, triangles
        body += rows.tobytes()
    return "\n".join([*header, "end_header\n"]).encode("ascii") + body


def _header(text: str, path: Path) -> tuple[str, list[Element]]:
    """Return the byte order ('' for ascii) and the elements."""
    order: str | None = None
    elements: list[Element] = []
    for words in (line.split() for line in text.splitlines()[1:]):
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append((name, int(count[:18]), []))
            case ["property", kind, name] if kind in _TYPES and elements:
                elements[-1][2].append(Property(name, _TYPES[kind]))
            case ["property", "list", n, kind, name] if (
                n in _TYPES and _TYPES[n][0] != "f" and kind in _TYPES and elements
            ):
                elements[-1][2].append(Property(name, _TYPES[kind], _TYPES[n]))
            case _:
                refuse(path, f'its header has the line "{" ".join(words)[:60]}"')
    if order is None:
        refuse(path, "its header names no format")
    if len({name for name, *_ in elements}) < len(elements):
        refuse(path, "its header has two elements of one name")
    for element, rows, properties in elements:
        names = {p.name for p in properties}
        if not names or len(names) < len(properties):
            refuse(path, f"its {element} has no properties, or two of one name")
        lists = [p.name for p in properties if p.count_kind is not None and p.name in _CORNERS]
        if (element == "face") != bool(lists) and rows:  # else a mesh is taken for a cloud
            unread = f"{element} rows with {lists[0]}" if lists else "face rows without vertex_indices"
            refuse(path, f"has {unread}, which are not read")
    return order, elements


def _points(columns: Mapping[str, Column], properties: Sequence[Property], path: Path) -> NDArray[np.float64]:
    scalars = {p.name: columns[p.name][0] for p in properties if p.count_kind is None}
    if not {"x", "y", "z"} <= scalars.keys():
        refuse(path, f"its vertices have {'lists for' if {'x', 'y', 'z'} <= columns.keys() else 'no'} x, y, z")
    require_one_instant(scalars, str(path))
    return np.stack([scalars[axis].astype(np.float64) for axis in "xyz"], axis=1)


def _packed(body: bytes, elements: Sequence[Element], path: Path) -> tuple[bytes, NDArray[np.intp]]:
    """Return the rows of an ascii body as float64, and where each line begins, with the end of the last."""
    require_count(body.count(b"\n"), path, "lines")
    text = body.decode("latin-1").replace("_", "?")  # Python takes 1_000 for a number
    lines = [line for line in text.splitlines() if line.strip()]
    names = [(name, count) for name, count, _ in elements]
    total = min(sum(count for _, count in names), len(lines))
    packed = bytearray()
    for first in range(0, total, _TOGETHER):
        rows = [line.split() for line in lines[first : min(first + _TOGETHER, total)]]
        try:
            packed += np.array([*map(float, chain.from_iterable(rows))], dtype="<f8").tobytes()
        except ValueError:
            row = first + next(i for i, row in enumerate(rows) if not all(map(is_number, row)))
            while row >= names[0][1]:
                row -= names.pop(0)[1]
            refuse(path, f"{names[0][0]} row {row} is no row of numbers")
    return bytes(packed), 8 * np.cumsum([0, *(len(line.split()) for line in lines)])


def _require_widths(starts: NDArray[np.intp], lines: NDArray[np.intp], name: str, path: Path) -> None:
    """Raise InputError where the rows of an ascii element, as the header has them, are not those of the lines."""
    n = min(len(starts), len(lines))
    row = int(np.append(np.flatnonzero(starts[:n] != lines[:n]), n)[0]) - 1
    if row + 1 < len(lines):
        refuse(path, f"{name} row {row} has {(lines[row + 1] - lines[row]) // 8} values; the header says others")


def _at_every_byte(body: bytes, kind: str) -> NDArray[Any]:
    """Return the value that would begin at each byte."""
    return np.ndarray(max(len(body) - np.dtype(kind).itemsize + 1, 0), kind, body, strides=(1,))


def _starts(properties: Sequence[Property], count: int, body: bytes, order: str, at: int) -> NDArray[np.intp]:
    """Return where the rows begin, with the end of the last; fewer where the body ends, or a list's length is none."""
    steps: list[tuple[int, NDArray[Any], int, int]] = []  # bytes before a length, lengths, their bytes, a value's
    fixed = 0
    for p in properties:
        size = np.dtype(p.kind).itemsize
        if p.count_kind is None:
            fixed += size
        else:
            steps.append((fixed, _at_every_byte(body, order + p.count_kind), np.dtype(p.count_kind).itemsize, size))
            fixed = 0
    if not steps:
        return at + fixed * np.arange(min(count, (len(body) - at) // fixed) + 1)
    starts = [at]
    for _ in range(count):
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


def _columns(properties: Sequence[Property], body: bytes, order: str, at: NDArray[np.intp]) -> dict[str, Column]:
    columns = {}
    for p in properties:
        size, lengths, places = np.dtype(p.kind).itemsize, np.ones(len(at), dtype=np.intp), at
        if p.count_kind is not None:
            lengths = _at_every_byte(body, order + p.count_kind)[at].astype(np.intp)
            at = at + np.dtype(p.count_kind).itemsize
            places = np.repeat(at - size * (np.cumsum(lengths) - lengths), lengths)
            places = places + size * np.arange(len(places))
        columns[p.name] = _at_every_byte(body, order + p.kind)[places], lengths
        at = at + size * lengths
    return columns

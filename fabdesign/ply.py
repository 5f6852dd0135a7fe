"""Strict PLY: ascii and binary, either byte order. What is short, long or odd is refused, never guessed.

Format: Greg Turk, The PLY Polygon File Format (1994).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.bounded_file import read_bytes
from fabdesign.errors import InputError
from fabdesign.output import whole_file

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 65536  # bytes
_BLOCK = 16  # rows looked at together for lists of one length, at first


@dataclass(frozen=True, eq=False)
class Ply:
    points: NDArray[np.float64]  # (n, 3), in the file's unit
    triangles: NDArray[np.intp]  # (t, 3); polygons are cut into fans; (0, 3) for a cloud


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str  # numpy type without byte order
    count_kind: str | None = None  # of a list


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def read_ply(path: Path | str) -> Ply:
    """Vertices and faces of a PLY. Raises InputError, with one line, for anything that is not exactly a sound file."""
    path = Path(path)
    content = read_bytes(path, "a PLY")
    order, elements, start = _header(content, path)
    body: _AsciiBody | _BinaryBody
    body = _AsciiBody(content[start:], path) if order == "" else _BinaryBody(content[start:], order, path)
    points, triangles = None, np.zeros((0, 3), dtype=np.intp)
    for element in elements:
        columns = body.read(element)
        if element.name == "vertex":
            if not {"x", "y", "z"} <= columns.keys():
                _refuse(path, "its vertices have no x, y, z")
            if any(p.count_kind is not None for p in element.properties if p.name in ("x", "y", "z")):
                _refuse(path, "its vertices have lists for x, y, z")
            points = np.stack([np.concatenate([np.zeros(0), *columns[axis]]) for axis in "xyz"], axis=1)
        elif element.name == "face":
            corners = next((columns[n] for n in ("vertex_indices", "vertex_index") if n in columns), [])
            if any(block.ndim != 2 or not _whole(block) for block in corners):
                _refuse(path, "its faces are no lists of whole numbers")
            triangles = _fans(corners)
    body.finish()
    if points is None:
        _refuse(path, "it has no vertices")
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(points)):
        _refuse(path, f"a face names vertex {triangles.max()} of {len(points)}")
    return Ply(points, triangles)


def write_ply(path: Path | str, points: NDArray[np.floating], triangles: NDArray[np.integer] | None = None) -> None:
    """Write points (n, 3) as float32, and triangles (t, 3) where given, in binary little-endian. InputError where the
    file cannot be written."""
    with whole_file(Path(path)) as temporary:
        temporary.write_bytes(ply_bytes(points, triangles))


def ply_bytes(points: NDArray[np.floating], triangles: NDArray[np.integer] | None = None) -> bytes:
    """The content that `write_ply` writes."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    body = np.asarray(points, dtype="<f4").tobytes()
    if triangles is not None:
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
        rows["n"], rows["corners"] = 3, triangles
        body += rows.tobytes()
    return "\n".join([*header, "end_header\n"]).encode("ascii") + body


def _refuse(path: Path, why: str) -> NoReturn:
    raise InputError(f"{path}: {why}; expected a sound PLY")


def _header(content: bytes, path: Path) -> tuple[str, list[_Element], int]:
    """Byte order ('' for ascii), elements, and where the body starts."""
    end = content.find(b"end_header", 0, _LONGEST_HEADER)
    stop = content.find(b"\n", end) + 1
    if not content.startswith(b"ply") or end < 0 or stop == 0:
        _refuse(path, "has no PLY header")
    lines = [line.split() for line in content[:end].decode("latin-1").splitlines()]
    order: str | None = None
    elements: list[_Element] = []
    for words in lines[1:]:
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), ()))
            case ["property", kind, name] if kind in _TYPES and elements:
                elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind]))
            case ["property", "list", n, kind, name] if (
                n in _TYPES and _TYPES[n][0] != "f" and kind in _TYPES and elements
            ):
                elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind], _TYPES[n]))
            case _:
                _refuse(path, f'its header has the line "{" ".join(words)[:60]}"')
    if order is None:
        _refuse(path, "its header names no format")
    for element in elements:
        names = [p.name for p in element.properties]
        if not names or len(set(names)) < len(names):
            _refuse(path, f"its {element.name} has no properties, or two of one name")
    return order, elements, stop


def _with(element: _Element, new: _Property) -> _Element:
    return _Element(element.name, element.count, (*element.properties, new))


def _whole(block: NDArray[Any]) -> bool:
    return bool(np.all((np.abs(block) < 2**31) & (block == np.rint(block))))


def _fans(faces: list[NDArray[Any]]) -> NDArray[np.intp]:
    """(t, 3) of blocks (n, corners)."""
    corners = [block.astype(np.intp) for block in faces if block.shape[1] >= 3]
    fans = [np.stack([f[:, [0] * (f.shape[1] - 2)], f[:, 1:-1], f[:, 2:]], axis=2).reshape(-1, 3) for f in corners]
    return np.concatenate(fans) if fans else np.zeros((0, 3), dtype=np.intp)


# per property the blocks of its rows: (n,), or (n, length) of a list
Columns = dict[str, list[NDArray[Any]]]


class _AsciiBody:
    def __init__(self, body: bytes, path: Path) -> None:
        self._lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
        self._next = 0
        self._path = path

    def read(self, element: _Element) -> Columns:
        rows = self._lines[self._next : self._next + element.count]
        if len(rows) < element.count:
            _refuse(self._path, f"ends after {len(rows)} of {element.count} {element.name} rows")
        self._next += element.count
        try:  # as a rule all rows are as long as the first
            values = np.loadtxt(rows, comments=None, ndmin=2) if rows else np.zeros((0, 0))
            return _columns(element, values)
        except ValueError:
            pass
        columns: Columns = {p.name: [] for p in element.properties}
        for i, row in enumerate(rows):
            try:
                values = np.array([row.split()], dtype=np.float64)
            except ValueError:
                _refuse(self._path, f"{element.name} row {i} is no row of numbers")
            try:
                for name, blocks in _columns(element, values).items():
                    columns[name] += blocks
            except ValueError as error:
                _refuse(self._path, f"{element.name} row {i} {error}")
        return columns

    def finish(self) -> None:
        if self._next != len(self._lines):
            _refuse(self._path, f"has {len(self._lines) - self._next} rows more than its header says")


def _columns(element: _Element, values: NDArray[np.float64]) -> Columns:
    """The properties in rows whose lists have the same lengths. ValueError where they have others."""
    columns: Columns = {p.name: [] for p in element.properties}
    if not len(values):
        return columns
    at, width = 0, values.shape[1]
    for p in element.properties:
        size = 1
        if p.count_kind is not None:
            if at >= width or not np.all(values[:, at] == values[0, at]) or not 0 <= values[0, at] <= width:
                raise ValueError(f"has {width} values; a list's length is not among them")
            size, at = int(values[0, at]), at + 1
        block = values[:, at : at + size]
        columns[p.name].append(block[:, 0] if p.count_kind is None and block.shape[1] else block)
        at += size
    if at != width:
        raise ValueError(f"has {width} values; the header says {at}")
    return columns


class _BinaryBody:
    def __init__(self, body: bytes, order: str, path: Path) -> None:
        self._body = body
        self._order = order
        self._at = 0
        self._path = path

    def read(self, element: _Element) -> Columns:
        if all(p.count_kind is None for p in element.properties):
            names = [p.name for p in element.properties]
            row = np.dtype([(p.name, self._order + p.kind) for p in element.properties])
            rows: NDArray[Any] = self._take(row, element.count, element, 0)
            return {name: [rows[name]] for name in names}
        columns: Columns = {p.name: [] for p in element.properties}
        done, block = 0, _BLOCK
        while done < element.count:  # rows alike are read as one block
            row = self._next_row(element, done)
            fits = (len(self._body) - self._at) // row.itemsize
            rows = np.frombuffer(self._body, row, min(fits, element.count - done, block), self._at)
            lists = [p.name for p in element.properties if p.count_kind is not None]
            alike = np.all([rows["n " + name] == rows["n " + name][:1] for name in lists], axis=0)
            block = 4 * block if alike.all() else _BLOCK
            rows = rows[: len(rows) if alike.all() else int(alike.argmin())]
            if not len(rows):
                self._take(row, 1, element, done)
            for p in element.properties:
                columns[p.name].append(rows[p.name])
            self._at, done = self._at + row.itemsize * len(rows), done + len(rows)
        return columns

    def _next_row(self, element: _Element, number: int) -> np.dtype[Any]:
        """What the next row is made of, by the lengths of its own lists."""
        start = self._at
        fields: list[tuple[Any, ...]] = []
        for p in element.properties:
            kind = np.dtype(self._order + p.kind)
            if p.count_kind is None:
                fields.append((p.name, kind))
                self._take(kind, 1, element, number)
                continue
            count = np.dtype(self._order + p.count_kind)
            size = int(self._take(count, 1, element, number)[0])
            self._take(kind, size, element, number)
            fields += [("n " + p.name, count), (p.name, kind, (size,))]
        self._at = start
        return np.dtype(fields)

    def _take(self, kind: np.dtype[np.generic], count: int, element: _Element, row: int) -> NDArray[Any]:
        stop = self._at + kind.itemsize * count
        if count < 0 or stop > len(self._body):
            row += max(len(self._body) - self._at, 0) // kind.itemsize if kind.itemsize and row == 0 else 0
            _refuse(self._path, f"ends after {row} of {element.count} {element.name} rows")
        values = np.frombuffer(self._body, kind, count, self._at)
        self._at = stop
        return values

    def finish(self) -> None:
        if self._at != len(self._body):
            _refuse(self._path, f"has {len(self._body) - self._at} bytes more than its header says")

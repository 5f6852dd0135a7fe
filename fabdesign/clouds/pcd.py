"""Strict PCD: ascii, binary and compressed. What is short, long or odd is refused, never guessed.

Format: Point Cloud Library, The PCD file format, versions .5 to .7.
"""

from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.measured_points import LONGEST_HEADER, require_one_instant
from fabdesign.errors import InputError
from fabdesign.formats.toml_file import LARGEST, read_bytes, require_count

_KINDS = {"F4", "F8", *(f"{letter}{size}" for letter in "IU" for size in (1, 2, 4, 8))}
_KEYS = {"VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}
_NO_VIEWPOINT = ["0", "0", "0", "1", "0", "0", "0"]  # a translation and a quaternion


_Field = tuple[str, str, int]  # name, numpy's type, values a point


def read_pcd(path: Path) -> NDArray[np.float64]:
    """Return (n, 3) points in the file's unit, NaN where the sensor saw nothing.

    Raises InputError, with one line, for anything that is not exactly a sound file, and for a viewpoint: some programs
    move the points by it, others have moved them before they wrote it.
    """
    content = read_bytes(path, "a PCD")
    fields, count, data, start = _header(content, path)
    columns = _columns(content[start:], fields, count, data, path)
    firsts = {name: column[:, :1] for (name, _, _), column in zip(fields, columns, strict=True)}
    require_one_instant(firsts, str(path))
    return np.concatenate([firsts[axis] for axis in "xyz"], axis=1, dtype=np.float64)


def _refuse(path: Path, why: str) -> NoReturn:
    raise InputError(f"{path}: {why}; expected a sound PCD")


class _Header(NamedTuple):
    """The fields, the number of points, how they stand there, and where they begin."""

    fields: list[_Field]
    points: int
    data: str
    start: int


def _header(content: bytes, path: Path) -> _Header:
    values: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in values:
        end = content.find(b"\n", at, LONGEST_HEADER)
        if end < 0:
            _refuse(path, "has no PCD header")
        words = content[at:end].decode("latin-1").split()
        at = end + 1
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYS or words[0] in values:
            _refuse(path, f'its header has the line "{" ".join(words)[:60]}"')
        values[words[0]] = words[1:]
    names = values.get("FIELDS", values.get("COLUMNS", []))
    sizes, types = values.get("SIZE", []), values.get("TYPE", [])
    counts = values.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        _refuse(path, "its header does not name as many fields, sizes, types and counts")
    kinds = [letter + size for letter, size in zip(types, sizes, strict=True)]
    integers = [*counts, *(values[key][0] for key in ("WIDTH", "HEIGHT", "POINTS") if values.get(key))]
    if not _KINDS.issuperset(kinds) or not all(number.isdecimal() and len(number) < 10 for number in integers):
        _refuse(path, "its header has a size, type or number that is none")
    if [names.count(axis) for axis in "xyz"] != [1, 1, 1]:
        _refuse(path, "its fields are not x, y, z")
    if any(counts[names.index(axis)] != "1" for axis in "xyz"):
        _refuse(path, "its fields x, y, z are not one number each")
    viewpoint = values.get("VIEWPOINT", _NO_VIEWPOINT)
    try:
        moved = len(viewpoint) != 7 or [*map(float, viewpoint)] != [*map(float, _NO_VIEWPOINT)]
    except ValueError:
        moved = True
    if moved:
        raise InputError(
            f"{path}: VIEWPOINT is {' '.join(viewpoint)[:60]}, by which the points may or may not be moved; expected "
            f"{' '.join(_NO_VIEWPOINT)}, with points that lie where they are"
        )
    if not values.get("WIDTH") or not values.get("HEIGHT"):
        _refuse(path, "its header has no width and height")
    points = int(values["WIDTH"][0]) * int(values["HEIGHT"][0])
    if values.get("POINTS") and int(values["POINTS"][0]) != points:
        _refuse(path, f"its header says {values['POINTS'][0]} points, and width times height is {points}")
    require_count(points, path, "points")
    fields = [*zip(names, (f"<{kind.lower()}" for kind in kinds), map(int, counts), strict=True)]
    if sum(values * np.dtype(kind).itemsize for _, kind, values in fields) > LARGEST:
        _refuse(path, "its header says that a point is larger than a file may be")
    data = " ".join(values["DATA"])
    if data not in ("ascii", "binary", "binary_compressed"):
        _refuse(path, f"its data are {data[:40]}")
    return _Header(fields, points, data, at)


def _columns(body: bytes, fields: list[_Field], points: int, data: str, path: Path) -> list[NDArray[Any]]:
    """Return (points, count) values of each field."""
    if data == "ascii":
        lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
        if len(lines) != points:
            _refuse(path, f"has {len(lines)} rows; its header says {points} points")
        counts = [values for _, _, values in fields]
        try:
            table = np.loadtxt(lines, comments=None, ndmin=2) if lines else np.zeros((0, sum(counts)))
        except ValueError:
            _refuse(path, "a row is no row of numbers, or not as long as the others")
        if table.shape[1] != sum(counts):
            _refuse(path, f"has {table.shape[1]} values a row; its header says {sum(counts)}")
        return np.split(table, np.cumsum(counts[:-1]), axis=1)
    row = np.dtype([(str(number), kind, (values,)) for number, (_, kind, values) in enumerate(fields)])
    size = row.itemsize * points
    if data == "binary":
        if len(body) != size:
            _refuse(path, f"has {len(body)} bytes of points; its header says {size}")
        rows = np.frombuffer(body, row, points)
        return [rows[name] for name in row.names or ()]
    packed, unpacked = (int.from_bytes(body[i : i + 4], "little") for i in (0, 4))
    if len(body) < 8 or len(body) != 8 + packed or unpacked != size or size > LARGEST:
        _refuse(path, f"has {max(len(body) - 8, 0)} bytes of points that unpack to {unpacked}; its header says {size}")
    content = _unpacked(body[8:], size)
    if content is None:
        _refuse(path, "its compressed points are damaged")
    columns: list[NDArray[Any]] = []
    at = 0
    for _, kind, values in fields:  # one column after another
        columns.append(np.frombuffer(content, kind, points * values, at).reshape(points, values))
        at += columns[-1].nbytes
    return columns


def _unpacked(packed: bytes, size: int) -> bytes | None:
    """Return what LZF has packed: a control byte, then a run of new bytes, or a length and how far back the bytes
    stand. None: damaged."""
    out = bytearray()
    at, end = 0, len(packed)
    while at < end and len(out) <= size:
        control = packed[at]
        at += 1
        if control < 32:
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7 and at < end:
            length += packed[at]
            at += 1
        if at >= end:
            return None
        start = len(out) - ((control & 31) << 8) - packed[at] - 1
        at += 1
        length += 2
        if start < 0:
            return None
        chunk = out[start : start + length]  # what is copied may overlap what it becomes
        out += (chunk * (length // len(chunk) + 1))[:length]
    return bytes(out) if at == end and len(out) == size else None

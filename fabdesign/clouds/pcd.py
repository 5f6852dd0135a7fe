"""Strict PCD: ascii, binary and compressed. What is short, long or odd is refused, never guessed.

Format: Point Cloud Library, The PCD file format, versions .5 to .7.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.measured_points import LONGEST_HEADER, refuse, require_one_instant
from fabdesign.errors import InputError
from fabdesign.formats.csv_table import is_number
from fabdesign.formats.toml_file import LARGEST, parsing, read_bytes, require_count

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
    values, start = _header(content, path)
    fields, count = _fields(values, path)
    columns = _columns(content[start:], fields, count, " ".join(values["DATA"]), path)
    firsts = {name: column[:, :1] for (name, _, _), column in zip(fields, columns, strict=True)}
    require_one_instant(firsts, str(path))
    return np.concatenate([firsts[axis] for axis in "xyz"], axis=1, dtype=np.float64)


def _header(content: bytes, path: Path) -> tuple[dict[str, list[str]], int]:
    """Return the words behind each key, and where the points begin."""
    values: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in values:
        end = content.find(b"\n", at, LONGEST_HEADER)
        if end < 0:
            refuse(path, "has no PCD header")
        words = content[at:end].decode("latin-1").split()
        at = end + 1
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYS or words[0] in values:
            refuse(path, f'its header has the line "{" ".join(words)[:60]}"')
        values[words[0]] = words[1:]
    return values, at


def _fields(values: dict[str, list[str]], path: Path) -> tuple[list[_Field], int]:
    """Return the fields that a header names, and the number of points."""
    names = values.get("FIELDS", values.get("COLUMNS", []))
    sizes, types = values.get("SIZE", []), values.get("TYPE", [])
    counts = values.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        refuse(path, "its header does not name as many fields, sizes, types and counts")
    kinds = [letter + size for letter, size in zip(types, sizes, strict=True)]
    integers = [*counts, *(values[key][0] for key in ("WIDTH", "HEIGHT", "POINTS") if values.get(key))]
    if not _KINDS.issuperset(kinds) or not all(number.isdecimal() and len(number) < 10 for number in integers):
        refuse(path, "its header has a size, type or number that is none")
    if [names.count(axis) for axis in "xyz"] != [1, 1, 1]:
        refuse(path, "its fields are not x, y, z")
    if any(counts[names.index(axis)] != "1" for axis in "xyz"):
        refuse(path, "its fields x, y, z are not one number each")
    viewpoint = values.get("VIEWPOINT", _NO_VIEWPOINT)
    if [float(word) if is_number(word) else np.nan for word in viewpoint] != [*map(float, _NO_VIEWPOINT)]:
        raise InputError(
            f"{path}: VIEWPOINT is {' '.join(viewpoint)[:60]}, by which the points may or may not be moved; expected "
            f"{' '.join(_NO_VIEWPOINT)}, with points that lie where they are"
        )
    if not values.get("WIDTH") or not values.get("HEIGHT"):
        refuse(path, "its header has no width and height")
    points = int(values["WIDTH"][0]) * int(values["HEIGHT"][0])
    if values.get("POINTS") and int(values["POINTS"][0]) != points:
        refuse(path, f"its header says {values['POINTS'][0]} points, and width times height is {points}")
    require_count(points, path, "points")
    fields = [*zip(names, (f"<{kind.lower()}" for kind in kinds), map(int, counts), strict=True)]
    if sum(number * np.dtype(kind).itemsize for _, kind, number in fields) > LARGEST:
        refuse(path, "its header says that a point is larger than a file may be")
    data = " ".join(values["DATA"])
    if data not in ("ascii", "binary", "binary_compressed"):
        refuse(path, f"its data are {data[:40]}")
    return fields, points


def _columns(body: bytes, fields: list[_Field], points: int, data: str, path: Path) -> list[NDArray[Any]]:
    """Return (points, count) values of each field."""
    if data == "ascii":
        lines = [line for line in body.decode("latin-1").splitlines() if line.strip()]
        if len(lines) != points:
            refuse(path, f"has {len(lines)} rows; its header says {points} points")
        counts = [values for _, _, values in fields]
        with parsing(path, "a row is no row of numbers, or not as long as the others", "a sound PCD"):
            table = np.loadtxt(lines, comments=None, ndmin=2) if lines else np.zeros((0, sum(counts)))
        if table.shape[1] != sum(counts):
            refuse(path, f"has {table.shape[1]} values a row; its header says {sum(counts)}")
        return np.split(table, np.cumsum(counts[:-1]), axis=1)
    row = np.dtype([(str(number), kind, (values,)) for number, (_, kind, values) in enumerate(fields)])
    size = row.itemsize * points
    if data == "binary":
        if len(body) != size:
            refuse(path, f"has {len(body)} bytes of points; its header says {size}")
        rows = np.frombuffer(body, row, points)
        return [rows[name] for name in row.names or ()]
    packed, unpacked = (int.from_bytes(body[i : i + 4], "little") for i in (0, 4))
    if len(body) < 8 or len(body) != 8 + packed or unpacked != size or size > LARGEST:
        refuse(path, f"has {max(len(body) - 8, 0)} bytes of points that unpack to {unpacked}; its header says {size}")
    content = _unpacked(body[8:], size)
    if content is None:
        refuse(path, "its compressed points are damaged")
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

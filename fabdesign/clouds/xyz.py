"""Clouds as text, a point a line: XYZ (blanks), CSV (commas, with or without a header) and PTS (with a count)."""

import io
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, NoReturn, get_args

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.measured_points import names_instants, require_one_instant
from fabdesign.errors import InputError, note
from fabdesign.formats.csv_table import is_number, require_decimals, separator, without_separator_line
from fabdesign.formats.lab_table import parse_heading, parse_units_row
from fabdesign.formats.toml_file import LARGEST, decode_any, read_bytes, require_count
from fabdesign.geometry.placement import Unit

_COMMENTS = ("#", "//")
_PTS_WIDTHS = (3, 4, 6, 7)  # x y z, then an intensity, a colour, or both
Lines = list[tuple[int, str]]  # with their numbers in the file
Points = NDArray[np.float64]


def read_xyz(path: Path) -> tuple[Points, Unit | None]:
    """Return the points (n, 3) of a text file, NaN where a cell is empty, and the unit that its header names.

    Lines that are empty or start with # or // are skipped, but for one that names the columns; numbers are parted by
    semicolons, tabs, commas or blanks, and may have decimal commas where no commas part them. A header names the
    columns x, y and z, with their unit or above a row of units; without one they are the first three, and a CSV has no
    others. Raises InputError.
    """
    lines = _with_header(_lines(path), path)
    if not lines:
        return np.zeros((0, 3)), None
    mark = _mark(lines[0][1])
    head = _split(lines[0][1], mark)
    columns, unit = [0, 1, 2], None
    if not _are_numbers(head[:1]):
        columns, unit, lines = _named(path, lines, mark)
    elif len(head) < 3 or (mark and len(head) > 3):
        _refuse(path, lines[0], "has no header" if mark and len(head) > 3 else "is no point")
    points = _numbers(path, lines, mark, len(head), columns)
    if columns == [0, 1, 2]:
        _require_no_numbering(points, len(head), path)
    commas = _decimal_commas(lines, mark)
    if mark == ";" or commas:
        note(f"{path}: written with {' and '.join(['semicolons'] * (mark == ';') + ['decimal commas'] * commas)}")
    return points, unit


def is_text_cloud(path: Path) -> bool:
    """Return whether a text begins with a point, or with a header that names x, y and z. Raises InputError."""
    if path.is_file() and path.stat().st_size > LARGEST:
        return False  # a table has fewer bytes still
    lines = _with_header(_lines(path), path)
    head = _split(lines[0][1], _mark(lines[0][1])) if lines else [""]
    return _names_axes(head) or _are_numbers(head)


def read_pts(path: Path) -> Points:
    """Return (n, 3) points of a PTS: their count, then as many lines of x y z, with an intensity, a colour or both.

    Raises InputError."""
    lines = [line for line in _lines(path) if not line[1].startswith("#")]
    if not lines or not (lines[0][1].isascii() and lines[0][1].isdecimal()):
        raise InputError(f"{path}: its first line is no count of points; expected a sound PTS")
    count, rows = int(lines[0][1][:18]), lines[1:]
    if count != len(rows):
        raise InputError(f"{path}: has {len(rows)} points; its first line says {count}; expected a sound PTS")
    width = len(rows[0][1].split()) if rows else 3
    if width not in _PTS_WIDTHS:
        _refuse(path, rows[0], "is no point")
    points = _numbers(path, rows, None, width, [0, 1, 2])
    _require_no_numbering(points, width, path)
    return points


def _names_axes(cells: list[str]) -> bool:
    return {"x", "y", "z"} <= {parse_heading(cell).name for cell in cells}


def _are_numbers(cells: list[str]) -> bool:
    return all(is_number(cell.replace(",", ".")) for cell in cells)


def _decimal_commas(lines: Lines, mark: str | None) -> bool:
    """Return whether commas stand in numbers; else they part the cells."""
    return mark != "," and any("," in line for _, line in lines)


def _require_no_numbering(points: Points, width: int, path: Path) -> None:
    """Raise InputError where the first of more than three columns counts the points: it is no x."""
    if width > 3 and len(points) > 2 and (np.diff(points[:, 0]) == 1).all():
        raise InputError(f"{path}: its first column counts the points; expected x, y, z, or a header that names them")


def _lines(path: Path) -> Lines:
    text = without_separator_line(decode_any(read_bytes(path, "a cloud"), path))
    require_count(text.count("\n"), path, "lines")
    numbered = ((number, line.strip()) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, line) for number, line in numbered if line]


def _with_header(lines: Lines, path: Path) -> Lines:
    """Return them without comments, but with one above the points that names their columns as a header: "//X Y Z" of
    CloudCompare, whose count of points may follow, "# z y x" of numpy's savetxt. Raises InputError where there are not
    so many points, and where comments part several frames."""
    rest = [line for line in lines if not line[1].startswith(_COMMENTS)]
    words = (line.lstrip("#/ ").lower() for _, line in lines if line.startswith(_COMMENTS))
    frames = {word for word in words if names_instants(word.rstrip("0123456789.:=+- smµ[]()"))}
    if len(frames) > 1:  # as "# frame 0" and "# frame 1" do above their points
        raise InputError(f"{path}: its comments part several frames ({min(frames)[:40]}, ...); expected one")
    for number, line in lines:
        if not line.startswith(_COMMENTS):
            break
        cells, unit = _commented(line)
        if _names_axes(cells):
            if rest and rest[0][1].isdecimal():
                if int(rest[0][1][:18]) != len(rest) - 1:
                    _refuse(path, rest[0], f"is the count of points, of which there are {len(rest) - 1}")
                rest = rest[1:]
            mark = _mark(rest[0][1]) if rest else None
            row = _split(rest[0][1], mark) if rest else []
            if line.startswith("//") or (rest and len(row) == len(cells) and _are_numbers(row[:3])):
                return [(number, (mark or " ").join(cell.replace(" ", "") + unit for cell in cells)), *rest]
    return rest


def _commented(line: str) -> tuple[list[str], str]:
    """Return the headings in a comment, and the unit that may stand behind all of them, in brackets; "" for none."""
    header = line.lstrip("#/ ")
    cells = _split(header, _mark(header))
    last = cells[-1].strip("[]()")
    is_unit = cells[-1] != last and last in get_args(Unit)
    return (cells[:-1], f"[{last}]") if is_unit else (cells, "")


def _mark(line: str) -> str | None:
    """Return what parts the cells; None: blanks."""
    mark = separator(line)
    return None if mark == " " or mark not in line else mark


def _split(line: str, mark: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in line.split(mark)] or [""]


class _Named(NamedTuple):
    """The places of x, y and z, their unit, and the lines below the header and its units."""

    columns: list[int]
    unit: Unit | None
    lines: Lines


def _named(path: Path, lines: Lines, mark: str | None) -> _Named:
    headings = [parse_heading(cell) for cell in _split(lines[0][1], mark)]
    names = [heading.name for heading in headings]
    if len(set(names)) < len(names) or not {"x", "y", "z"} <= set(names):
        _refuse(path, lines[0], "is neither a point nor a header with x, y and z")
    columns = [names.index(axis) for axis in "xyz"]
    symbols = [headings[i].symbol for i in columns]
    rest = lines[1:]
    if rest and (row := parse_units_row(_split(rest[0][1], mark))) is not None and len(row) == len(names):
        if any(row[i] and symbol not in (None, row[i]) for i, symbol in zip(columns, symbols, strict=True)):
            _refuse(path, rest[0], "names other units than the header")
        symbols = [row[i] or symbol for i, symbol in zip(columns, symbols, strict=True)]
        rest = rest[1:]
    for i in (i for i, name in enumerate(names) if names_instants(name)):
        cells = np.array([",".join(_split(line, mark)[i : i + 1]) for _, line in rest])
        require_one_instant({headings[i].text: cells}, str(path))
    unit = next((unit for unit in get_args(Unit) if unit == symbols[0]), None)
    if any(symbols) and (unit is None or len(set(symbols)) > 1):
        units = f"{', '.join(map(str, symbols))}, not one of {', '.join(get_args(Unit))}"
        _refuse(path, lines[0], f"names the units {units}")
    return _Named(columns, unit, rest)


def _numbers(path: Path, lines: Lines, mark: str | None, width: int, columns: list[int]) -> Points:
    """Return (n, 3). An empty cell is a point that was not seen, anything else that is no number is refused."""
    if not lines:
        return np.zeros((0, 3))
    commas = _decimal_commas(lines, mark)
    require_decimals(path, ((number, _split(line, mark)) for number, line in lines), mark, commas=commas)
    if commas:
        lines = [(number, line.replace(",", ".")) for number, line in lines]
    if all(len(line.split(mark)) == width for _, line in lines):
        text = io.StringIO("\n".join(line for _, line in lines))
        with suppress(ValueError):
            return np.loadtxt(text, delimiter=mark, comments=None, ndmin=2, usecols=columns)  # others may be no numbers
    points = []
    for line in lines:
        cells = _split(line[1], mark)
        chosen = [cells[i] or "nan" for i in columns] if len(cells) == width else [""]
        if not all(map(is_number, chosen)):
            _refuse(path, line, "is no row of numbers as the first")
        points.append([float(cell) for cell in chosen])
    return np.array(points)


def _refuse(path: Path, line: tuple[int, str], why: str) -> NoReturn:
    raise InputError(f'{path} line {line[0]}: "{line[1][:40]}" {why}; expected x, y, z in every line')

"""Clouds as text: a point a line, x y z, as XYZ (blanks) or CSV (commas, with or without a header)."""

import io
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.bounded_file import decode, read_bytes
from fabdesign.errors import InputError

_AXES = ("x", "y", "z")


def read_xyz(path: Path | str) -> NDArray[np.float64]:
    """(n, 3) points in the file's unit; n may be 0.

    Lines that are empty or start with # are skipped; numbers are parted by commas, semicolons or blanks. A header
    names the columns x, y and z; without one they are the first three, and a CSV has no others. Raises InputError.
    """
    path = Path(path)
    lines = [
        (number, line.strip())
        for number, line in enumerate(decode(read_bytes(path, "a cloud"), path).splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        return np.zeros((0, 3))
    comma = next((mark for mark in ",;" if mark in lines[0][1]), None)
    head = [cell.strip().strip('"').lower() for cell in lines[0][1].split(comma)]
    columns = (0, 1, 2)
    if not _is_number(head[0]):
        if len(set(head)) < len(head) or not set(_AXES) <= set(head):
            _refuse(path, lines[0], "is neither a point nor a header with x, y and z")
        columns = (head.index("x"), head.index("y"), head.index("z"))
        lines = lines[1:]
    elif len(head) < 3 or (comma and len(head) > 3):
        _refuse(path, lines[0], "has no header" if comma and len(head) > 3 else "is no point")
    if not lines:
        return np.zeros((0, 3))
    text = io.StringIO("\n".join(line for _, line in lines))
    try:
        table = np.loadtxt(text, delimiter=comma, comments=None, ndmin=2)
    except ValueError:
        table = np.zeros((0, 0))
    if table.shape != (len(lines), len(head)):
        bad = next((line for line in lines if not _is_row(line[1].split(comma), len(head))), lines[-1])
        _refuse(path, bad, "is no row of numbers as the first")
    return table[:, columns]


def _is_row(cells: list[str], width: int) -> bool:
    return len(cells) == width and all(map(_is_number, cells))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _refuse(path: Path, line: tuple[int, str], why: str) -> NoReturn:
    raise InputError(f'{path} line {line[0]}: "{line[1][:40]}" {why}; expected x, y, z in every line')

"""Pressures in: a CSV, a trial's npz, or one constant row such as "400,0,200". Pressures out: the CSV."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.csv_table import decimal, read_rows, write_rows
from fabdesign.design import Design
from fabdesign.effort import LONGEST
from fabdesign.errors import InputError
from fabdesign.pressure import PressureProgram, require_pressures
from fabdesign.table import kilopascals, pascals
from fabdesign.trial_file import program_of, read_trial_pressures

SINGLE_ROW_DURATION = 1.5  # s, of a program that has one row
_CONSTANT = re.compile(r"\s*[-+.\w]+(\s*,\s*[-+.\w]+)*\s*,?\s*")


def read_pressures(spec: str | Path, design: Design) -> PressureProgram:
    """The program that `spec` names (docs/files.md, "Pressures"), checked against the design's channels and limits.

    A CSV's motion ends one row interval after its last row (1.5 s for a single row), a trial's with its last frame.
    Raises InputError.
    """
    program = _read(spec)
    require_pressures(program, design, str(spec))
    return program


def constant_program(pressure: ArrayLike, duration: float = SINGLE_ROW_DURATION) -> PressureProgram:
    """One row of set points [Pa], (channels,), held for `duration` s."""
    return PressureProgram(np.zeros(1), np.atleast_2d(np.asarray(pressure, np.float64)), duration)


def write_pressures(program: PressureProgram, path: Path) -> None:
    """Write a program as a CSV that reads back as the same motion.

    The format has no duration of its own; where the last row's interval does not give it, the last row stands again
    midway to the end.
    """
    time = list(program.time)
    rows = list(program.pressure)
    rest = program.duration - time[-1]
    interval = time[-1] - time[-2] if len(time) > 1 else SINGLE_ROW_DURATION
    if rest > 0 and abs(interval - rest) > 1e-9:
        time.append(time[-1] + rest / 2)
        rows.append(rows[-1])
    header = ["time_s", *(f"channel_{i}" for i in range(program.pressure.shape[1]))]
    lines = [(repr(float(t)), *(_shortest(p) for p in row)) for t, row in zip(time, rows, strict=True)]
    write_rows(path, header, lines)


def _shortest(pressure: float) -> str:
    return f"{kilopascals(pressure).normalize():f}"


def _read(spec: str | Path) -> PressureProgram:
    path = Path(spec)
    if path.suffix == ".npz":
        return program_of(*read_trial_pressures(path))
    if isinstance(spec, str) and path.suffix != ".csv" and _CONSTANT.fullmatch(spec) and not _exists(path):
        return _read_constant(spec)
    return read_csv(path)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # no file's name is that long
        return False


def _read_constant(spec: str) -> PressureProgram:
    try:
        row = [pascals(cell.strip()) for cell in spec.strip().rstrip(",").split(",")]
    except ArithmeticError:
        raise InputError(f"{spec}: no such file, and no row of pressures in kPa such as 400,0,200") from None
    return constant_program(row)


def read_csv(path: Path) -> PressureProgram:
    """The program of a pressure CSV, not yet checked against a design. Raises InputError."""
    header, rows = read_rows(path)
    expected = ["time_s", *(f"channel_{i}" for i in range(len(header) - 1))]
    if header != expected:
        raise InputError(f"{path}: columns are {','.join(header)}; expected time_s,channel_0,channel_1,...")
    time, pressure = [], []
    for line, row in rows:
        cells = [decimal(cell, path, line, name) for cell, name in zip(row, header, strict=True)]
        time.append(float(cells[0]))
        pressure.append([pascals(cell) for cell in cells[1:]])
        if min(pressure[-1], default=0.0) < 0:
            raise InputError(f"{path} line {line}: a pressure below 0; expected kPa from 0")
        if len(time) == 1 and time[0] != 0:
            raise InputError(f"{path} line {line}: time_s = {time[0]:g}; expected the first row at 0")
        if time[-1] > LONGEST:
            raise InputError(f"{path} line {line}: time_s = {time[-1]:g}; expected at most {LONGEST:g} s")
        if len(time) > 1 and time[-1] <= time[-2]:
            raise InputError(f"{path} line {line}: time_s = {time[-1]:g} does not rise from the row before")
    duration = round(2 * time[-1] - time[-2], 9) if len(time) > 1 else SINGLE_ROW_DURATION
    return PressureProgram.of_rows(np.array(time), np.array(pressure).reshape(len(time), -1), duration=duration)

"""Pressures in: a CSV, a trial's npz, or one constant row such as "400,0,200" (kPa) or "2bar,0,29psi". Pressures out:
the CSV."""

import re
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.errors import InputError
from fabdesign.files.trial_file import program_of, read_trial_pressures
from fabdesign.formats.csv_table import write_rows
from fabdesign.formats.headings import UNITS, Unit, unit_of
from fabdesign.formats.lab_table import LabTable, TableColumn
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, require_pressures
from fabdesign.runtime.effort import LONGEST
from fabdesign.units import in_kpa, kilopascals

TABLES = (".csv", ".tsv", ".txt")  # endings of text tables
SINGLE_ROW_DURATION = 1.5  # s, of a program that has one row
_KPA = UNITS["kPa"]
_KILO = _KPA.factor  # `channel_0` without a unit is in kPa
_CONSTANT = re.compile(r"\s*[-+.\w]+(\s+[a-zA-Z]+)?(\s*,\s*[-+.\w]+(\s+[a-zA-Z]+)?)*\s*,?\s*")
_CELL = re.compile(r"([-+]?(?:[\d.]+(?:e[-+]?\d+)?|nan|inf))\s*([a-z]*)", re.IGNORECASE)
_WHICH = {"set", "setpoint", "soll", "command", "cmd", "target", "ref", "ist", "meas", "measured", "actual", "feedback"}
_SLIGHT = 1 / 40  # of the benches' largest pressure: 400 kPa written in bar is a hundredth of it


def pressure_file_of(pose: int) -> str:
    """Return the file's name in a folder of a design with several poses, which count from 1."""
    return "pressures.csv" if pose == 1 else f"pressures_{pose}.csv"


def read_pressures(spec: str | Path, design: Design) -> PressureProgram:
    """Return the program that `spec` names (docs/files.md), checked against the design's channels and limits.

    A CSV's motion ends one row interval after its last row (1.5 s for a single row), a trial's with its last frame.
    Raises InputError.
    """
    program = _read(spec)
    require_pressures(program, design, str(spec))
    return program


def told_slight(program: PressureProgram, design: Design, spec: str | Path) -> str:
    """Return a line where the pressures move next to nothing, as 2 bar written as kPa; else nothing."""
    return told_slight_pressure(float(program.pressure.max(initial=0.0)), design, str(spec))


def told_slight_pressure(highest: float, design: Design, where: str) -> str:
    """Return the line for the highest of some pressures [Pa]."""
    benches = [max(design.muscle_types[muscle.type].bench.pressure) for muscle in design.muscles]
    most = max(benches, default=0.0)
    if not 0 < highest < _SLIGHT * most:
        return ""
    return (
        f"{where}: the largest pressure is {in_kpa(highest):g} kPa, and the muscles' benches go to {in_kpa(most):g} "
        "kPa: next to nothing moves; a number without a unit is in kPa (2bar, 0.2MPa and 29psi are read too)"
    )


def constant_program(pressure: ArrayLike, duration: float = SINGLE_ROW_DURATION) -> PressureProgram:
    """Return one row of set points [Pa], (channels,), held for `duration` s."""
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
    if isinstance(spec, str) and path.suffix.lower() not in TABLES and _CONSTANT.fullmatch(spec) and not _exists(path):
        return _read_constant(spec)
    return read_csv(path)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # no file's name is that long
        return False


def _read_constant(spec: str) -> PressureProgram:
    """Return the program of one row; its cells are in kPa, or each in the unit that it names."""
    cells = [_CELL.fullmatch(cell.strip()) for cell in spec.strip().rstrip(",").split(",")]
    units = [None if cell is None else unit_of(cell[2]) if cell[2] else _KPA for cell in cells]
    try:
        row = [_in_pascals(cell, unit) for cell, unit in zip(cells, units, strict=True)]
    except ArithmeticError:
        raise InputError(
            f"{spec}: no such file, and no row of pressures such as 400,0,200 (kPa) or 4bar,0,29psi"
        ) from None
    named = {bool(cell[2]) for cell in cells if cell is not None and float(cell[1]) != 0}
    if len(named) > 1:
        raise InputError(f"{spec}: some pressures have a unit, others have none; expected one at each, or kPa at none")
    return constant_program(row)


def _in_pascals(cell: "re.Match[str] | None", unit: Unit | None) -> float:
    """Return the pressure of a cell, Pa. Raises ArithmeticError for what is no pressure."""
    if cell is None or unit is None or unit.dimension != "pressure":
        raise ArithmeticError
    return float(Decimal(cell[1]) * unit.factor)


def read_csv(path: Path) -> PressureProgram:
    """Return the program of a pressure CSV, not yet checked against a design. Raises InputError."""
    table = LabTable(path, "time_s,channel_0,channel_1,...")
    time_column = table.find("time")
    channels = _channels(table, time_column)
    table.say(["time_s", *(f"channel_{i}" for i in range(len(channels)))])
    rows = zip(table.cells(time_column), *map(table.cells, channels), strict=True)
    time: list[float] = []
    pressure: list[list[float]] = []
    for (line, _, second), *cells in rows:
        time.append(float(second))
        pressure.append([float(pascal) for _, _, pascal in cells])
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


def _channels(table: LabTable, time: TableColumn) -> list[TableColumn]:
    """Return every other column, in the order of their numbers; of columns under other names that have units of
    pressure, as they stand. Raises InputError where the numbers are not 0, 1, ..., where those of other names do not
    rise one by one, or a column is neither."""
    others = [i for i in range(len(table.headings)) if i != time.index]
    names = [table.headings[i].quantity for i in others]
    if all(name in (None, "pressure") for name in names):
        numbers = [number for i in others if (number := table.headings[i].number) is not None]
        kinds = {word for i in others for word in table.headings[i].name.split("_") if word in _WHICH}
        if len(kinds) > 1:
            raise table.bad(f"{' and '.join(sorted(kinds))} may be of one channel: channel_0, channel_1, ... say which")
        if len(others) > 1 and numbers and numbers != list(range(numbers[0], numbers[0] + len(others))):
            raise table.bad("the numbers of its columns do not rise one by one: channel_0, channel_1, ... say which")
        return [table.take(i, f"channel_{k}") for k, i in enumerate(others)]
    by_name = {f"channel_{k}" for k in range(len(others))}
    if set(names) != by_name or len(set(names)) < len(names):
        raise table.bad("one column a channel, from 0")
    return [
        table.find(name, default=_KILO if name in table.header else None)
        for name in sorted(by_name, key=lambda name: int(name.rpartition("_")[2]))
    ]

"""Pressures in: a CSV, a trial's npz, or one constant row such as "400,0,200" (kPa) or "2bar,0,29psi". Pressures out:
the CSV. Logs of a regulator or a DAQ: pressures or volts, at any rate, on their own clock."""

import os
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fabdesign.errors import InputError, note
from fabdesign.files.trial_file import program_of, read_trial_pressures
from fabdesign.formats.csv_table import write_rows
from fabdesign.formats.lab_table import UNITS, LabTable, require_measured_pressures, unit_of
from fabdesign.formats.schema import FileUnit, Kilopascal, Within
from fabdesign.formats.table import Table
from fabdesign.formats.toml_file import parsing
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, require_pressures
from fabdesign.runtime.effort import LONGEST
from fabdesign.units import in_kpa, kilopascals

TABLES = (".csv", ".tsv", ".txt")  # endings of text tables
SINGLE_ROW_DURATION = 1.5  # s, of a program that has one row
_KPA = UNITS["kPa"]  # of `channel_0` without a unit
_CONSTANT = re.compile(r"\s*[-+.\w]+(\s+[a-zA-Z]+)?(\s*,\s*[-+.\w]+(\s+[a-zA-Z]+)?)*\s*,?\s*")
_CELL = re.compile(r"([-+]?(?:[\d.]+(?:e[-+]?\d+)?|nan|inf))\s*([a-z]*)", re.IGNORECASE)
_WHICH = {"set", "setpoint", "soll", "command", "cmd", "target", "ref", "ist", "meas", "measured", "actual", "feedback"}
_SLIGHT = 1 / 40  # of the benches' largest pressure: 400 kPa written in bar is a hundredth of it
_SHIFT = "of the log's clock: the cameras' common time of its first row; absent: found by the steps"
_NOISE = 0.02  # of the largest pressure: below it a channel is at rest
_ROWS = 5_000_000


def pressure_file_of(pose: int) -> str:
    """Return the file's name in a folder of a design with several poses, which count from 1."""
    return "pressures.csv" if pose == 1 else f"pressures_{pose}.csv"


def read_pressures(spec: str | Path, design: Design) -> PressureProgram:
    """Return the program that `spec` names (docs/files.md), checked against the design's channels and limits.

    A CSV's motion ends one row interval after its last row (1.5 s for a single row), a trial's with its last frame.
    Raises InputError.
    """
    path = Path(spec)
    row = isinstance(spec, str) and path.suffix.lower() not in TABLES and not os.path.exists(path)  # noqa: PTH110 too long for one
    if path.suffix == ".npz":
        program = program_of(*read_trial_pressures(path))
    elif row and _CONSTANT.fullmatch(str(spec)):
        program = _read_constant(str(spec))
    else:
        program = read_csv(path)
    require_pressures(program, design, str(spec))
    return program


def note_slight(highest: float, design: Design, where: str) -> None:
    """Say where the highest of some pressures [Pa] moves next to nothing, as 2 bar written as kPa."""
    benches = [max(design.muscle_types[muscle.type].bench.pressure) for muscle in design.muscles]
    most = max(benches, default=0.0)
    if 0 < highest < _SLIGHT * most:
        note(
            f"{where}: the largest pressure is {in_kpa(highest):g} kPa, and the muscles' benches go to "
            f"{in_kpa(most):g} kPa: next to nothing moves; a number without a unit is in kPa (2bar, 0.2MPa and 29psi "
            "are read too)"
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
    lines = [
        (repr(float(t)), *(f"{kilopascals(p).normalize():f}" for p in row)) for t, row in zip(time, rows, strict=True)
    ]
    write_rows(path, header, lines)


def _read_constant(spec: str) -> PressureProgram:
    """Return the program of one row; its cells are in kPa, or each in the unit that it names."""
    cells = [_CELL.fullmatch(cell.strip()) for cell in spec.strip().rstrip(",").split(",")]
    row = []
    with parsing(spec, "no such file, and no row of pressures such as 400,0,200 (kPa) or 4bar,0,29psi"):
        for cell in cells:
            unit = unit_of(cell[2]) if cell and cell[2] else _KPA
            if cell is None or unit is None or unit.dimension != "pressure":
                raise ValueError(cell)
            row.append(float(Decimal(cell[1]) * unit.factor))
    named = {bool(cell[2]) for cell in cells if cell is not None and float(cell[1]) != 0}
    if len(named) > 1:
        raise InputError(f"{spec}: some pressures have a unit, others have none; expected one at each, or kPa at none")
    return constant_program(row)


def read_csv(path: Path) -> PressureProgram:
    """Return the program of a pressure CSV, not yet checked against a design. Raises InputError."""
    table = LabTable(path, "time_s,channel_0,channel_1,...")
    time_column = table.find("time")
    channels = _channels(table, time_column)
    table.say(["time_s", *(f"channel_{i}" for i in range(len(channels)))])
    time = table.numbers(time_column)
    pressure = np.array([table.numbers(column) for column in channels]).reshape(len(channels), len(time)).T
    table.refuse(pressure.min(axis=1, initial=0.0) < 0, lambda _: "a pressure below 0; expected kPa from 0")
    table.refuse(time[:1] != 0, lambda _: f"time_s = {time[0]:g}; expected the first row at 0")
    table.refuse(time > LONGEST, lambda row: f"time_s = {time[row]:g}; expected at most {LONGEST:g} s")
    table.require_rising("time_s", time)
    return PressureProgram.of_rows(time, pressure, duration=_until(time))


def _until(time: Array) -> float:
    """Return the end of the last row, which lasts as long as the one before."""
    return round(float(2 * time[-1] - time[-2]), 9) if len(time) > 1 else SINGLE_ROW_DURATION


def _channels(table: LabTable, time: int) -> list[int]:
    """Return the places of all other columns, in the order of their numbers; of columns under other names that have
    units of pressure, as they stand. Raises InputError where the numbers are not 0, 1, ..., where those of other names
    do not rise one by one, or a column is neither."""
    others = [i for i in range(len(table.headings)) if i != time]
    headings = [table.headings[i] for i in others]
    names = [heading.quantity for heading in headings]
    if all(name in (None, "pressure") for name in names):
        numbers = [heading.number for heading in headings if heading.number is not None]
        kinds = {word for heading in headings for word in heading.name.split("_") if word in _WHICH}
        if len(kinds) > 1:
            raise table.bad(f"{' and '.join(sorted(kinds))} may be of one channel: channel_0, channel_1, ... say which")
        if len(others) > 1 and numbers and numbers != list(range(numbers[0], numbers[0] + len(others))):
            raise table.bad("the numbers of its columns do not rise one by one: channel_0, channel_1, ... say which")
        return [table.take(i, f"channel_{k}") for k, i in enumerate(others)]
    channels = [f"channel_{k}" for k in range(len(others))]
    if {*names} != {*channels}:  # as many, so none stands twice
        raise table.bad("one column a channel, from 0")
    return [table.find(name, default=_KPA.factor if name in table.header else None) for name in channels]


@dataclass(frozen=True)
class PressureLog:
    """The way a log is written; by default a pressure.csv as everywhere."""

    file: Annotated[str, "in the recording's folder"] = "pressure.csv"
    per_volt: Annotated[tuple[Kilopascal, ...], "of columns in V; one, or one a channel"] = ()
    zero: Annotated[tuple[Annotated[float, FileUnit("V")], ...], "at 0 kPa; one, or one a channel"] = (0.0,)
    shift: Annotated[float | None, FileUnit("s"), Within(least=-LONGEST, most=LONGEST), _SHIFT] = None

    def resolved(self, table: Table) -> "PressureLog":
        """Raise InputError for a scale of nothing."""
        if any(scale == 0 for scale in self.per_volt):
            raise table.bad("per_volt", "kPa per V, not 0")
        return self


NO_LOG = PressureLog()


def read_pressure_log(log: PressureLog, folder: Path, design: Design) -> PressureProgram:
    """Return the pressures of a log, the first row at 0 s, checked against the design. Raises InputError."""
    path = folder / log.file
    if not log.per_volt:
        program = read_pressures(path, design)
    else:
        program = _of_volts(log, path, design)
        require_pressures(program, design, str(path))
    require_measured_pressures(program.pressure, str(path))
    return program


def _of_volts(log: PressureLog, path: Path, design: Design) -> PressureProgram:
    table = LabTable(path, "time_s and a column in V for each channel")
    time_column = table.find("time")
    columns = [i for i, heading in enumerate(table.headings) if heading.unit and heading.unit.dimension == "voltage"]
    if len(columns) != design.channels:
        raise table.bad(f"{len(columns)} columns in V for {design.channels} channels")
    numbers = [table.headings[i].number for i in columns]
    if None not in numbers and numbers != sorted(numbers, key=lambda n: n or 0):
        columns = [i for _, i in sorted(zip(numbers, columns, strict=True))]
        note(f"{path}: its columns in V are taken in the order of their numbers")
    for name, values in (("per_volt", log.per_volt), ("zero", log.zero)):
        if len(values) not in (1, design.channels):
            each = f"expected one, or {design.channels}, one a channel"
            raise InputError(f"{path}: {name} has {len(values)} numbers; {each}")
    if len(table.rows) > _ROWS:
        raise InputError(f"{path}: has {len(table.rows)} rows; expected at most {_ROWS}")
    time = table.numbers(time_column)
    volts = np.array([table.numbers(table.take(i, "voltage")) for i in columns]).T
    table.require_rising("time", time)
    if time[-1] - time[0] > LONGEST:
        raise InputError(f"{path}: lasts {time[-1] - time[0]:g} s; expected at most {LONGEST:g} s")
    pressure = (volts - np.array(log.zero)) * np.array(log.per_volt)
    highest, lowest = float(pressure.max(initial=0.0)), float(pressure.min(initial=0.0))
    if highest <= 0 or lowest < -max(5 * _NOISE * highest, 1e3):
        raise InputError(
            f"{path}: volts become {in_kpa(lowest):.3g} to {in_kpa(highest):.3g} kPa; expected gauge pressures from 0 "
            "(per_volt, zero?)"
        )
    quiet, time = np.where(pressure < _NOISE * highest, 0.0, pressure), time - time[0]
    return PressureProgram.of_rows(time, quiet, duration=_until(time))


def steps_of(program: PressureProgram, least: float = 0.1) -> list[tuple[float, float]]:
    """Return the instants [s] at which a pressure jumps by at least that share of the highest, and by how much [Pa]."""
    highest = float(program.pressure.max(initial=0.0))
    before = np.concatenate([np.zeros((1, program.pressure.shape[1])), program.pressure[:-1]])
    jump = np.abs(program.pressure - before).max(axis=1)
    return [(float(t), float(j)) for t, j in zip(program.time, jump, strict=True) if highest and j >= least * highest]

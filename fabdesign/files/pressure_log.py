"""Logs of a regulator or a DAQ: pressures or volts, at any rate, on their own clock."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, note
from fabdesign.files.pressure_file import SINGLE_ROW_DURATION, read_pressures
from fabdesign.formats.lab_table import LabTable
from fabdesign.formats.measured_units import require_measured_pressures
from fabdesign.formats.schema import FileUnit, Kilopascal, Within
from fabdesign.formats.table import Table
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, require_pressures
from fabdesign.runtime.effort import LONGEST
from fabdesign.units import in_kpa

Array = NDArray[np.float64]
_SHIFT = "of the log's clock: the cameras' common time of its first row; absent: found by the steps"
_NOISE = 0.02  # of the largest pressure: below it a channel is at rest
_ROWS = 5_000_000


@dataclass(frozen=True)
class PressureLog:
    """How a log is written; by default a pressure.csv as everywhere."""

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
    numbers = [heading.number for heading in (table.headings[i] for i in columns)]
    if None not in numbers and numbers != sorted(numbers, key=lambda n: n or 0):
        columns = [i for _, i in sorted(zip(numbers, columns, strict=True))]
        note(f"{path}: its columns in V are taken in the order of their numbers")
    scale, zero = (
        _for_each(values, name, design, path) for values, name in ((log.per_volt, "per_volt"), (log.zero, "zero"))
    )
    if len(table.rows) > _ROWS:
        raise InputError(f"{path}: has {len(table.rows)} rows; expected at most {_ROWS}")
    time = np.array([float(value) for _, _, value in table.cells(time_column)])
    volts = np.array([[float(v) for _, _, v in table.cells(table.take_volts(i))] for i in columns]).T
    if (np.diff(time) <= 0).any():
        row = int(np.flatnonzero(np.diff(time) <= 0)[0]) + 1
        raise InputError(f"{path} line {table.rows[row][0]}: time = {time[row]:g} does not rise from the row before")
    if time[-1] - time[0] > LONGEST:
        raise InputError(f"{path}: lasts {time[-1] - time[0]:g} s; expected at most {LONGEST:g} s")
    pressure = (volts - zero) * scale
    return _sound(time - time[0], pressure, path)


def _for_each(values: tuple[float, ...], name: str, design: Design, path: Path) -> Array:
    if len(values) not in (1, design.channels):
        raise InputError(f"{path}: {name} has {len(values)} numbers; expected one, or {design.channels}, one a channel")
    return np.broadcast_to(np.array(values, dtype=np.float64), (design.channels,))


def _sound(time: Array, pressure: Array, path: Path) -> PressureProgram:
    """Return the program without the noise about 0. Raises InputError where a pressure lies below it."""
    highest = float(pressure.max(initial=0.0))
    lowest = float(pressure.min(initial=0.0))
    if highest <= 0 or lowest < -max(5 * _NOISE * highest, 1e3):
        raise InputError(
            f"{path}: volts become {in_kpa(lowest):.3g} to {in_kpa(highest):.3g} kPa; expected gauge pressures from 0 "
            "(per_volt, zero?)"
        )
    duration = 2 * time[-1] - time[-2] if len(time) > 1 else SINGLE_ROW_DURATION
    return PressureProgram.of_rows(
        time, np.where(pressure < _NOISE * highest, 0.0, pressure), duration=round(duration, 9)
    )


def steps_of(program: PressureProgram, least: float = 0.1) -> list[tuple[float, float]]:
    """Return the instants [s] at which a pressure jumps by at least that share of the highest, and by how much [Pa]."""
    highest = float(program.pressure.max(initial=0.0))
    before = np.concatenate([np.zeros((1, program.pressure.shape[1])), program.pressure[:-1]])
    jump = np.abs(program.pressure - before).max(axis=1)
    return [(float(t), float(j)) for t, j in zip(program.time, jump, strict=True) if highest and j >= least * highest]

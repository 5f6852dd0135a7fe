"""A muscle's isometric bench table as a CSV: `pressure_kpa,contraction,force_n`."""

from dataclasses import dataclass
from pathlib import Path

from fabdesign.errors import InputError
from fabdesign.formats.csv_table import write_rows
from fabdesign.formats.lab_table import LabTable
from fabdesign.formats.measured_units import require_measured_pressures
from fabdesign.units import kilopascals


@dataclass(frozen=True)
class BenchTable:
    """Isometric tension of one bare muscle, as measured: one entry a row."""

    pressure: tuple[float, ...]  # Pa, gauge
    contraction: tuple[float, ...]  # 1 - l / l0
    force: tuple[float, ...]  # N, positive is tension


COLUMNS = ["pressure_kpa", "contraction", "force_n"]


def read_bench_table(path: Path) -> BenchTable:
    """Read a bench table, its columns in any order and unit that their headings say (`fabdesign.formats.lab_table`).

    Raises InputError for other columns, a bad number, a pressure below 0, a contraction of 1 or more, pressures that
    are in MPa or Pa, and a table that spans fewer than two pressures or two contractions.
    """
    table = LabTable(path, ",".join(COLUMNS))
    columns = [table.find(name) for name in ("pressure", "contraction", "force")]
    table.say(COLUMNS)
    pressure, contraction, force = [], [], []
    for (line, written, pascal), (_, share, shortening), (_, _, newton) in zip(*map(table.cells, columns), strict=True):
        if written < 0:
            heading = columns[0].heading.text
            raise InputError(f"{path} line {line}: {heading} = {written}; expected a gauge pressure from 0")
        if shortening >= 1:
            heading = columns[1].heading.text
            raise InputError(
                f"{path} line {line}: {heading} = {share}; expected 1 - l/l0, no percentage (contraction [%] is one)"
            )
        pressure.append(float(pascal))
        contraction.append(float(shortening))
        force.append(float(newton))
    for column, values in zip(columns, (pressure, contraction), strict=False):
        if len(set(values)) < 2:
            raise InputError(f"{path}: {column.heading.text} has one value only; a muscle's law needs at least two")
    require_measured_pressures(pressure, str(path))
    return BenchTable(tuple(pressure), tuple(contraction), tuple(force))


def write_bench_table(bench: BenchTable, path: Path) -> None:
    """Write a bench table; reading it gives the same one."""
    rows = zip(bench.pressure, bench.contraction, bench.force, strict=True)
    write_rows(path, COLUMNS, [(f"{kilopascals(p):f}", repr(c), repr(f)) for p, c, f in rows])

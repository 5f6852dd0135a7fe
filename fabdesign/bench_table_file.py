"""A muscle's isometric bench table as a CSV: `pressure_kpa,contraction,force_n`."""

from pathlib import Path

from fabdesign.csv_table import decimal, read_rows, write_rows
from fabdesign.errors import InputError
from fabdesign.measured_units import require_measured_pressures
from fabdesign.muscle import BenchTable
from fabdesign.table import kilopascals, pascals

COLUMNS = ["pressure_kpa", "contraction", "force_n"]


def read_bench_table(path: Path) -> BenchTable:
    """Read a bench table. Raises InputError for another header, a bad number, a pressure below 0, a contraction of
    1 or more, pressures that are in MPa or Pa, and a table that spans fewer than two pressures or two contractions."""
    header, rows = read_rows(path)
    if header != COLUMNS:
        raise InputError(f"{path}: columns are {','.join(header)}; expected {','.join(COLUMNS)}")
    pressure, contraction, force = [], [], []
    for line, row in rows:
        kpa, shortening, tension = (decimal(cell, path, line, name) for cell, name in zip(row, COLUMNS, strict=True))
        if kpa < 0:
            raise InputError(f"{path} line {line}: pressure_kpa = {kpa}; expected a gauge pressure from 0")
        if shortening >= 1:
            raise InputError(f"{path} line {line}: contraction = {shortening}; expected 1 - l/l0, no percentage")
        pressure.append(pascals(kpa))
        contraction.append(float(shortening))
        force.append(float(tension))
    for name, values in (("pressure_kpa", pressure), ("contraction", contraction)):
        if len(set(values)) < 2:
            raise InputError(f"{path}: {name} has one value only; a muscle's law needs at least two")
    require_measured_pressures(pressure, str(path))
    return BenchTable(tuple(pressure), tuple(contraction), tuple(force))


def write_bench_table(bench: BenchTable, path: Path) -> None:
    """Write a bench table; reading it gives the same one."""
    rows = zip(bench.pressure, bench.contraction, bench.force, strict=True)
    write_rows(path, COLUMNS, [(f"{kilopascals(p):f}", repr(c), repr(f)) for p, c, f in rows])

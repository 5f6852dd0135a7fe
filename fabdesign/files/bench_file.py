"""Bench records: `bench.toml`, `fabdesign.bench/1`, with a CSV a record beside it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats import lab_table
from fabdesign.formats.codec import as_number, decode
from fabdesign.formats.schema import Key
from fabdesign.formats.table import Table, load_toml
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import MUSCLES, Bench, BenchRecord, Specimen
from fabdesign.units import in_kpa

FORMAT = "fabdesign.bench/1"
_GAUGE = 0.02  # of the highest pressure: so far below zero a gauge may read without pressure
_RATIOS = {  # said of a column that is not there
    "contraction": " (1 - l/l0; of a length, with rest_length in [constants], m)",
    "stretch": " (l/l0; of a strain, or of a length or extension, with rest_length in [constants], m)",
}
_UNITS = {"kpa": 3, "s": 0, "m": 0, "n": 0}  # suffix of a column -> power of ten to SI


def _numbers(rest: Mapping[str, Any], table: Table) -> dict[str, float]:
    """Return all numbers of a table; texts are left."""
    values = {}
    for key, value in rest.items():
        if (number := as_number(value)) is not None and isfinite(number):
            values[key] = number
        elif number is not None or not isinstance(value, str):
            raise table.bad(key, "a number" if number is not None else "a number or a text")
    return values


def _constants(rest: Mapping[str, Any], table: Table) -> dict[str, float]:
    """Return the numbers at top level and in [constants]."""
    below = table.within(["constants"])
    top = {key: value for key, value in rest.items() if key != "constants"}
    return _numbers(top, table) | _numbers(below.take_rest(), below)


_CONSTANTS = Key(rest=True, read=_constants)  # numbers at top level, or in [constants]


@dataclass(frozen=True)
class RecordKeys:
    """One run, as the file has it."""

    file: Annotated[Path, "a CSV, a row an instant"]
    role: Annotated[Literal["fit", "test"], "nothing may be fitted or chosen on test"] = "fit"
    labels: Annotated[Mapping[str, float], Key(rest=True, read=_numbers), "any number"] = field(default_factory=dict)


@dataclass(frozen=True)
class BenchKeys:
    """A bench as its file has it."""

    specimen: Annotated[Specimen, "that is under test"]
    input: Annotated[tuple[str, ...], "names of columns"]
    output: Annotated[str, "name of a column"]
    name: Annotated[str, Key(absent=lambda table: table.file.resolve().parent.name), "by default the folder's"]
    description: str = ""
    source: str = ""
    records: tuple[RecordKeys, ...] = ()
    constants: Annotated[Mapping[str, float], _CONSTANTS, "of the specimen, SI"] = field(default_factory=dict)

    def resolved(self, table: Table) -> Bench:
        """Return the bench with all its records. Raises InputError."""
        path = table.file
        if not self.input:
            raise table.bad("input", "at least one column name")
        if not self.records:
            raise table.error("no [[records]]")
        names = [each.file.stem for each in self.records]
        for twice in {name for name in names if names.count(name) > 1}:
            raise table.error(f"two records are called {twice}")
        needed, length = (*self.input, self.output), self.constants.get("rest_length")
        records = tuple(
            BenchRecord(each.file.stem, read_record(each.file, needed, length), each.labels, each.role)
            for each in self.records
        )
        _require_units(records, path, self.specimen)
        bare = tuple(_bare(column)[0] for column in self.input)
        texts = (self.description, self.source, path)
        return Bench(self.name, self.specimen, bare, _bare(self.output)[0], self.constants, records, *texts)


def read_bench(path: Path | str) -> Bench:
    """Read a bench: its folder or its `bench.toml`, and all its records.

    The specimen's constants are the numbers at top level or in [constants], SI. Raises InputError for an unknown
    format or specimen, a missing file or column, a time that does not rise and a value that is no finite number.
    """
    path = Path(path)
    bench: Any = decode(BenchKeys, load_toml(path / "bench.toml" if path.is_dir() else path, FORMAT))
    return cast(Bench, bench)


def read_record(file: Path, needed: tuple[str, ...] = (), rest_length: float | None = None) -> dict[str, Array]:
    """Return columns (n,) of a record's CSV, SI, by their names without unit. rest_length: m, makes contraction and
    stretch of a length. Raises InputError where a `needed` one is not there, for two of one name, a value that is no
    finite number and a time that does not rise."""
    table = lab_table.LabTable(file, "columns such as time_s,pressure_kpa,force_n")
    columns: dict[str, Array] = {}
    for i, heading in enumerate(table.headings):
        bare = _taken(table, i, heading)
        if bare in columns:
            raise InputError(f"{file}: two columns hold {bare}")
        columns[bare] = table.numbers(i)
    for name, values in _ratios(columns, rest_length).items():
        columns.setdefault(name, values)
    for name in needed:
        quantity = _bare(name)[0]
        dimension = lab_table.DIMENSIONS.get(quantity)
        unit_stated = quantity != name or dimension == "ratio"  # in which unit
        if name not in table.header and not (unit_stated and quantity in columns):
            plain = [h.text for h in table.headings if h.symbol is None and h.quantity == quantity]
            unit = f" ({lab_table.without_unit(plain[0], dimension)})" if plain and dimension else _RATIOS.get(name, "")
            raise InputError(f"{file}: no column {name}; it has {', '.join(table.header)}{unit}")
    table.say([] if table.taken else table.header)
    if "time" in columns:
        table.require_rising("time_s", columns["time"])
    return columns


def _ratios(columns: dict[str, Array], rest_length: float | None) -> dict[str, Array]:
    """Return the contraction and stretch that a strain, a length or an extension says."""
    if "strain" in columns:
        return {"stretch": 1 + columns["strain"]}
    if not rest_length or rest_length < 0:
        return {}
    if "length" in columns:
        stretch = columns["length"] / rest_length
        return {"contraction": 1 - stretch, "stretch": stretch}
    return {"stretch": 1 + columns["displacement"] / rest_length} if "displacement" in columns else {}


def _taken(table: lab_table.LabTable, index: int, heading: lab_table.Heading) -> str:
    """Take a column and return its name: as the format writes it, or as a laboratory does where that names a
    quantity."""
    text, quantity = table.header[index], heading.quantity
    bare, power = _bare(text)
    if bare != text or quantity is None or heading.unit is None:
        table.factors[index] = Decimal(1).scaleb(power)
        return bare
    table.take(index, quantity)
    return quantity


def _require_units(records: tuple[BenchRecord, ...], path: Path, specimen: Specimen) -> None:
    """Require plausible units over all records, for one of them may be taken at no pressure or at rest."""
    pressures = [c for record in records for name, c in record.columns.items() if name.startswith("pressure")]
    if pressures:
        lab_table.require_measured_pressures(np.concatenate(pressures), str(path))
        lowest, highest = (float(f(np.concatenate(pressures))) for f in (np.min, np.max))
        if specimen in MUSCLES and lowest < -_GAUGE * highest:
            raise InputError(
                f"{path}: the lowest pressure is {in_kpa(lowest):.4g} kPa; expected gauge pressures of at least 0"
            )
    for record in records:
        contraction, stretch = (record.columns.get(name) for name in ("contraction", "stretch"))
        if contraction is not None and (contraction >= 1).any():
            raise InputError(f"{path}: {record.name}: contraction is {contraction.max():g}; expected 1 - l/l0")
        if stretch is not None and not 0.5 < stretch.max() < 20:
            raise InputError(f"{path}: {record.name}: stretch is {stretch.max():g}; expected l/l0, 1 at rest")


def _bare(column: str) -> tuple[str, int]:
    """Return a column's name without its unit, and the power of ten that takes its values to SI."""
    bare, _, unit = column.rpartition("_")
    return (bare, _UNITS[unit]) if bare and unit in _UNITS else (column, 0)


def is_bench(source: Path) -> bool:
    """Return whether it is a bench's folder, or its bench.toml."""
    return source.name == "bench.toml" or (source / "bench.toml").is_file()

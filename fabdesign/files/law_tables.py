"""Measured laws as a CSV: a cloth's membrane curve, `strain,tension_n_per_m,direction`, a muscle's isometric bench
table, `pressure_kpa,contraction,force_n`, and the law of a specimen that no design has, as `calibrate BENCH` writes it:
`fabdesign.bench-law/1` and a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomlkit
from numpy.typing import NDArray

from fabdesign.errors import InputError, note
from fabdesign.formats.codec import Encoder, decode
from fabdesign.formats.csv_table import decimal, read_raw_table, write_rows
from fabdesign.formats.lab_table import LabTable, require_measured_pressures
from fabdesign.formats.schema import ABOVE_0, Key, Metre
from fabdesign.formats.table import Table, load_toml
from fabdesign.output import write_text
from fabdesign.units import kilopascals

CURVE_COLUMNS = ["strain", "tension_n_per_m", "direction"]
_STRETCH = 0.9  # a first strain from here on is a stretch
_MOST = 5.0  # strain, more than any cloth bears
BENCH_COLUMNS = ["pressure_kpa", "contraction", "force_n"]
FORMAT = "fabdesign.bench-law/1"
LawSpecimen = Literal["strip", "cylinder", "actuator"]
# columns of the table by specimen; the first rises, or names a term
TABLES: Mapping[LawSpecimen, tuple[str, ...]] = {
    "strip": ("strain", "force_n", "low90_n", "high90_n"),
    "cylinder": ("term", "coefficient_n", "low90_n", "high90_n"),
    "actuator": ("pressure_kpa", "displacement_m"),
}
_RISING = {"strip": ("strain", "force_n"), "cylinder": (), "actuator": ("pressure_kpa", "displacement_m")}


@dataclass(frozen=True)
class MembraneCurve:
    """Sampled tension per width [N/m] over engineering strain, for direction 1 (across), 2 (down) or both."""

    strain: tuple[tuple[float, ...], tuple[float, ...]]  # per direction, rising; empty: the linear stiffness holds
    tension: tuple[tuple[float, ...], tuple[float, ...]]  # N/m


def read_membrane_curve(path: Path) -> MembraneCurve:
    """Read a membrane curve. `direction` is 1 (across), 2 (down) or `both`; without that column the curve holds for
    both. Raises InputError for another header, and unless strain and tension both rise from row to row."""
    table = LabTable(path, ",".join(CURVE_COLUMNS))
    columns = [table.find("strain"), table.find("tension")]
    place = next((i for i, heading in enumerate(table.headings) if heading.name == "direction"), None)
    if place is None and len(table.header) > 2:
        raise table.bad("direction is the third column")
    table.say(CURVE_COLUMNS if place is not None else CURVE_COLUMNS[:2])
    strain, tension = map(table.numbers, columns)
    names = [row[place] if place is not None else "both" for _, row in table.rows]
    known = np.isin(names, ("1", "2", "both"))
    table.refuse(~known, lambda row: f"direction = {names[row]!r}; expected 1 (across), 2 (down) or both")
    percentage = f"expected at most {_MOST:g} (strain [%] is a percentage)"
    table.refuse(strain > _MOST, lambda row: f"strain = {strain[row]:g}; {percentage}")
    each = [np.flatnonzero(np.isin(names, (direction, "both"))) for direction in ("1", "2")]
    for direction, rows in enumerate(each, start=1):
        for column, values in zip(CURVE_COLUMNS, (strain, tension), strict=False):
            table.require_rising(column, values, rows)
        if len(rows) == 1:
            raise InputError(f"{path}: direction {direction} has one row; a curve needs at least two")
    if (first := max(strain[rows[0]] for rows in each if len(rows))) >= _STRETCH:
        note(f"{path}: its strain begins at {first:g}; expected about 0 (is it the stretch, l / l0?)")
    across, down = each
    return MembraneCurve(
        (tuple(strain[across].tolist()), tuple(strain[down].tolist())),
        (tuple(tension[across].tolist()), tuple(tension[down].tolist())),
    )


def write_membrane_curve(curve: MembraneCurve, path: Path) -> None:
    """Write a membrane curve; reading it gives the same one."""
    rows = [
        (repr(strain), repr(tension), direction + 1)
        for direction in (0, 1)
        for strain, tension in zip(curve.strain[direction], curve.tension[direction], strict=True)
    ]
    write_rows(path, CURVE_COLUMNS, rows)


@dataclass(frozen=True)
class BenchTable:
    """Isometric tension of one bare muscle, as measured: one entry a row."""

    pressure: tuple[float, ...]  # Pa, gauge
    contraction: tuple[float, ...]  # 1 - l / l0
    force: tuple[float, ...]  # N, positive is tension


def read_bench_table(path: Path) -> BenchTable:
    """Read a bench table, its columns in any order and unit that their headings say (`fabdesign.formats.lab_table`).

    Raises InputError for other columns, a bad number, a pressure below 0, a contraction of 1 or more, pressures that
    are in MPa or Pa, and a table that spans fewer than two pressures or two contractions.
    """
    table = LabTable(path, ",".join(BENCH_COLUMNS))
    columns = [table.find(name) for name in ("pressure", "contraction", "force")]
    table.say(BENCH_COLUMNS)
    pressure, contraction, force = map(table.numbers, columns)
    table.refuse(pressure < 0, lambda row: f"{table.text(columns[0], row)}; expected a gauge pressure from 0")
    share = "expected 1 - l/l0, no percentage (contraction [%] is one)"
    table.refuse(contraction >= 1, lambda row: f"{table.text(columns[1], row)}; {share}")
    for column, values in zip(columns, (pressure, contraction), strict=False):
        if len(np.unique(values)) < 2:
            raise InputError(
                f"{path}: {table.headings[column].text} has one value only; a muscle's law needs at least two"
            )
    require_measured_pressures(pressure, str(path))
    return BenchTable(tuple(pressure.tolist()), tuple(contraction.tolist()), tuple(force.tolist()))


def write_bench_table(bench: BenchTable, path: Path) -> None:
    """Write a bench table; reading it gives the same one."""
    rows = zip(bench.pressure, bench.contraction, bench.force, strict=True)
    write_rows(path, BENCH_COLUMNS, [(f"{kilopascals(p):f}", repr(c), repr(f)) for p, c, f in rows])


def _law_columns(path: Path, law: Table) -> dict[str, NDArray[Any]]:
    """Return the table of a law. Raises InputError for another one, and keys of another specimen."""
    specimen = law.find("specimen")
    for key in ("form", "presliding"):
        if law.has(key) != (specimen == "cylinder"):
            raise law.error(f"unknown key {key}") if law.has(key) else law.missing(key)
    return read_law_table(path, specimen)


@dataclass(frozen=True, eq=False)
class BenchLaw:
    """A quasi-static law, sampled. columns: (n,) each, in the file's units, by the names in TABLES.

    strip: force [N] over strain, with the 90 % band of another record. actuator: displacement [m] held at a pressure.
    cylinder: force [N] as a sum of terms in p (pressure / 100 kPa), x (displacement / 10 mm) and s (state of friction,
    from -1 to 1), which follows the motion over the `presliding` distance; a term is the product of its factors.
    """

    specimen: Annotated[LawSpecimen, Key("law.specimen"), "that was on the bench"]
    output: Annotated[str, Key("law.output"), "force or displacement"]
    columns: Annotated[Mapping[str, NDArray[Any]], Key("law.table", form=Path, read=_law_columns), "a CSV beside it"]
    form: Annotated[str | None, Key("law.form"), "of a cylinder: the choice of terms"] = None
    presliding: Annotated[Metre | None, Key("law.presliding"), ABOVE_0, "of a cylinder: of its friction"] = None

    @property
    def terms(self) -> tuple[str, ...]:
        """Return the terms of a cylinder, such as "s p"; none of others."""
        return tuple(map(str, self.columns.get("term", ())))


def read_bench_law(path: Path | str) -> BenchLaw:
    """Read a law with its table. Raises InputError for an unknown specimen, another table, values not rising."""
    return decode(BenchLaw, load_toml(Path(path), FORMAT))


def write_bench_law(law: BenchLaw, path: Path, table: Path, *, comment: str = "") -> None:
    """Write `path`, and the `table` that it names, both in one folder; reading gives an equal law."""
    document = tomlkit.document()
    if comment:
        document.add(tomlkit.comment(comment))
    document["format"] = FORMAT
    document.update(Encoder(table, {dict: lambda columns: table.name}).encode(law))
    header = TABLES[law.specimen]
    write_rows(table, header, list(zip(*(law.columns[name].tolist() for name in header), strict=True)))
    write_text(path, tomlkit.dumps(document))


def read_law_table(file: Path, specimen: LawSpecimen) -> dict[str, NDArray[Any]]:
    """Return the columns, (n,) each: numbers, and a cylinder's terms. Raises InputError."""
    header, rows, *_ = read_raw_table(file)
    if tuple(header) != TABLES[specimen]:
        raise InputError(f"{file}: columns are {','.join(header)}; expected {','.join(TABLES[specimen])}")
    columns: dict[str, NDArray[Any]] = {}
    for i, name in enumerate(header):
        if name == "term":
            for line, row in rows:
                if not row[i] or not set(row[i].split()) <= {"1", "p", "x", "s"}:
                    raise InputError(f"{file} line {line}: term = {row[i]!r}; expected a product of p, x and s, or 1")
            columns[name] = np.array([row[i] for _, row in rows])
            continue
        columns[name] = np.array([float(decimal(row[i], file, line, name)) for line, row in rows])
        if name in _RISING[specimen] and (len(rows) < 2 or (np.diff(columns[name]) <= 0).any()):
            raise InputError(f"{file}: {name} does not rise from row to row; expected two rows or more that do")
    return columns


def why_not_included(path: Path) -> str:
    """Return one sentence on a law that a design asks for by `include`. Raises InputError for an unsound file."""
    law = read_bench_law(path)
    if law.specimen == "strip":
        return "is the force law of a strip whose width is not known; state width [m] in its bench and calibrate again"
    return (
        f"is the law of {'an' if law.specimen == 'actuator' else 'a'} {law.specimen}; a design has muscles and a cloth"
    )

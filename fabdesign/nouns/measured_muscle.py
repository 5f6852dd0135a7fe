"""A muscle type of a user's own for a layout of the catalogue: from what `calibrate` wrote, or from a bench table."""

from dataclasses import replace
from pathlib import Path

from fabdesign.errors import InputError, note
from fabdesign.files.bench_table_file import read_bench_table
from fabdesign.files.design_file import read_part
from fabdesign.nouns.catalogue import standard
from fabdesign.nouns.muscle import MuscleType
from fabdesign.nouns.term import Term
from fabdesign.units import in_kpa


def read_own_muscle(file: Path, name: str) -> tuple[MuscleType, tuple[Term, ...]]:
    """Return the muscle type `name` and the effects that its bench showed.

    file: a TOML with [muscle_types.NAME], as `fabdesign calibrate BENCH -o TYPE.toml` writes it, or a CSV
    pressure_kpa,contraction,force_n, whose muscle has the sizes of EM20. Raises InputError for any other.
    """
    if file.suffix.lower() == ".toml":
        part = read_part(file)
        if name not in part.types:
            known = ", ".join(part.types) or "no muscle type"
            raise InputError(f"{file}: has no muscle type {name}; it has {known}")
        return _limited(part.types[name]), part.effects
    if file.is_dir():
        raise InputError(f"{file}: a folder; expected the file that `fabdesign calibrate {file} -o TYPE.toml` writes")
    (like,) = standard().muscle_types.values()
    note(f"{file}: a table without sizes; outer_diameter, mass_per_length and axis_offset are those of {like.name}")
    bench = read_bench_table(file)
    own = MuscleType(name, like.outer_diameter, like.mass_per_length, like.axis_offset, bench, like.viscosity)
    return _limited(own), ()


def _limited(kind: MuscleType) -> MuscleType:
    """Return the type with the bench's highest pressure as its maximum, where it states none."""
    if kind.max_pressure is not None:
        return kind
    highest = max(kind.bench.pressure)
    note(f"{kind.name}: max_pressure is the highest on its bench, {in_kpa(highest):g} kPa")
    return replace(kind, max_pressure=highest)

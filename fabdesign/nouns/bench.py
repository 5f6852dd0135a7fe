"""Benches: one specimen under test, measured row by row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array

Specimen = Literal["muscle", "strip", "cylinder", "actuator"]
MUSCLES: tuple[Specimen, ...] = ("muscle",)  # whose calibration is a muscle type, which designs include


@dataclass(frozen=True, eq=False)
class BenchRecord:
    """One run. columns: (n,) each, SI (Pa, m, N, s), by the file's names without their unit."""

    name: str  # of its file, without .csv
    columns: Mapping[str, Array]
    labels: Mapping[str, float]  # what the record says of itself: repeat, supply_bar, ...
    role: Literal["fit", "test"] = "fit"  # nothing may be fitted or chosen on "test"

    def first(self, names: Sequence[str]) -> Array | None:
        """Return the first of these columns that it has; None where it has none."""
        return next((self.columns[name] for name in names if name in self.columns), None)


@dataclass(frozen=True, eq=False)
class Bench:
    """A specimen's records. input and output are column names without units."""

    name: str
    specimen: Specimen
    input: tuple[str, ...]
    output: str
    constants: Mapping[str, float]  # of the specimen, SI
    records: tuple[BenchRecord, ...]
    description: str = ""
    source: str = ""
    file: Path = Path("bench.toml")

    @property
    def is_muscle(self) -> bool:
        return self.specimen in MUSCLES

    def of_role(self, role: str) -> list[BenchRecord]:
        """Return the records of a role."""
        return [record for record in self.records if record.role == role]

    def constant(self, name: str) -> float:
        """Return a constant. Raises InputError where the bench does not state it."""
        if name not in self.constants:
            raise InputError(f"{self.file}: {name} of the specimen is missing; expected a number in SI units")
        return self.constants[name]

"""Benches: one specimen under test, measured row by row."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError

Specimen = Literal["muscle", "strip", "cylinder", "actuator"]
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BenchRecord:
    """One run. columns: (n,) each, SI (Pa, m, N, s), by the file's names without their unit."""

    name: str  # of its file, without .csv
    columns: Mapping[str, Array]
    labels: Mapping[str, float]  # what the record says of itself: repeat, supply_bar, ...
    role: Literal["fit", "test"] = "fit"  # nothing may be fitted or chosen on "test"


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

    def constant(self, name: str) -> float:
        """Return a constant. Raises InputError where the bench does not state it."""
        if name not in self.constants:
            raise InputError(f"{self.file}: {name} of the specimen is missing; expected a number in SI units")
        return self.constants[name]

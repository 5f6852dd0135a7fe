"""What a specimen's records must hold for `calibrate` to find its law, and what they measure in which unit."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.nouns.bench import Bench, BenchRecord, Specimen
from fabdesign.nouns.muscle import WIDEST
from studies.benches import actuator, rows
from studies.benches.actuator import hold_of
from studies.benches.rows import FORCES

# of each group of columns, one is needed
COLUMNS: Mapping[Specimen, tuple[tuple[str, ...], ...]] = {
    "muscle": (rows.PRESSURES, ("contraction",), rows.FORCES),
    "strip": (("stretch",), ("force",)),
    "cylinder": (("pressure",), ("displacement",), ("force",)),
    "actuator": (("time",), actuator.PRESSURES, ("displacement",)),
}
SIZES = ("outer_diameter", "mass_per_length", "axis_offset")  # m, kg/m, m: a muscle type has them, no bench shows them


def require_columns(bench: Bench, records: Sequence[BenchRecord]) -> None:
    """Raise InputError for a record without a column that the specimen's law is fitted to."""
    for record in records:
        for group in COLUMNS[bench.specimen]:
            if not set(group) & record.columns.keys():
                raise InputError(
                    f"{bench.file}: {record.name}: no column {' or '.join(group)}, which a {bench.specimen} needs; "
                    f"it has {', '.join(record.columns)}"
                )


def require_sizes(bench: Bench) -> None:
    """Raise InputError for a muscle bench that does not state what a muscle type needs beyond its law."""
    missing = [name for name in SIZES if name not in bench.constants]
    if bench.specimen == "muscle" and missing:
        raise InputError(
            f"{bench.file}: [constants] lack {', '.join(missing)}; expected numbers in SI units, for a muscle type"
        )
    diameter = bench.constants.get("outer_diameter", 0.0)
    if bench.specimen == "muscle" and diameter > WIDEST:
        raise InputError(
            f"{bench.file}: outer_diameter = {diameter:g}; expected at most {WIDEST:g} m (is it in millimetres?)"
        )


def unit_of(specimen: Specimen) -> str:
    """N, of an actuator m."""
    return "m" if specimen == "actuator" else "N"


def output_of(bench: Bench) -> str:
    """Return the column that is compared row by row; of an actuator the displacement."""
    return "displacement" if bench.specimen == "actuator" else bench.output


def measured(specimen: Specimen, record: BenchRecord) -> NDArray[np.float64]:
    """(n,) N; of an actuator (1,) m, the level held."""
    if specimen == "actuator":
        return np.array([hold_of(record).level])
    return record.columns[next(name for name in FORCES if name in record.columns)]

"""The specimens that a bench may have, each with its law; and what their records must hold."""

from collections.abc import Mapping, Sequence

from fabdesign.errors import InputError
from fabdesign.nouns.bench import Bench, BenchRecord, Specimen
from fabdesign.nouns.muscle import WIDEST
from fabdesign.units import in_mm
from studies.benches.actuator import StaticCurve
from studies.benches.cylinder import CylinderLaw
from studies.benches.law import Law
from studies.benches.muscle import BenchMuscle
from studies.benches.strip import StripLaw

LAWS: Mapping[Specimen, type[Law]] = {
    "muscle": BenchMuscle,
    "strip": StripLaw,
    "cylinder": CylinderLaw,
    "actuator": StaticCurve,
}
LEAST_SHOWN = 0.001  # mm or N: what no gauge reads
SIZES = ("outer_diameter", "mass_per_length", "axis_offset")  # m, kg/m, m: a muscle type has them, no bench shows them


def require_columns(bench: Bench, records: Sequence[BenchRecord]) -> None:
    """Raise InputError for a record without a column that the specimen's law is fitted to."""
    for record in records:
        for group in LAWS[bench.specimen].columns:
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


def unit_of(bench: Bench) -> str:
    """Return the SI unit of what is predicted: N, of an actuator m."""
    return LAWS[bench.specimen].unit


def for_people(unit: str) -> tuple[float, str]:
    """Return the factor on values in an SI unit that people are shown, and the unit that they see: mm for m."""
    return (in_mm(1.0), "mm") if unit == "m" else (1.0, unit)


def shown(value: float, unit: str) -> str:
    """Return a value in an SI unit, as people are shown it."""
    factor, name = for_people(unit)
    return f"{factor * value:.3g} {name}"


def output_of(bench: Bench) -> str:
    """Return the column that is compared row by row; of an actuator the displacement."""
    return LAWS[bench.specimen].output or bench.output

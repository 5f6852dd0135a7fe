"""What `calibrate BENCH` wrote, as what it predicts of a bench's records."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.bench import Bench, BenchRecord
from fabdesign.bench_law_file import FORMAT as BENCH_LAW
from fabdesign.bench_law_file import BenchLaw, read_bench_law
from fabdesign.design_file import DesignPart, read_part
from fabdesign.errors import InputError
from fabdesign.muscle_law import law_of
from fabdesign.table import parse_toml
from fabdesign.units import from_kpa
from studies.benches.actuator import StaticCurve, hold_of
from studies.benches.cylinder import terms_of
from studies.benches.muscle import BenchMuscle

Array = NDArray[np.float64]
Predict = Callable[[BenchRecord], tuple[Array, Array]]  # (n,) at rest, in motion; of an actuator (1,), the level held


def prediction(path: Path, bench: Bench) -> Predict:
    """What the file says of the bench's records: without what motion adds (friction, viscosity, effects), and with it.

    Raises InputError for a file of another specimen, and for a cloth where the bench does not state the strip's width.
    """
    if parse_toml(path).get("format") == BENCH_LAW:
        law = read_bench_law(path)
        if law.specimen != bench.specimen:
            raise InputError(f"{path}: the law of specimen {law.specimen}; {bench.file} has {bench.specimen}")
        return _of_law(law)
    part = read_part(path)
    if bench.specimen == "muscle":
        return _of_muscle(part, path, bench)
    if bench.specimen != "strip" or part.fabric is None or (curve := part.fabric.membrane_curve) is None:
        raise InputError(f"{path}: no law of a {bench.specimen}, which {bench.file} has; expected what calibrate wrote")
    width, across = bench.constant("width"), 1 if bench.constants.get("direction") == 2 else 0
    strain, force = np.array(curve.strain[across]), width * np.array(curve.tension[across])
    return _of_strip(strain, force)


def _of_law(law: BenchLaw) -> Predict:
    if law.specimen == "strip":
        return _of_strip(law.columns["strain"], law.columns["force_n"])
    if law.specimen == "actuator":
        curve = StaticCurve(from_kpa(law.columns["pressure_kpa"]), law.columns["displacement_m"], ())
        return lambda record: _twice(np.atleast_1d(curve.displacement(hold_of(record).pressure)))
    coefficients, presliding = law.columns["coefficient_n"], law.presliding or 1.0
    still = np.array(["s" not in term for term in law.terms])

    def cylinder(record: BenchRecord) -> tuple[Array, Array]:
        columns = terms_of(record, law.terms, presliding)
        return columns @ (still * coefficients), columns @ coefficients

    return cylinder


def _of_strip(strain: Array, force: Array) -> Predict:
    """Linear between the samples and beyond them."""
    slopes = np.diff(force) / np.diff(strain)

    def strip(record: BenchRecord) -> tuple[Array, Array]:
        x = record.columns["stretch"] - 1
        k = np.clip(np.searchsorted(strain, x) - 1, 0, len(slopes) - 1)
        return _twice(force[k] + slopes[k] * (x - strain[k]))

    return strip


def _of_muscle(part: DesignPart, path: Path, bench: Bench) -> Predict:
    name = bench.name if bench.name in part.types else next(iter(part.types), None)
    if name is None or (name != bench.name and len(part.types) > 1):
        raise InputError(f"{path}: muscle types {', '.join(part.types) or 'none'}; expected one, or {bench.name}")
    muscle = part.types[name]
    terms = tuple(term for term in part.effects if term.scope in (None, f"muscle_types.{name}"))
    still = BenchMuscle(law_of(muscle.bench), None, None, None, None, 0.0, ())
    moving = replace(still, viscosity=muscle.viscosity or None, terms=terms)
    return lambda record: (still.predict(record), moving.predict(record))


def _twice(values: Array) -> tuple[Array, Array]:
    return np.asarray(values), np.asarray(values)

"""Predictions of a bench's records by a law in a file, and how far these are off, for `calibrate` and `evaluate`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects import EFFECTS
from fabdesign.errors import InputError
from fabdesign.files.bench_law_file import FORMAT as BENCH_LAW
from fabdesign.files.bench_law_file import BenchLaw, read_bench_law
from fabdesign.files.design_file import DesignPart, read_part
from fabdesign.formats.toml_file import parse_toml
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.model import EffectTerm
from fabdesign.nouns.muscle_law import MuscleLaw, law_of
from fabdesign.nouns.term import Term
from fabdesign.units import from_kpa
from studies.benches.actuator import StaticCurve, hold_of
from studies.benches.cylinder import CylinderLaw, terms_of
from studies.benches.muscle import BenchMuscle
from studies.benches.records import measured
from studies.benches.strip import StripLaw

Array = NDArray[np.float64]
Law = BenchMuscle | StripLaw | CylinderLaw | StaticCurve
Predict = Callable[[BenchRecord], tuple[Array, Array]]  # (n,) at rest, in motion; of an actuator (1,), the level held


@dataclass(frozen=True)
class RecordErrors:
    """Root mean squares over a record's rows, in the output's SI unit; of an actuator the level held. before: without
    what motion adds (friction, viscosity, effects)."""

    before: float
    after: float


def errors_of(predict: Predict, bench: Bench, records: Sequence[BenchRecord]) -> list[RecordErrors]:
    """Return the errors of a prediction on records."""

    def errors(record: BenchRecord) -> RecordErrors:
        truth = measured(bench.specimen, record)
        return RecordErrors(*(float(np.sqrt(np.mean((values - truth) ** 2))) for values in predict(record)))

    return [errors(record) for record in records]


def as_written(law: Law, *, sized: bool) -> Predict:
    """Return what the file of a fitted law says: its table or samples, without a muscle's constant hysteresis and
    without what belongs to the bench's rig. sized: whether a strip's width is known, so that its law is a cloth's,
    whose tension begins at zero."""
    if isinstance(law, BenchMuscle):
        return _of_type(law_of(law.table()), law.viscosity, [term for term in law.terms if travels(term)])
    if isinstance(law, StripLaw):
        strain, force = law.samples()
        return _of_strip(strain, force if sized else law.force(1 + strain))
    if isinstance(law, CylinderLaw):
        return _of_cylinder(law.coefficients, law.terms, law.presliding)
    return _of_actuator(law)


def as_fitted(law: Law, record: BenchRecord) -> Array:
    """Return what a fitted law says of a record with all that was fitted."""
    if isinstance(law, StaticCurve):
        return np.atleast_1d(law.displacement(hold_of(record).pressure))
    return law.predict(record)


def travels(effect: EffectTerm | Term) -> bool:
    """Return whether an effect belongs to the muscle; a bench's regulator stays where it is."""
    return EFFECTS[effect.name].scope == "muscle type"


def prediction(path: Path, bench: Bench) -> Predict:
    """Return what the file says of the bench's records: without and with friction, viscosity, effects.

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
    if not curve.strain[across]:
        raise InputError(f"{path}: its curve has no direction {across + 1}, which {bench.file} has")
    strain, force = np.array(curve.strain[across]), width * np.array(curve.tension[across])
    return _of_strip(strain, force)


def _of_law(law: BenchLaw) -> Predict:
    if law.specimen == "strip":
        return _of_strip(law.columns["strain"], law.columns["force_n"])
    if law.specimen == "actuator":
        return _of_actuator(StaticCurve(from_kpa(law.columns["pressure_kpa"]), law.columns["displacement_m"], ()))
    return _of_cylinder(law.columns["coefficient_n"], law.terms, law.presliding or 1.0)


def _of_actuator(curve: StaticCurve) -> Predict:
    return lambda record: _twice(as_fitted(curve, record))


def _of_cylinder(coefficients: Array, terms: Sequence[str], presliding: float) -> Predict:
    still = np.array(["s" not in term for term in terms])

    def cylinder(record: BenchRecord) -> tuple[Array, Array]:
        columns = terms_of(record, terms, presliding)
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
    return _of_type(law_of(muscle.bench), muscle.viscosity, terms)


def _of_type(law: MuscleLaw, viscosity: float | None, terms: Sequence[Term]) -> Predict:
    still = BenchMuscle(law, None, None, None, None, 0.0, ())
    moving = replace(still, viscosity=viscosity or None, terms=tuple(terms))
    return lambda record: (still.predict(record), moving.predict(record))


def _twice(values: Array) -> tuple[Array, Array]:
    return np.asarray(values), np.asarray(values)

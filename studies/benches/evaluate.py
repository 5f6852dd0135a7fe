"""How far a law that was fitted to a bench is from its records."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.bench import Bench, BenchRecord
from fabdesign.bench_file import read_bench
from fabdesign.bench_law_file import FORMAT as BENCH_LAW
from fabdesign.bench_law_file import BenchLaw, read_bench_law
from fabdesign.design_file import DesignPart, read_part
from fabdesign.errors import InputError
from fabdesign.metrics import Statistics
from fabdesign.muscle_law import law_of
from fabdesign.toml_file import parse_toml
from fabdesign.units import from_kpa
from studies.benches.actuator import StaticCurve, hold_of
from studies.benches.calibrate import LEAST_SHOWN
from studies.benches.cylinder import terms_of
from studies.benches.muscle import BenchMuscle
from studies.benches.records import measured, require_columns, unit_of

METRIC = "rms"
Array = NDArray[np.float64]
Predict = Callable[[BenchRecord], tuple[Array, Array]]  # (n,) at rest, in motion; of an actuator (1,), the level held


@dataclass(frozen=True)
class RecordErrors:
    """Root mean squares over a record's rows, in the output's SI unit; of an actuator the level held. before: without
    what motion adds (friction, viscosity, effects)."""

    before: float
    after: float


@dataclass(frozen=True, eq=False)
class BenchEvaluation:
    """tests, others: by record, of role test and of role fit."""

    bench: Bench
    unit: str  # N or m
    tests: Mapping[str, RecordErrors]
    others: Mapping[str, RecordErrors]

    def as_json(self) -> dict[str, Any]:
        """What `evaluate BENCH --json` prints."""
        result: dict[str, Any] = {"designs": {self.bench.name: self._table(self.tests)} if self.tests else {}}
        if self.others:
            result["others"] = {self.bench.name: self._table(self.others)}
        return result | {"metric": METRIC, "unit": self.unit}

    def _table(self, records: Mapping[str, RecordErrors]) -> dict[str, Any]:
        return {
            "before": {METRIC: asdict(_statistics(records, "before"))},
            "after": {METRIC: asdict(_statistics(records, "after"))},
            "source": self.bench.source or self.bench.description,
            "records": {name: asdict(errors) for name, errors in records.items()},
        }

    def as_markdown(self) -> str:
        """Tables for people, in N or mm."""
        factor, unit = (1e3, "mm") if self.unit == "m" else (1.0, self.unit)

        def shown(value: float) -> str:
            return f"{factor * value:.3g}" if factor * value >= LEAST_SHOWN else "0"

        head, lines = f"| record | before, {unit} | after, {unit} |", []
        for title, records in (("test", self.tests), ("fit", self.others)):
            if records:
                lines += [f"## Records of role {title}", "", head, "|---|---|---|"]
                lines += [f"| {name} | {shown(e.before)} | {shown(e.after)} |" for name, e in records.items()]
                means = (_statistics(records, state).mean for state in ("before", "after"))
                lines += [f"| mean | {' | '.join(map(shown, means))} |", ""]
        return "\n".join([*lines, f"{self.bench.name}: {self.bench.source or self.bench.description}"])


def evaluate_bench(path: Path, law: Path, *, all_records: bool = False) -> BenchEvaluation:
    """Errors on the records of role `test`, with `all_records` on those of role `fit` too, in a table of their own, of
    the law in the file `law`, which `calibrate` wrote. Raises InputError, also where there is no such record."""
    bench = read_bench(path)
    require_columns(bench, bench.records)
    predict = prediction(law, bench)

    def errors(record: BenchRecord) -> RecordErrors:
        truth = measured(bench.specimen, record)
        return RecordErrors(*(float(np.sqrt(np.mean((law - truth) ** 2))) for law in predict(record)))

    tests = {record.name: errors(record) for record in bench.records if record.role == "test"}
    others = {record.name: errors(record) for record in bench.records if record.role == "fit" and all_records}
    if not tests and not others:
        raise InputError(f"{bench.file}: no record of role test; expected one, or --all for those of role fit")
    return BenchEvaluation(bench, unit_of(bench.specimen), tests, others)


def _statistics(records: Mapping[str, RecordErrors], state: str) -> Statistics:
    return Statistics.of(np.array([getattr(errors, state) for errors in records.values()]))


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

"""How well a law in a file predicts a bench's records: its predictions, and the errors that `calibrate` and `evaluate`
say."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.files.design_file import read_part
from fabdesign.files.law_tables import FORMAT as BENCH_LAW
from fabdesign.files.law_tables import read_bench_law
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.formats.toml_file import parse_toml
from fabdesign.geometry.metrics import Statistics
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.muscle_law import law_of
from fabdesign.nouns.trial import Role
from studies.benches.law import Predict, rms
from studies.benches.muscle import of_type
from studies.benches.records import LAWS, LEAST_SHOWN, BenchNoise, for_people, noise_of, require_columns
from studies.benches.strip import of_strip


@dataclass(frozen=True)
class RecordErrors:
    """Root mean squares over a record's rows, in the output's SI unit; of an actuator the level held. before: without
    what motion adds (friction, viscosity, effects)."""

    before: float
    after: float


def errors_of(predict: Predict, bench: Bench, records: Sequence[BenchRecord]) -> list[RecordErrors]:
    """Return the errors of a prediction on records."""
    measured = LAWS[bench.specimen].measured
    return [RecordErrors(*(rms(values - measured(record)) for values in predict(record))) for record in records]


def prediction(path: Path, bench: Bench) -> Predict:
    """Return what the file says of the bench's records: without and with friction, viscosity, effects.

    Raises InputError for a file of another specimen, and for a cloth where the bench does not state the strip's width.
    """
    if parse_toml(path).get("format") == BENCH_LAW:
        law = read_bench_law(path)
        if law.specimen != bench.specimen:
            raise InputError(f"{path}: the law of specimen {law.specimen}; {bench.file} has {bench.specimen}")
        return LAWS[bench.specimen].read(law)
    part = read_part(path)
    if bench.is_muscle:
        name = bench.name if bench.name in part.types else next(iter(part.types), None)
        if name is None or (name != bench.name and len(part.types) > 1):
            names = ", ".join(part.types) or "none"
            raise InputError(f"{path}: muscle types {names}; expected one, or {bench.name}")
        terms = [term for term in part.effects if term.scope in (None, f"muscle_types.{name}")]
        return of_type(law_of(part.types[name].bench), part.types[name].viscosity, terms)
    if bench.specimen != "strip" or part.fabric is None or (curve := part.fabric.membrane_curve) is None:
        raise InputError(f"{path}: no law of a {bench.specimen}, which {bench.file} has; expected what calibrate wrote")
    width, across = bench.constant("width"), 1 if bench.constants.get("direction") == 2 else 0
    if not curve.strain[across]:
        raise InputError(f"{path}: its curve has no direction {across + 1}, which {bench.file} has")
    strain, force = np.array(curve.strain[across]), width * np.array(curve.tension[across])
    return of_strip(strain, force)


METRIC = "rms"


@dataclass(frozen=True, eq=False)
class BenchEvaluation(Tabled):
    """tests, others: by record, of role test and of role fit."""

    bench: Bench
    unit: str  # N or m
    noise: BenchNoise
    tests: Mapping[str, RecordErrors]
    others: Mapping[str, RecordErrors]

    json_keys: ClassVar = (
        ("designs", lambda of: {of.bench.name: of._table(of.tests)} if of.tests else {}),
        ("**", lambda of: {"others": {of.bench.name: of._table(of.others)}} if of.others else {}),
        ("metric", lambda of: METRIC),
        "unit",
        ("**", "noise"),
    )

    def columns(self) -> Columns:
        """Return a row a record: its name, role and errors before and after, in `unit`."""
        rows = [("test", *one) for one in self.tests.items()] + [("fit", *one) for one in self.others.items()]
        names = {"record": [name for _, name, _ in rows], "role": [role for role, _, _ in rows]}
        return {**names, **{when: [getattr(of, when) for *_, of in rows] for when in ("before", "after")}}

    def _table(self, records: Mapping[str, RecordErrors]) -> dict[str, Any]:
        return {
            **{when: {METRIC: _statistics(records, when)} for when in ("before", "after")},
            "source": self.bench.source or self.bench.description,
            "records": records,
        }

    def as_markdown(self) -> str:
        """Return tables for people, in N or mm."""
        factor, unit = for_people(self.unit)

        def shown(value: float) -> str:
            return f"{factor * value:.3g}" if factor * value >= LEAST_SHOWN else "0"

        head, lines = f"| record | before, {unit} | after, {unit} |", []
        for title, records in (("test", self.tests), ("fit", self.others)):
            if records:
                lines += [f"## Records of role {title}", "", head, "|---|---|---|"]
                lines += [f"| {name} | {shown(e.before)} | {shown(e.after)} |" for name, e in records.items()]
                means = (_statistics(records, state).mean for state in ("before", "after"))
                lines += [f"| mean | {' | '.join(map(shown, means))} |", ""]
        noise = self.noise.in_words(f"{shown(self.noise.sigma)} {unit}")
        lines.append(f"{noise[0].upper()}{noise[1:]}.")
        lines.append("RMS of each record; before: by the law at rest, after: with friction, viscosity and effects.")
        origin = self.bench.source or self.bench.description
        return "\n".join([*lines, *(["", f"{self.bench.name}: {origin}"] if origin else [])])


def evaluate_bench(path: Path, law: Path, roles: Sequence[Role] = ("test",)) -> BenchEvaluation:
    """Return the errors on the records of these roles, those of each in a table of their own, of the law in the file
    `law`, which `calibrate` wrote. Raises InputError, also where there is no such record."""
    bench = read_bench(path)
    require_columns(bench, bench.records)
    predict = prediction(law, bench)

    def errors(records: Sequence[BenchRecord]) -> dict[str, RecordErrors]:
        return dict(zip((r.name for r in records), errors_of(predict, bench, records), strict=True))

    tests, fitted = (bench.of_role(role) if role in roles else [] for role in ("test", "fit"))
    others = errors(fitted)
    if not tests and not others:
        raise InputError(f"{bench.file}: no record of role test; expected one, or --all for those of role fit")
    return BenchEvaluation(bench, LAWS[bench.specimen].unit, noise_of(bench), errors(tests), others)


def _statistics(records: Mapping[str, RecordErrors], state: str) -> Statistics:
    return Statistics.of(np.array([getattr(errors, state) for errors in records.values()]))

"""How far a law that was fitted to a bench is from its records."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.formats.json_file import plain
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.geometry.metrics import Statistics
from fabdesign.nouns.bench import Bench, BenchRecord
from studies.benches.calibrate import LEAST_SHOWN
from studies.benches.noise import BenchNoise, noise_of
from studies.benches.predictions import RecordErrors, errors_of, prediction
from studies.benches.records import require_columns, unit_of

METRIC = "rms"


@dataclass(frozen=True, eq=False)
class BenchEvaluation(Tabled):
    """tests, others: by record, of role test and of role fit."""

    bench: Bench
    unit: str  # N or m
    noise: BenchNoise
    tests: Mapping[str, RecordErrors]
    others: Mapping[str, RecordErrors]

    def as_json(self) -> dict[str, Any]:
        """What `evaluate BENCH --json` prints."""
        result: dict[str, Any] = {"designs": {self.bench.name: self._table(self.tests)} if self.tests else {}}
        if self.others:
            result["others"] = {self.bench.name: self._table(self.others)}
        noise = {"noise_floor": self.noise.sigma, "noise_from": self.noise.source}
        return dict(plain(result | {"metric": METRIC, "unit": self.unit} | noise))

    def columns(self) -> Columns:
        """Return a row a record: its name, role and errors before and after, in `unit`."""
        rows = [("test", *one) for one in self.tests.items()] + [("fit", *one) for one in self.others.items()]
        names = {"record": [name for _, name, _ in rows], "role": [role for role, _, _ in rows]}
        return {**names, **{when: [getattr(of, when) for *_, of in rows] for when in ("before", "after")}}

    def _table(self, records: Mapping[str, RecordErrors]) -> dict[str, Any]:
        return {
            "before": {METRIC: _statistics(records, "before")},
            "after": {METRIC: _statistics(records, "after")},
            "source": self.bench.source or self.bench.description,
            "records": records,
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
        noise = self.noise.in_words(f"{shown(self.noise.sigma)} {unit}")
        lines.append(f"{noise[0].upper()}{noise[1:]}.")
        lines.append("RMS of each record; before: by the law at rest, after: with friction, viscosity and effects.")
        origin = self.bench.source or self.bench.description
        return "\n".join([*lines, *(["", f"{self.bench.name}: {origin}"] if origin else [])])


def evaluate_bench(path: Path, law: Path, *, all_records: bool = False) -> BenchEvaluation:
    """Errors on the records of role `test`, with `all_records` on those of role `fit` too, in a table of their own, of
    the law in the file `law`, which `calibrate` wrote. Raises InputError, also where there is no such record."""
    bench = read_bench(path)
    require_columns(bench, bench.records)
    predict = prediction(law, bench)

    def errors(records: Sequence[BenchRecord]) -> dict[str, RecordErrors]:
        return dict(zip((r.name for r in records), errors_of(predict, bench, records), strict=True))

    tests, fitted = ([r for r in bench.records if r.role == role] for role in ("test", "fit"))
    others = errors(fitted if all_records else [])
    if not tests and not others:
        raise InputError(f"{bench.file}: no record of role test; expected one, or --all for those of role fit")
    return BenchEvaluation(bench, unit_of(bench), noise_of(bench), errors(tests), others)


def _statistics(records: Mapping[str, RecordErrors], state: str) -> Statistics:
    return Statistics.of(np.array([getattr(errors, state) for errors in records.values()]))

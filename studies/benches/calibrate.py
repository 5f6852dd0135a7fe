"""The answer that a bench gives: a law of its specimen, and a muscle type or a cloth that a design can include."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.formats.codec import Encoder
from fabdesign.formats.json_file import plain
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.runtime.effort import bench_fit_seconds, in_words
from optimize.fit.parameters import FitVector
from studies.benches.evaluate import errors_of
from studies.benches.law import Law, rms
from studies.benches.muscle import REFITS, BenchMuscle, only_speed, rows_of, travels
from studies.benches.muscle_effects import FittedEffects, bench_vector, fit_effects
from studies.benches.records import LAWS, LEAST_SHOWN, BenchNoise, for_people, noise_of, require_columns, shown, unit_of

Progress = Callable[[str, float | None], None]


@dataclass(frozen=True, eq=False)
class BenchCalibration(Tabled):
    """A specimen's quasi-static law and how well it holds: means over records of root mean squares, in `unit`, of what
    the file says, as `evaluate` gives them."""

    bench: Bench
    law: Law
    unit: str  # of the bench's output: N or m
    error_fit: float
    error_left_out: float | None  # of fitted records, each predicted from the others; None for one or two records
    error_test: float | None  # of records of role test
    error_as_fitted: float  # of the fit with all that was fitted, also what the file does not hold
    noise: BenchNoise
    constants: Mapping[str, Quantity]
    effects: tuple[EffectTerm, ...] = ()  # fitted with the law
    speed: float | None = None  # 1/s, of a muscle's contraction in all records, where there is only one
    files: tuple[str, ...] = ()  # names of those that were written

    def json_content(self) -> dict[str, Any]:
        """Return what `calibrate BENCH --json` prints."""
        return {
            "bench": self.bench.name,
            "unit": self.unit,
            "error_fit": self.error_fit,
            "error_left_out": self.error_left_out,
            "error_test": self.error_test,
            "error_as_fitted": self.error_as_fitted,
            **plain(self.noise),
            "constants": {name: {"value": q.value, "unit": q.unit} for name, q in self.constants.items()},
            "effects": [Encoder().encode(effect) for effect in self.effects],
        }

    def columns(self) -> Columns:
        """Return name, value and unit of every constant."""
        names = {"name": [*self.constants], "value": [q.value for q in self.constants.values()]}
        return {**names, "unit": [q.unit for q in self.constants.values()]}


def calibrate_bench(
    path: Path | str,
    *,
    fit: Sequence[str] | None = None,
    free: Sequence[str] = (),
    progress: Progress = lambda line, share: None,
) -> BenchCalibration:
    """Fit a bench's records of role `fit`, or those among them whose names (files without .csv) are given. free:
    effects to fit with a muscle's law, as of `calibrate --free`. progress: is given an estimate, then each step with
    the share done.

    Raises InputError for an unsound bench, an unknown name and records that do not suffice.
    """
    bench = read_bench(path)
    chosen, tests = bench.of_role("fit"), bench.of_role("test")
    if fit is not None:
        for name in fit:
            if name not in {record.name for record in chosen}:
                known = ", ".join(record.name for record in chosen)
                raise InputError(f"{bench.file}: no record {name} to fit; it has {known}")
        chosen = [record for record in chosen if record.name in fit]
    if not chosen:
        raise InputError(f"{bench.file}: no record of role fit; expected at least one")
    require_columns(bench, [*chosen, *tests])
    if free and bench.specimen != "muscle":
        raise InputError(
            f"{bench.file}: --free {','.join(free)}: the specimen is a {bench.specimen}; expected a muscle"
        )
    vector = bench_vector(free, bench.name) if free else None
    unknowns = 0 if vector is None else len(vector.parameters)
    if bench.specimen == "muscle":
        rows = sum(len(BenchMuscle.measured(record)) for record in chosen)
        seconds = bench_fit_seconds(len(chosen), rows, unknowns)
        what = f"{len(chosen)} records", f"{rows} rows", *([f"{unknowns} unknowns of effects"] if free else [])
        progress(in_words(seconds, *what), None)
    turns = len(chosen) if len(chosen) > 2 else 0
    lines = ["all records", *(f"record {k} of {turns} left out" for k in range(1, turns + 1))]
    first, *later = _steps(progress, [f"fitting {bench.name}, {line}" for line in lines])
    law, effects = _fit(bench, chosen, vector, first)
    left_out = []
    for i, tell in enumerate(later):
        others = chosen[:i] + chosen[i + 1 :]
        left_out.append(_error(bench, _fit(bench, others, vector, tell, refits=0)[0], [chosen[i]]))
    return BenchCalibration(
        bench=bench,
        law=law,
        unit=unit_of(bench),
        error_fit=_error(bench, law, chosen),
        error_left_out=float(np.mean(left_out)) if left_out else None,
        error_test=_error(bench, law, tests) if tests else None,
        error_as_fitted=float(np.mean([rms(law.predict(record) - law.measured(record)) for record in chosen])),
        noise=noise_of(bench),
        constants=law.constants(),
        effects=effects,
        speed=only_speed(rows_of(chosen)) if bench.specimen == "muscle" else None,
    )


def errors_in_words(calibration: BenchCalibration) -> str:
    """Return the root mean squares for people: of the fit, of records left out of it, of those of role test."""
    lines = [
        ("on the fit", calibration.error_fit),
        ("on records left out of it", calibration.error_left_out),
        ("on records of role test", calibration.error_test),
    ]
    return ", ".join(f"{_shown(error, calibration.unit)} {where}" for where, error in lines if error is not None)


def noise_in_words(calibration: BenchCalibration) -> list[str]:
    """Return a line on the noise of a reading, one where what was fitted is better than what a file holds, and one
    where all records move at one speed."""
    lines = ["  " + calibration.noise.in_words(_shown(calibration.noise.sigma, calibration.unit))]
    if calibration.error_as_fitted < calibration.error_fit - max(calibration.noise.sigma, LEAST_SHOWN) / 2:
        names = [name for name in calibration.constants if name == "hysteresis"]
        names += [effect.name for effect in calibration.effects if not travels(effect)]
        more = "; --free braid_hysteresis fits friction that a design has" if "hysteresis" in names else ""
        better = _shown(calibration.error_as_fitted, calibration.unit)
        lines.append(f"  {better} on the fit with {' and '.join(names)}, which the file does not hold{more}")
    if calibration.speed is not None:
        lines.append(
            f"  all records contract at {calibration.speed:.2g} 1/s: viscosity and constant friction look alike there; "
            "records at another speed tell them apart"
        )
    return lines


def effects_in_words(calibration: BenchCalibration) -> list[str]:
    """Return a line for each effect: values with 90 % intervals, and where it goes."""
    lines = []
    for effect in calibration.effects:
        shown = []
        for name, q in effect.parameters.items():
            unit = "" if q.unit == "1" else f" {q.unit}"
            between = "" if q.interval90 is None else f" ({q.interval90[0]:.3g} to {q.interval90[1]:.3g})"
            shown.append(f"{name} {q.value:.3g}{unit}{between}")
        omitted = "" if travels(effect) else "; belongs to the bench's rig, so it is not in the file"
        lines.append(f"  {effect.name}: {', '.join(shown)}{omitted}")
    return lines


def next_step(calibration: BenchCalibration, output: Path) -> str:
    """Return what to do with `output`, the file that was written."""
    bench = calibration.bench
    if bench.specimen == "muscle":
        return f"fabdesign new LAYOUT --muscle-type {bench.name} --bench {output} -o DESIGN.toml"
    if bench.specimen == "strip" and "width" in bench.constants:
        return f'include = ["{output.name}"] in a design takes its stretch curve'
    return f"fabdesign trace {bench.file.parent} -o traced (which effect the law lacks, if any)"


def _shown(error: float, unit: str) -> str:
    factor, name = for_people(unit)
    return f"{shown(error, unit)} RMS" if factor * error >= LEAST_SHOWN else f"under {LEAST_SHOWN} {name} RMS"


def _steps(progress: Progress, lines: Sequence[str]) -> list[Callable[[float], None]]:
    """Return what each of some equal steps, which shows its line, tells its own share to."""

    def step(k: int, line: str) -> Callable[[float], None]:
        return lambda share: progress(line, (k + share) / len(lines))

    return [step(k, line) for k, line in enumerate(lines)]


def _fit(
    bench: Bench,
    records: Sequence[BenchRecord],
    vector: FitVector | None,
    tell: Callable[[float], None],
    refits: int = REFITS,
) -> tuple[Law, tuple[EffectTerm, ...]]:
    tell(0.0)
    if bench.specimen == "muscle":
        fitted = FittedEffects() if vector is None else fit_effects(partial(rows_of, records), vector, tell)
        return BenchMuscle.fit(records, terms=fitted.terms, refits=refits), fitted.effects
    return LAWS[bench.specimen].fit(records), ()


def _error(bench: Bench, law: Law, records: Sequence[BenchRecord]) -> float:
    predict = law.written(sized="width" in bench.constants)
    return float(np.mean([errors.after for errors in errors_of(predict, bench, records)]))

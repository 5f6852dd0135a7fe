"""What a bench gives: a law of its specimen, and a muscle type or a cloth that a design can include."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from fabdesign.bench import Bench, BenchRecord
from fabdesign.bench_file import read_bench
from fabdesign.bench_law_file import BenchLaw, write_bench_law
from fabdesign.bench_table_file import write_bench_table
from fabdesign.curve_file import write_membrane_curve
from fabdesign.effect_file import effect_items
from fabdesign.errors import InputError
from fabdesign.model import EffectTerm, Quantity
from fabdesign.output import write_text
from fabdesign.units import in_kpa, in_mm
from optimize.fit.parameters import FitVector
from studies.benches.actuator import StaticCurve
from studies.benches.cylinder import CylinderLaw
from studies.benches.muscle import BenchMuscle
from studies.benches.muscle_effects import FittedEffects, bench_vector, fit_effects
from studies.benches.noise import BenchNoise, noise_of
from studies.benches.predictions import Law, as_fitted, as_written, errors_of, travels
from studies.benches.records import SIZES, measured, require_columns, require_sizes, unit_of
from studies.benches.rows import rows_of
from studies.benches.strip import StripLaw

LEAST_SHOWN = 0.001  # mm or N: what no gauge reads


@dataclass(frozen=True, eq=False)
class BenchCalibration:
    """A specimen's quasi-static law and how well it holds: means over records of root mean squares, in `unit`, of what
    the file says, as `evaluate` gives them."""

    bench: Bench
    law: Law
    unit: str  # of the bench's output: N or m
    error_fit: float
    error_left_out: float | None  # of fitted records, each predicted from the others; None for one or two records
    error_test: float | None  # of records of role test
    error_as_fitted: float  # of the fit with all that was fitted, also what the file does not hold
    noise: BenchNoise  # of the records fitted
    constants: Mapping[str, Quantity]
    effects: tuple[EffectTerm, ...] = ()  # fitted with the law

    def as_json(self) -> dict[str, Any]:
        """What `calibrate BENCH --json` prints."""
        return {
            "bench": self.bench.name,
            "specimen": self.bench.specimen,
            "source": self.bench.source,
            "metric": "rms",
            "unit": self.unit,
            "error": {"fit": self.error_fit, "left_out": self.error_left_out, "test": self.error_test},
            "error_as_fitted": self.error_as_fitted,
            "noise_floor": self.noise.sigma,
            "noise_from": self.noise.source,
            "constants": {name: {"value": q.value, "unit": q.unit} for name, q in self.constants.items()},
            "effects": [effect_items(effect) for effect in self.effects],
        }


def calibrate_bench(
    path: Path | str, *, fit: Sequence[str] | None = None, free: Sequence[str] = ()
) -> BenchCalibration:
    """Fit a bench's records of role `fit`, or those among them whose names (files without .csv) are given. free:
    effects to fit with a muscle's law, as of `calibrate --free`.

    Raises InputError for an unsound bench, an unknown name and records that do not suffice.
    """
    bench = read_bench(path)
    chosen = [record for record in bench.records if record.role == "fit"]
    if fit is not None:
        for name in fit:
            if name not in {record.name for record in chosen}:
                known = ", ".join(record.name for record in chosen)
                raise InputError(f"{bench.file}: no record {name} to fit; it has {known}")
        chosen = [record for record in chosen if record.name in fit]
    if not chosen:
        raise InputError(f"{bench.file}: no record of role fit; expected at least one")
    tests = [record for record in bench.records if record.role == "test"]
    require_columns(bench, [*chosen, *tests])
    if free and bench.specimen != "muscle":
        raise InputError(
            f"{bench.file}: --free {','.join(free)}: the specimen is a {bench.specimen}; expected a muscle"
        )
    vector = bench_vector(free, bench.name) if free else None
    law, effects = _fit(bench, chosen, vector, intervals=True)
    left_out = []
    for i in range(len(chosen) if len(chosen) > 2 else 0):
        others = chosen[:i] + chosen[i + 1 :]
        left_out.append(_error(bench, _fit(bench, others, vector, intervals=False)[0], [chosen[i]]))
    plain = [as_fitted(law, record) - measured(bench.specimen, record) for record in chosen]
    return BenchCalibration(
        bench=bench,
        law=law,
        unit=unit_of(bench.specimen),
        error_fit=_error(bench, law, chosen),
        error_left_out=float(np.mean(left_out)) if left_out else None,
        error_test=_error(bench, law, tests) if tests else None,
        error_as_fitted=float(np.mean([np.sqrt(np.mean(np.square(error))) for error in plain])),
        noise=noise_of(bench, chosen),
        constants=_constants(law),
        effects=effects,
    )


def errors_in_words(calibration: BenchCalibration) -> str:
    """Root mean squares for people: of the fit, of records left out of it, of those of role test."""
    lines = [
        ("on the fit", calibration.error_fit),
        ("on records left out of it", calibration.error_left_out),
        ("on records of role test", calibration.error_test),
    ]
    return ", ".join(f"{_shown(error, calibration.unit)} {where}" for where, error in lines if error is not None)


def noise_in_words(calibration: BenchCalibration) -> list[str]:
    """A line on the noise of a reading, and one where what was fitted is better than what a file holds."""
    lines = ["  " + calibration.noise.in_words(_shown(calibration.noise.sigma, calibration.unit))]
    if calibration.error_as_fitted < calibration.error_fit - max(calibration.noise.sigma, LEAST_SHOWN) / 2:
        names = [name for name in calibration.constants if name == "hysteresis"]
        names += [effect.name for effect in calibration.effects if not travels(effect)]
        more = "; --free braid_hysteresis fits friction that a design has" if "hysteresis" in names else ""
        better = _shown(calibration.error_as_fitted, calibration.unit)
        lines.append(f"  {better} on the fit with {' and '.join(names)}, which the file does not hold{more}")
    return lines


def effects_in_words(calibration: BenchCalibration) -> list[str]:
    """A line for each effect: values with 90 % intervals, and where it goes."""
    lines = []
    for effect in calibration.effects:
        shown = []
        for name, q in effect.parameters.items():
            unit = "" if q.unit == "1" else f" {q.unit}"
            between = "" if q.interval90 is None else f" ({q.interval90[0]:.3g} to {q.interval90[1]:.3g})"
            shown.append(f"{name} {q.value:.3g}{unit}{between}")
        left = "" if travels(effect) else "; belongs to the bench's rig, so it is not in the file"
        lines.append(f"  {effect.name}: {', '.join(shown)}{left}")
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
    value, unit = (in_mm(error), "mm") if unit == "m" else (error, unit)
    return f"{value:.3g} {unit} RMS" if value >= LEAST_SHOWN else f"under {LEAST_SHOWN} {unit} RMS"


def write_bench_type(calibration: BenchCalibration, output: Path) -> list[Path]:
    """Write `output` (TYPE.toml) and the table it names beside it; the files written.

    A muscle becomes [muscle_types.NAME], with the sizes that the bench states as constants (outer_diameter,
    mass_per_length, axis_offset), and [[effects]] that were fitted and belong to it; a strip whose width is stated a
    [fabric] with its membrane_curve, in the `direction` (1 across, 2 down) that is stated or both. A design takes
    either by `include`. Anything else becomes a file of the law alone (`fabdesign.bench-law/1`). Raises InputError for
    a missing size and where `output` cannot be written.
    """
    bench, law = calibration.bench, calibration.law
    require_sizes(bench)
    document = tomlkit.document()
    document.add(tomlkit.comment(_origin(bench)))
    table = output.with_name(f"{output.stem}_{'bench' if isinstance(law, BenchMuscle) else 'law'}.csv")
    if isinstance(law, BenchMuscle):
        document["format"] = "fabdesign.design/1"
        entry = tomlkit.table()
        for key in SIZES:
            entry[key] = bench.constant(key)
        if law.viscosity is not None:
            entry["viscosity"] = law.viscosity
        entry["bench"] = table.name
        document["muscle_types"] = {bench.name: entry}
        if own := [effect for effect in calibration.effects if travels(effect)]:
            document["effects"] = [effect_items(effect) for effect in own]
        write_bench_table(law.table(), table)
    elif isinstance(law, StripLaw) and "width" in bench.constants:
        document["format"] = "fabdesign.design/1"
        document["fabric"] = {"membrane_curve": table.name}
        direction = bench.constants.get("direction")
        curve = law.membrane_curve(bench.constant("width"), across=direction != 2, down=direction != 1)
        write_membrane_curve(curve, table)
    else:
        write_bench_law(_bench_law(bench, law), output, table, comment=_origin(bench))
        return [output, table]
    write_text(output, tomlkit.dumps(document))
    return [output, table]


def _fit(
    bench: Bench, records: Sequence[BenchRecord], vector: FitVector | None, *, intervals: bool
) -> tuple[Law, tuple[EffectTerm, ...]]:
    if bench.specimen == "muscle":
        fitted = FittedEffects() if vector is None else fit_effects(partial(rows_of, records), vector)
        options: dict[str, Any] = {} if intervals else {"refits": 0}
        return BenchMuscle.fit(records, terms=fitted.terms, **options), fitted.effects
    if bench.specimen == "strip":
        return StripLaw.fit(records), ()
    if bench.specimen == "cylinder":
        return CylinderLaw.fit(records), ()
    return StaticCurve.fit(records), ()


def _error(bench: Bench, law: Law, records: Sequence[BenchRecord]) -> float:
    predict = as_written(law, sized="width" in bench.constants)
    return float(np.mean([errors.after for errors in errors_of(predict, bench, records)]))


def _constants(law: Law) -> dict[str, Quantity]:
    """What a record has to say beyond the quasi-static law."""
    if isinstance(law, BenchMuscle):
        constants = {"viscosity": (law.viscosity, "N s"), "hysteresis": (law.hysteresis, "N")}
        return {name: Quantity(value, unit) for name, (value, unit) in constants.items() if value is not None}
    if isinstance(law, StaticCurve):
        return {"creep_per_decade": Quantity(law.creep_per_decade, "1")}
    if isinstance(law, CylinderLaw):
        return {"presliding": Quantity(law.presliding, "m")}
    return {}


def _origin(bench: Bench) -> str:
    source = bench.source or bench.description
    return f"fitted to the bench {bench.name}{source and f': {source}'}"


def _bench_law(bench: Bench, law: Law) -> BenchLaw:
    """As it is written to a file."""
    if isinstance(law, CylinderLaw):
        low, high = law.interval90.T
        columns = {"coefficient_n": law.coefficients, "low90_n": low, "high90_n": high}
        return BenchLaw("cylinder", bench.output, columns, law.terms, law.form, law.presliding)
    if isinstance(law, StaticCurve):
        return BenchLaw("actuator", bench.output, {"pressure_kpa": in_kpa(law.pressure), "displacement_m": law.level})
    assert isinstance(law, StripLaw)
    strain, _ = law.samples()
    low, high = law.interval90(1 + strain)
    columns = {"strain": strain, "force_n": law.force(1 + strain), "low90_n": low, "high90_n": high}
    return BenchLaw("strip", bench.output, columns)

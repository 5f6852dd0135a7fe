"""The answer that a bench gives: a law of its specimen, and a muscle type or a cloth that a design can include."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.formats.codec import Encoder
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.geometry.curves import design_matrix
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.forward import MUSCLE_TYPES, PARAMETERS, Term
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.runtime.effort import bench_fit_seconds, in_words
from optimize.fit.descent import fit as fitted_to
from optimize.fit.descent import parts
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from optimize.fit.problem import BenchProblem
from studies.benches.evaluate import errors_of
from studies.benches.law import Law, rms
from studies.benches.muscle import BenchMuscle, Rows, motion_columns, only_speed, rows_of, travels
from studies.benches.records import LAWS, LEAST_SHOWN, BenchNoise, for_people, noise_of, require_columns, shown
from studies.fitting.fitted_model import effect_term, quantities_of

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

    json_keys: ClassVar = (
        ("bench", "bench.name"), "unit", "error_fit", "error_left_out", "error_test", "error_as_fitted",
        ("**", "noise"),
        ("constants", lambda of: {name: {"value": q.value, "unit": q.unit} for name, q in of.constants.items()}),
        ("effects", lambda of: [Encoder().encode(effect) for effect in of.effects]),
    )  # fmt: skip

    def columns(self) -> Columns:
        """Return name, value and unit of every constant."""
        quantities = self.constants.values()
        return {"name": [*self.constants], **{key: [getattr(q, key) for q in quantities] for key in ("value", "unit")}}


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
    known = [record.name for record in chosen]
    if unknown := [name for name in fit or () if name not in known]:
        raise InputError(f"{bench.file}: no record {unknown[0]} to fit; it has {', '.join(known)}")
    chosen = [record for record in chosen if fit is None or record.name in fit]
    if not chosen:
        raise InputError(f"{bench.file}: no record of role fit; expected at least one")
    require_columns(bench, [*chosen, *tests])
    if free and not bench.is_muscle:
        raise InputError(
            f"{bench.file}: --free {','.join(free)}: the specimen is a {bench.specimen}; expected a muscle"
        )
    vector = bench_vector(free, bench.name) if free else None
    unknowns = 0 if vector is None else len(vector.parameters)
    if bench.is_muscle:
        rows = sum(len(BenchMuscle.measured(record)) for record in chosen)
        seconds = bench_fit_seconds(len(chosen), rows, unknowns)
        what = f"{len(chosen)} records", f"{rows} rows", *([f"{unknowns} unknowns of effects"] if free else [])
        progress(in_words(seconds, *what), None)
    others = [[*chosen[:k], *chosen[k + 1 :]] for k in range(len(chosen))] if len(chosen) > 2 else []
    fits, ends = [], [k / (len(others) + 1) for k in range(1, len(others) + 1)]
    for k, (some, part) in enumerate(zip([chosen, *others], parts(progress, *ends), strict=True)):
        line = f"record {k} of {len(others)} left out" if k else "all records"
        fits.append(_fit(bench, some, vector, partial(part, f"fitting {bench.name}, {line}")))
    (law, effects), *later = fits
    left_out = [_error(bench, one, [record]) for (one, _), record in zip(later, chosen, strict=False)]
    return BenchCalibration(
        bench=bench,
        law=law,
        unit=law.unit,
        error_fit=_error(bench, law, chosen),
        error_left_out=float(np.mean(left_out)) if left_out else None,
        error_test=_error(bench, law, tests) if tests else None,
        error_as_fitted=float(np.mean([rms(law.predict(record) - law.measured(record)) for record in chosen])),
        noise=noise_of(bench),
        constants=law.constants(),
        effects=effects,
        speed=only_speed(rows_of(chosen)) if bench.is_muscle else None,
    )


def errors_in_words(calibration: BenchCalibration) -> str:
    """Return the root mean squares for people: of the fit, of records left out of it, of those of role test."""
    errors = {
        "on the fit": calibration.error_fit,
        "on records left out of it": calibration.error_left_out,
        "on records of role test": calibration.error_test,
    }
    return ", ".join(f"{_shown(error, calibration.unit)} {on}" for on, error in errors.items() if error is not None)


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
    if bench.is_muscle:
        return f"fabdesign new LAYOUT --muscle-type {bench.name} --bench {output} -o DESIGN.toml"
    if bench.specimen == "strip" and "width" in bench.constants:
        return f'include = ["{output.name}"] in a design takes its stretch curve'
    return f"fabdesign trace {bench.file.parent} -o traced (which effect the law lacks, if any)"


def _shown(error: float, unit: str) -> str:
    factor, name = for_people(unit)
    return f"{shown(error, unit)} RMS" if factor * error >= LEAST_SHOWN else f"under {LEAST_SHOWN} {name} RMS"


def _fit(
    bench: Bench,
    records: Sequence[BenchRecord],
    vector: FitVector | None,
    tell: Callable[[float], None],
) -> tuple[Law, tuple[EffectTerm, ...]]:
    tell(0.0)
    kind = LAWS[bench.specimen]
    if vector is None or not issubclass(kind, BenchMuscle):
        return kind.fit(records), ()
    effects = fit_effects(partial(rows_of, records), vector, tell)
    return kind.fit(records, terms=tuple(effect.term for effect in effects)), effects


def _error(bench: Bench, law: Law, records: Sequence[BenchRecord]) -> float:
    predict = law.written(sized="width" in bench.constants)
    return float(np.mean([errors.after for errors in errors_of(predict, bench, records)]))


_SPANS = (4, 6)  # of pressure and contraction
_RIDGE = 1e-4  # of the law's coefficients, relative to the tension's size


def bench_vector(free: Sequence[str], name: str) -> FitVector:
    """Return the unknowns of `free` (as of `calibrate --free`) for the muscle type `name`. Raises InputError for an
    effect that one muscle on a bench cannot show."""
    vector = fit_vector(free, PARAMETERS, scope=MUSCLE_TYPES + name)
    for term in vector.terms:
        if EFFECTS[term.name].bench is None:
            known = [effect.name for effect in EFFECTS.values() if effect.bench is not None]
            raise InputError(
                f"--free {term.name}: one muscle on its bench does not show it; expected {', '.join(known)}"
            )
    if any(parameter.is_factor for parameter in vector.parameters):
        raise InputError(f"--free {', '.join(free)}: a bench gives the law itself; expected effects, no factors")
    # none that says what a law has from its bench: here law and effect come from the record itself
    places = [(p, *p.name.partition(".")[::2]) for p in vector.parameters]
    return replace(vector, parameters=tuple(p for p, of, key in places if not EFFECTS[of].parameters[key].tried))


def fit_effects(
    rows_of: Callable[[tuple[Term, ...]], Rows],
    vector: FitVector,
    tell: Callable[[float], None] = lambda share: None,
) -> tuple[EffectTerm, ...]:
    """Return the effects fitted to a muscle's records together with its law, with 90 % intervals. rows_of(terms): the
    rows with the effects in them. tell: is given the share done.

    The law and viscosity enter linearly (a coarse tensor product of B-splines, without the wishes of MuscleLaw): for
    every value of the effects' parameters they are solved for, and the parameters move by Gauss-Newton on what remains
    (variable projection, Golub and Pereyra 1973, doi:10.1137/0710036), in the descent that fits clouds."""
    plain, acting = rows_of(()), {term.name for term in vector.terms}
    start, end = min(float(plain.contraction.min()), 0.0), max(float(plain.contraction.max()), 0.0)
    # splines lie over what was measured, whatever the effects make of it: Pa, and contraction, between knots
    pressure, contraction = float(plain.pressure.max()) / _SPANS[0], (end - start) / _SPANS[1]

    def unexplained(x: Array) -> Array:
        """Return (n,) N that law and damping do not explain; no damping that one of the effects is by itself."""
        rows = rows_of(vector.terms_at(vector.inside(x)))
        p = design_matrix(rows.pressure / pressure, _SPANS[0] + 3)
        e = design_matrix((rows.contraction - start) / contraction, _SPANS[1] + 3)
        smooth = (p[:, :, None] * e[:, None, :]).reshape(len(p), -1)
        stretch = p * (np.maximum(-rows.contraction, 0.0) / contraction)[:, None]
        columns = np.hstack([smooth, stretch, motion_columns(rows.rate, acting)])
        columns = columns[:, np.abs(columns).max(axis=0) > 0]
        ridge = _RIDGE * np.sqrt(len(p)) * np.eye(columns.shape[1])
        goal = rows.force + rows.friction
        steps = np.linalg.lstsq(np.vstack([columns, ridge]), np.r_[goal, np.zeros(len(ridge))], rcond=None)[0]
        return np.asarray(goal - columns @ steps)

    problem = BenchProblem(unexplained, np.zeros_like(plain.block), plain.block, vector)
    fitted = fitted_to(problem, progress=lambda _, share: tell(share))
    deviation = np.sqrt(np.diag(fitted.covariance))
    quantities, terms = quantities_of(vector, fitted.x, deviation), vector.terms_at(fitted.x)
    return tuple(effect_term(label, term, quantities, None) for label, term in zip(vector.labels, terms, strict=True))

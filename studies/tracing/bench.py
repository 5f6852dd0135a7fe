"""Tracing on a bench: a quasi-static law, and what its left-out records show beside it."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fabdesign import __version__
from fabdesign.bench import Bench, BenchRecord
from fabdesign.bench_file import read_bench
from fabdesign.errors import InputError
from fabdesign.model import EffectTerm, Model, Provenance, Quantity
from fabdesign.model_file import write_model
from fabdesign.output import new_folder, write_text
from studies.benches.actuator import StaticCurve, hold_of
from studies.benches.muscle import BenchMuscle
from studies.benches.needs import require_columns
from studies.benches.strip import StripLaw
from studies.calibration.clouds import Indices, evenly
from studies.tracing.bench_candidates import Shape, Signals, shapes_of, signals_of
from studies.tracing.bench_outcome import BenchOutcome, Curve
from studies.tracing.bench_report import render_bench
from studies.tracing.black_box import WIDTHS, kernel_of, left_out, standardised
from studies.tracing.dictionary import Dictionary, Variant
from studies.tracing.ranking import Grams, Ranking, Scored, covariance, excess_of, gain_interval, rank
from studies.tracing.stages import sha256
from studies.tracing.vector import Array
from studies.tracing.verdict import Evidence, decide, explains

TOLERANCE = 0.02  # of the largest output
LEAST = 3  # records of role fit
_ROWS = 400  # of a record
_BOX_ROWS = 40
_FREE = 1e-4  # size of a variant whose prior says nothing
_MOST, _WORTH = 3, 0.15


def trace_bench(
    path: Path, out: Path, *, tolerance: float = TOLERANCE, force: bool = False, say: Callable[[str], None] = print
) -> BenchOutcome:
    """Trace a bench's records of role `fit`, and write trace.json, model.toml and report.html. tolerance: share of the
    largest output. Raises InputError for an unsound bench and for fewer than three records."""
    with new_folder(out, made_by="trace", force=force, inputs=[path]) as files:
        outcome = examine(read_bench(path), tolerance, say)
        write_text(files / "trace.json", json.dumps(outcome.as_json(), indent=1) + "\n")
        write_model(_model(outcome), files / "model.toml")
        write_text(files / "report.html", render_bench(outcome))
    return outcome


def examine(bench: Bench, tolerance: float, say: Callable[[str], None] = print) -> BenchOutcome:
    """The trace itself; `tolerance` is a share of the largest output."""
    records = [r for r in bench.records if r.role == "fit"]
    if len(records) < LEAST:
        raise InputError(f"{bench.file}: {len(records)} records of role fit; expected at least {LEAST}")
    require_columns(bench, records)
    output = "displacement" if bench.specimen == "actuator" else bench.output
    say(f"{len(records)} records, each predicted from the others by the quasi-static law")
    laws = [law(bench, [*records[:k], *records[k + 1 :]], record) for k, record in enumerate(records)]
    signals = [signals_of(r, predicted, k) for k, (r, predicted) in enumerate(zip(records, laws, strict=True))]
    rows = [evenly(len(r.columns[output]), _ROWS) for r in records]
    measured = [r.columns[output] for r in records]
    residual = np.concatenate([(p - m)[k] for p, m, k in zip(laws, measured, rows, strict=True)])
    trial = np.repeat(np.arange(len(records)), [len(k) for k in rows])
    limit = tolerance * max(float(np.abs(m).max()) for m in measured)
    floor = min(_floor(measured), float(np.sqrt(np.mean(residual**2))))
    shapes = shapes_of(bench.specimen, signals, "N" if output != "displacement" else "m")
    tables = [_table(shape, signals, rows) for shape in shapes]
    say(f"ranking {len({s.effect for s in shapes})} candidates on {len(records)} records")
    box = _box_squares(signals, rows, trial, residual)
    added: list[int] = []
    rankings: list[Ranking] = []
    gains: dict[str, float] = {}
    alike_last: tuple[str, ...] = ()
    while True:
        base = np.column_stack([np.zeros((len(trial), 0)), *(tables[k] for k in added)])
        left = [k for k in range(len(shapes)) if shapes[k].effect not in {shapes[a].effect for a in added}]
        grams, dictionary = _grams(base, [tables[k] for k in left], [shapes[k] for k in left], residual, trial)
        ranking = rank(grams, dictionary, floor)
        rankings.append(ranking)
        worth = [c for c in ranking.candidates if ranking.certain(c) and c.gain > _WORTH * ranking.excess]
        if rankings[0].excess <= limit or not worth or len(added) >= _MOST or ranking.excess <= limit:
            break
        best = worth[0]
        assert best.best.variant is not None
        rng = np.random.default_rng(0)
        alike_last = tuple(c.effect for c in worth[1:] if gain_interval(grams, c.best, best.best, floor, rng)[0] <= 0)
        gains[best.effect] = best.gain / max(rankings[0].excess, 1e-30)
        added.append(left[dictionary.variants.index(best.best.variant)])
    own = Scored(None, box, np.zeros(0))
    evidence = Evidence(
        rankings[0].excess, rankings[-1].excess, len(added), excess_of(grams, own, floor), rankings[-1].excess,
        gain_interval(grams, rankings[0].none, own, floor, np.random.default_rng(0))[0] > 0,
    )  # fmt: skip
    verdict = decide(evidence, limit)
    coefficients, deviation = _coefficients(grams, base, residual)
    effects = _effects([shapes[k] for k in added], signals, coefficients, deviation)
    after = residual + base @ coefficients
    return BenchOutcome(
        bench=bench,
        unit="m" if output == "displacement" else "N",
        verdict=verdict,
        evidence=evidence,
        tolerance=limit,
        floor=floor,
        first=rankings[0],
        found=effects,
        shares={} if explains(evidence) is None else gains,
        indistinguishable=alike_last,
        fit=(float(np.sqrt(np.mean(residual**2))), float(np.sqrt(np.mean((after if added else residual) ** 2)))),
        curves=_curves(records, bench, rows, measured, residual, after, trial),
    )


def law(bench: Bench, others: Sequence[BenchRecord], record: BenchRecord) -> Array:
    """(n,) what the quasi-static law, fitted to other records, says at the rows of one: without any memory."""
    if bench.specimen == "muscle":
        return BenchMuscle.fit(others, refits=0).predict(record)
    if bench.specimen == "strip":
        return StripLaw.fit(others).predict(record)
    if bench.specimen == "cylinder":
        force = np.concatenate([r.columns["force"] for r in others])
        terms = np.concatenate([_cylinder(r) for r in others])
        return np.asarray(_cylinder(record) @ np.linalg.lstsq(terms, force, rcond=None)[0])
    hold = hold_of(record)
    level = float(StaticCurve.fit(others).displacement(hold.pressure))
    time = record.columns["time"]
    return np.where((time >= hold.onset) & (time <= hold.release), level, 0.0)


def _cylinder(record: BenchRecord) -> Array:
    """Preload, spring, area times pressure, and its change over the stroke."""
    x, p = record.columns["displacement"] / 0.01, record.columns["pressure"] / 1e5
    return np.stack([np.ones_like(x), x, p, x * p], axis=1)


def _table(shape: Shape, signals: Sequence[Signals], rows: Sequence[Indices]) -> Array:
    return np.concatenate(
        [np.column_stack([*shape.columns(s).values()])[k] for s, k in zip(signals, rows, strict=True)]
    )


def _grams(
    base: Array, tables: Sequence[Array], shapes: Sequence[Shape], residual: Array, trial: Indices
) -> tuple[Grams, Dictionary]:
    scaled = [t / np.maximum(np.sqrt(np.mean(t**2, axis=0)), 1e-30) for t in tables]
    size = np.sqrt(np.mean(base**2, axis=0)) if base.shape[1] else np.ones(0)
    table = np.column_stack([base / np.maximum(size, 1e-30), *scaled, residual])
    count = int(trial.max()) + 1
    gram = np.stack([table[trial == k].T @ table[trial == k] for k in range(count)])
    points = np.bincount(trial).astype(float)
    index = np.arange(count)
    q = base.shape[1]
    grams = Grams(gram, index, index, points, np.full(q, 1e-12), np.zeros(q), 10.0 * count)
    variants, first = [], 0
    for shape, part in zip(shapes, scaled, strict=True):
        variants.append(Variant(shape.effect, tuple(range(first, first + part.shape[1])), _FREE, shape.values))
        first += part.shape[1]
    return grams, Dictionary((), tuple(variants), np.zeros((0, first)))


def _coefficients(grams: Grams, base: Array, residual: Array) -> tuple[Array, Array]:
    """Of the columns added, and their standard deviations by leaving out records."""
    if not base.shape[1]:
        return np.zeros(0), np.zeros(0)
    size = np.maximum(np.sqrt(np.mean(base**2, axis=0)), 1e-30)
    fitted = np.linalg.lstsq(base, residual, rcond=None)[0]
    return np.asarray(-fitted), np.asarray(np.sqrt(np.diag(covariance(grams))) / size)


def _effects(
    shapes: Sequence[Shape], signals: Sequence[Signals], coefficients: Array, deviation: Array
) -> tuple[EffectTerm, ...]:
    found, first = [], 0
    for shape in shapes:
        names = [*shape.columns(signals[0])]
        quantities = {
            name: Quantity(float(c), shape.units[name], (float(c - 1.645 * s), float(c + 1.645 * s)))
            for name, c, s in zip(names, coefficients[first:], deviation[first:], strict=False)
        }
        quantities |= {name: Quantity(float(v), shape.units[name]) for name, v in shape.values.items()}
        found.append(EffectTerm(shape.effect, quantities))
        first += len(names)
    return tuple(found)


def _floor(measured: Sequence[Array]) -> float:
    """RMS of the noise, by third differences, which a smooth output does not have."""
    return float(np.median([np.sqrt(np.mean(np.diff(m, 3) ** 2) / 20) for m in measured if len(m) > 8]))


def _box_squares(signals: Sequence[Signals], rows: Sequence[Indices], trial: Indices, residual: Array) -> Array:
    """(records,) squares that a kernel regression leaves of records that it was not trained on."""
    parts, kept, first = [], [], 0
    for s, k in zip(signals, rows, strict=True):
        columns = [s.law, np.gradient(s.law)]
        columns += [c for c in (s.path, s.pressure, s.time) if c is not None]
        if s.path is not None:
            columns += [np.sign(np.gradient(s.path)), np.gradient(s.path)]
        parts.append(np.column_stack(columns)[k])
        kept.append(first + evenly(len(k), _BOX_ROWS))
        first += len(k)
    some = np.concatenate(kept)
    features, record = standardised(np.concatenate(parts))[some], trial[some]
    kernels, wanted = [kernel_of(features, width) for width in WIDTHS], residual[some][:, None]
    squares = np.zeros(int(trial.max()) + 1)
    for out in range(len(squares)):
        left = wanted[record == out] - left_out(kernels, wanted, [np.array([True])], record, out)
        squares[out] = float(np.mean(left**2)) * np.sum(trial == out)
    return squares


def _curves(
    records: Sequence[BenchRecord],
    bench: Bench,
    rows: Sequence[Indices],
    measured: Sequence[Array],
    residual: Array,
    after: Array,
    trial: Indices,
) -> tuple[Curve, ...]:
    found: list[Curve] = []
    for k, record in enumerate(records):
        own = trial == k
        name = next((n for n in ("time", *bench.input) if n in record.columns), None)
        place = record.columns[name][rows[k]] if name else np.arange(own.sum(), dtype=float)
        y = measured[k][rows[k]]
        found.append((record.name, place, y, y + residual[own], y + after[own]))
    return tuple(found)


def _model(outcome: BenchOutcome) -> Model:
    bench = outcome.bench
    return Model(
        effects=outcome.found if outcome.verdict == "effect" else (),
        provenance=Provenance(
            sets=(bench.name,),
            fitted=tuple(f"{bench.name}/{r.name}" for r in bench.records if r.role == "fit"),
            versions={"fabdesign": __version__},
            hashes={f"{bench.name}/bench.toml": sha256(bench.file)},
        ),
    )

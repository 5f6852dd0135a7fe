"""Tracing on a bench: a quasi-static law, and what its left-out records show beside it."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fabdesign import __version__
from fabdesign.bench import Bench, BenchRecord
from fabdesign.bench_file import read_bench
from fabdesign.checkpoint import sha256
from fabdesign.effects import EFFECTS
from fabdesign.errors import InputError
from fabdesign.json_file import write_json
from fabdesign.model import EffectTerm, Model, Provenance, Quantity
from fabdesign.model_file import write_model
from fabdesign.output import new_folder, write_text
from optimize.fit.clouds import Indices, evenly
from studies.benches.records import require_columns, unit_of
from studies.tracing.bench_candidates import Shape, Signals, shapes_of, signals_of
from studies.tracing.bench_law import law
from studies.tracing.bench_outcome import BenchOutcome, Curve
from studies.tracing.bench_ranking import Array, BenchScore, excess_of, gain_interval
from studies.tracing.bench_report import render_bench
from studies.tracing.bench_selection import Columns, coefficients_of, select
from studies.tracing.black_box import WIDTHS, kernel_of, left_out, standardised
from studies.tracing.verdict import Evidence, decide, explains

TOLERANCE = 0.02  # of the largest output
LEAST_RECORDS = 3  # records of role fit
_ROWS = 400  # of a record
_BOX_ROWS = 40


def trace_bench(
    path: Path, out: Path, *, tolerance: float = TOLERANCE, force: bool = False, say: Callable[[str], None] = print
) -> BenchOutcome:
    """Trace a bench's records of role `fit`, and write trace.json, model.toml and report.html. tolerance: share of the
    largest output. Raises InputError for an unsound bench and for fewer than three records."""
    with new_folder(out, made_by="trace", force=force, inputs=[path]) as files:
        outcome = examine(read_bench(path), tolerance, say)
        write_json(files / "trace.json", outcome.as_json())
        write_model(_model(outcome), files / "model.toml")
        write_text(files / "report.html", render_bench(outcome))
    return outcome


def examine(bench: Bench, tolerance: float, say: Callable[[str], None] = print) -> BenchOutcome:
    """The trace itself; `tolerance` is a share of the largest output."""
    records = [r for r in bench.records if r.role == "fit"]
    if len(records) < LEAST_RECORDS:
        raise InputError(f"{bench.file}: {len(records)} records of role fit; expected at least {LEAST_RECORDS}")
    require_columns(bench, bench.records)
    output = "displacement" if bench.specimen == "actuator" else bench.output
    say(f"{len(records)} records, each predicted from the others by the quasi-static law")
    laws = [law(bench, [*records[:k], *records[k + 1 :]], record) for k, record in enumerate(records)]
    signals = [signals_of(r, predicted, k) for k, (r, predicted) in enumerate(zip(records, laws, strict=True))]
    rows = [evenly(len(r.columns[output]), _ROWS) for r in records]
    measured = [r.columns[output] for r in records]
    residual = np.concatenate([(p - m)[k] for p, m, k in zip(laws, measured, rows, strict=True)])
    trial = np.repeat(np.arange(len(records)), [len(k) for k in rows])
    limit = tolerance * max(float(np.abs(m).max()) for m in measured)
    floor = min(_floor(measured), _rms(residual))
    shapes = shapes_of(bench.specimen, signals, unit_of(bench.specimen))
    tables = [_table(shape, signals, rows) for shape in shapes]
    say(f"ranking {len({s.effect for s in shapes})} candidates on {len(records)} records")
    box = _box_squares(signals, rows, trial, residual)
    columns = Columns(shapes, tables, residual, trial)
    selected = select(columns, floor, limit)
    own, left = BenchScore(None, box, np.zeros(0)), selected.last.excess
    evidence = Evidence(
        selected.first.excess, left, len(selected.added), excess_of(selected.grams, own, floor), left,
        gain_interval(selected.grams, selected.first.none, own, floor, np.random.default_rng(0))[0] > 0,
    )  # fmt: skip
    coefficients, deviation = coefficients_of(selected.base, residual, trial)
    after = residual + selected.base @ coefficients
    return BenchOutcome(
        bench=bench,
        unit=unit_of(bench.specimen),
        verdict=decide(evidence, limit),
        evidence=evidence,
        tolerance=limit,
        floor=floor,
        first=selected.first,
        found=_effects(columns, selected.added, coefficients, deviation),
        shares={} if explains(evidence) is None else selected.gains,
        indistinguishable=selected.alike,
        refused=selected.refused,
        fit=(_rms(residual), _rms(after)),
        test=_tested(bench, output, [shapes[k] for k in selected.added], coefficients),
        curves=_curves(records, bench, rows, measured, residual, after, trial),
    )


def _tested(bench: Bench, output: str, shapes: Sequence[Shape], coefficients: Array) -> tuple[float, float] | None:
    """RMS on the records of role test, by the law of those of role fit: before, and with the shapes added."""
    records, tests = ([r for r in bench.records if r.role == role] for role in ("fit", "test"))
    if not tests:
        return None
    laws = [law(bench, records, record) for record in tests]
    signals = [signals_of(r, way, len(records) + k) for k, (r, way) in enumerate(zip(tests, laws, strict=True))]
    residual = np.concatenate([way - r.columns[output] for r, way in zip(tests, laws, strict=True)])
    every = [np.arange(len(way)) for way in laws]
    columns = [column for shape in shapes for column in _table(shape, signals, every).values()]
    return _rms(residual), _rms(residual + sum(c * x for c, x in zip(coefficients, columns, strict=True)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _table(shape: Shape, signals: Sequence[Signals], rows: Sequence[Indices]) -> dict[str, Array]:
    """(n,) of each of the shape's parameters."""
    parts = [shape.columns(s) for s in signals]
    return {name: np.concatenate([part[name][k] for part, k in zip(parts, rows, strict=True)]) for name in parts[0]}


def _effects(columns: Columns, added: Sequence[int], coefficients: Array, deviation: Array) -> tuple[EffectTerm, ...]:
    terms, first = [], 0
    for shape, names in ((columns.shapes[k], [*columns.tables[k]]) for k in added):
        quantities = {
            name: Quantity(float(c), shape.units[name], (float(c - 1.645 * s), float(c + 1.645 * s)))
            for name, c, s in zip(names, coefficients[first:], deviation[first:], strict=False)
        }
        quantities |= {name: Quantity(float(v), shape.units[name]) for name, v in shape.values.items()}
        terms.append(EffectTerm(shape.effect, quantities))
        first += len(names)
    return tuple(terms)


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
    curves: list[Curve] = []
    for k, record in enumerate(records):
        own = trial == k
        name = next((n for n in ("time", *bench.input) if n in record.columns), None)
        place = record.columns[name][rows[k]] if name else np.arange(own.sum(), dtype=float)
        y = measured[k][rows[k]]
        curves.append((record.name, place, y, y + residual[own], y + after[own]))
    return tuple(curves)


def _model(outcome: BenchOutcome) -> Model:
    """With those of the effects that the simulator has, where its parameters mean the same."""
    bench = outcome.bench
    return Model(
        effects=tuple(e for e in outcome.found if _simulated(e)) if outcome.verdict == "effect" else (),
        provenance=Provenance(
            sets=(bench.name,),
            fitted=tuple(f"{bench.name}/{r.name}" for r in bench.records if r.role == "fit"),
            versions={"fabdesign": __version__},
            hashes={f"{bench.name}/bench.toml": sha256(bench.file)},
        ),
    )


def _simulated(effect: EffectTerm) -> bool:
    declared = EFFECTS[effect.name].parameters if effect.name in EFFECTS else {}
    return all(
        name in declared
        and declared[name].unit == q.unit
        and declared[name].bounds[0] <= q.value <= declared[name].bounds[1]
        for name, q in effect.parameters.items()
    )

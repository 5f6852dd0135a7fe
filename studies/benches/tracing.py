"""Tracing on a bench: a quasi-static law, and what its left-out records show beside it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.nouns.trial import LEAST_TRIALS
from fabdesign.output import new_folder
from optimize.fit.clouds import evenly
from optimize.fit.cross_validation import Scored
from optimize.fit.descent import Progress, parts
from studies.benches.law import ROUNDS, rms
from studies.benches.records import LAWS, noise_of, output_of, require_columns
from studies.benches.trace_fit import (
    BenchTask,
    Columns,
    ShapedEffect,
    Signals,
    alike,
    candidates_of,
    select,
    shapes_of,
    signals_of,
)
from studies.benches.trace_report import BenchOutcome, render_bench
from studies.fitting.fitted_model import quantities_of
from studies.model_selection.black_box import predicted_by_others, standardised
from studies.model_selection.judged import Judged
from studies.model_selection.outcome import write_trace
from studies.model_selection.verdict import Evidence, decide

TOLERANCE = 0.02  # of the largest output
_ROWS = 400  # of a record
_BOX_ROWS = 40
_SETTLED = 0.01  # of what is left, that one more turn of the law and the effects beside it would take
_ENDS = (0.2, 0.3)  # shares of the work at which laws alone and effects end


def trace_bench(
    path: Path,
    out: Path,
    *,
    tolerance: float = TOLERANCE,
    force: bool = False,
    progress: Progress = lambda line, share: None,
) -> BenchOutcome:
    """Trace a bench's records of role `fit`, and write trace.json, model.toml and report.html. tolerance: share of the
    largest output. progress: is given what is done and about what share. Raises InputError for an unsound bench and for
    fewer than three records."""
    with new_folder(out, made_by="trace", force=force, inputs=[path]) as files:
        outcome = examine(read_bench(path), tolerance, progress)
        write_trace(files, outcome, outcome.model, render_bench(outcome))
    return outcome


def examine(bench: Bench, tolerance: float, progress: Progress = lambda line, share: None) -> BenchOutcome:
    """Return the trace itself; `tolerance` is a share of the largest output."""
    records = bench.of_role("fit")
    if len(records) < LEAST_TRIALS:
        raise InputError(f"{bench.file}: {len(records)} records of role fit; expected at least {LEAST_TRIALS}")
    require_columns(bench, bench.records)
    first, second, third = parts(progress, *_ENDS)
    line = f"{len(records)} records, each predicted from the others by the quasi-static law"
    laws = laws_of(bench, records, tell=partial(first, line))
    sampled = _Sampled.of(bench, records, laws)
    residual = sampled.residual(laws)
    limit = tolerance * max(float(np.abs(r.columns[output_of(bench)]).max()) for r in records)
    noise = noise_of(bench)
    floor = noise.sigma
    shapes = shapes_of(LAWS[bench.specimen], sampled.signals)
    task = BenchTask(shapes, [sampled.table(shape) for shape in shapes], residual, sampled.record, floor, limit)
    second(f"{len(task.effects)} effects together on {len(records)} records", 0.0)
    selection = select(task)
    chosen = [task.shapes[k] for k in task.places(selection.chosen)]
    refitted = _with_law(sampled, task, selection.judged, partial(third, "law and effects in turn"))
    remaining = refitted.fit.state.misfit.residual
    box = sampled.baseline(residual)
    beside = sampled.baseline(remaining) if selection.gains else box
    evidence = Evidence(
        selection.before.excess, refitted.excess, len(chosen), box.excess(floor),
        structure=1 - float(beside.squares.sum() / np.square(remaining).sum()), typical=selection.before.typical,
    )  # fmt: skip
    verdict, effects = decide(evidence, limit), _effects(task, refitted, chosen)
    return BenchOutcome(
        verdict=verdict,
        evidence=evidence,
        tolerance=limit,
        floor=floor,
        selection=selection,
        candidates=candidates_of(task, selection),
        named={effect.name: effect for effect in effects} if verdict == "effect" else {},
        indistinguishable=alike(task, selection.judged) if verdict == "effect" else (),
        bench=bench,
        noise=noise,
        effects=effects,
        fit=(rms(residual), rms(remaining)),
        test=_tested(bench, chosen, refitted.fit.x),
        curves=tuple(
            (r, k, residual[sampled.record == i], remaining[sampled.record == i])
            for i, (r, k) in enumerate(zip(records, sampled.rows, strict=True))
        ),
    )


def laws_of(
    bench: Bench,
    records: Sequence[BenchRecord],
    added: Sequence[Array] | None = None,
    *,
    tell: Callable[[float], None] = lambda share: None,
) -> list[Array]:
    """Return what the law says of each record, fitted to the others. added: what effects add to each, taken off
    before the fit. tell: is given the share done."""
    output = output_of(bench)
    if added is not None:
        records = [
            replace(r, columns={**r.columns, output: r.columns[output] - more})
            for r, more in zip(records, added, strict=True)
        ]
    laws = []
    for k, record in enumerate(records):
        tell(k / len(records))
        laws.append(LAWS[bench.specimen].still([*records[:k], *records[k + 1 :]], record))
    return laws


@dataclass(frozen=True, eq=False)
class _Sampled:
    """Records, some rows of each, and what a law that was fitted to others says of them."""

    bench: Bench
    records: Sequence[BenchRecord]
    signals: Sequence[Signals]
    rows: Sequence[Indices]

    @staticmethod
    def of(
        bench: Bench, records: Sequence[BenchRecord], laws: Sequence[Array], *, first: int = 0, most: int = _ROWS
    ) -> "_Sampled":
        """Return at most so many rows of each record. first: the first one's place among the bench's records."""
        signals = [signals_of(r, law, first + k) for k, (r, law) in enumerate(zip(records, laws, strict=True))]
        return _Sampled(bench, records, signals, [evenly(len(law), most) for law in laws])

    @cached_property
    def record(self) -> Indices:
        """Return (N,) of which record each row is."""
        return np.repeat(np.arange(len(self.rows)), [len(k) for k in self.rows])

    def residual(self, laws: Sequence[Array]) -> Array:
        """Return (N,) law less measured."""
        measured = (r.columns[output_of(self.bench)] for r in self.records)
        return np.concatenate([(law - m)[k] for law, m, k in zip(laws, measured, self.rows, strict=True)])

    def table(self, shape: ShapedEffect) -> Columns:
        """Return (N,) of each of the shape's parameters."""
        parts = [shape.columns(s) for s in self.signals]
        return {name: np.concatenate([p[name][k] for p, k in zip(parts, self.rows, strict=True)]) for name in parts[0]}

    def added(self, shapes: Sequence[ShapedEffect], x: Array) -> list[Array]:
        """Return (n,) of each record, what effects at these shapes, of strengths x (p,), add to the law."""
        added = []
        for s in self.signals:
            columns = (column for shape in shapes for column in shape.columns(s).values())
            added.append(np.zeros(len(s["law"])) + sum(v * column for v, column in zip(x, columns, strict=True)))
        return added

    def baseline(self, residual: Array) -> Scored:
        """Return what a kernel regression leaves of records that it was not trained on."""
        parts, kept, first = [], [], 0
        for s, k in zip(self.signals, self.rows, strict=True):
            columns = [s["law"], np.gradient(s["law"])]
            columns += [s[name] for name in ("path", "pressure", "time") if name in s]
            if "path" in s:
                columns += [np.sign(np.gradient(s["path"])), np.gradient(s["path"])]
            parts.append(np.column_stack(columns)[k])
            kept.append(first + evenly(len(k), _BOX_ROWS))
            first += len(k)
        some, count = np.concatenate(kept), np.bincount(self.record)
        features, record, wanted = standardised(np.concatenate(parts))[some], self.record[some], residual[some][:, None]
        remaining = wanted - predicted_by_others([features], wanted, [np.array([True])], record)
        squares = [float(np.mean(remaining[record == k] ** 2)) * count[k] for k in range(len(count))]
        return Scored(np.array(squares), count.astype(np.float64))


def _with_law(sampled: _Sampled, task: BenchTask, chosen: Judged, tell: Callable[[float], None]) -> Judged:
    """Return the effects chosen and the law fitted in turn: a law that was fitted alone has taken a part of them. An
    actuator's law is the level held, which has none."""
    places, refitted = task.places(chosen.fit), chosen
    shapes = [task.shapes[k] for k in places]

    def in_turn(turn: int, share: float) -> None:
        tell((turn + share) / ROUNDS)

    for turn in range(ROUNDS if places and sampled.bench.specimen != "actuator" else 0):
        added = sampled.added(shapes, refitted.fit.x)
        laws = laws_of(sampled.bench, sampled.records, added, tell=partial(in_turn, turn))
        last, refitted = refitted, replace(task, residual=sampled.residual(laws)).fit(places)
        if refitted.scored.rms() > (1 - _SETTLED) * last.scored.rms():
            break
    return refitted


def _tested(bench: Bench, shapes: Sequence[ShapedEffect], x: Array) -> tuple[float, float] | None:
    """Return the RMS on the records of role test, by the law of those of role fit: before, and with the shapes
    added."""
    records, tests = bench.of_role("fit"), bench.of_role("test")
    if not tests:
        return None
    laws = [LAWS[bench.specimen].still(records, record) for record in tests]
    sampled = _Sampled.of(bench, tests, laws, first=len(records), most=max(map(len, laws)))
    residual = sampled.residual(laws)
    return rms(residual), rms(residual + np.concatenate(sampled.added(shapes, x)))


def _effects(task: BenchTask, chosen: Judged, shapes: Sequence[ShapedEffect]) -> tuple[EffectTerm, ...]:
    """Return the effects at their shapes, with what was fitted in its interval."""
    vector, effects = chosen.fit.vector, list[EffectTerm]()
    strengths = quantities_of(vector, chosen.fit.x, task.deviation(chosen.fit))
    for shape, label in zip(shapes, vector.labels, strict=True):
        fitted = {vector.names[k].removeprefix(f"{label}."): strengths[vector.names[k]] for k in vector.part(label)}
        fixed = {name: Quantity(float(v), shape.units[name]) for name, v in shape.values.items()}
        effects.append(EffectTerm(shape.effect, fitted | fixed))
    return tuple(effects)

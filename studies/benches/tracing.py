"""Tracing on a bench: a quasi-static law, and what its left-out records show beside it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.files.model_file import write_model
from fabdesign.formats.json_file import write_json
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.model import EffectTerm, Model, Provenance, Quantity
from fabdesign.output import new_folder, write_text
from fabdesign.runtime.fingerprint import sha256
from fabdesign.version import __version__
from optimize.fit.clouds import evenly
from optimize.fit.cross_validation import Scored
from optimize.fit.descent import Progress, parts
from studies.benches.law import rms
from studies.benches.records import LAWS, noise_of, output_of, require_columns, unit_of
from studies.benches.trace_fit import BenchTask, ShapedEffect, Signals, alike, candidates_of, select, shapes_of
from studies.benches.trace_report import BenchOutcome, Curve, render_bench
from studies.fitting.fitted_model import quantities_of
from studies.model_selection.black_box import WIDTHS, kernel_of, left_out, standardised
from studies.model_selection.judged import Judged
from studies.model_selection.verdict import Evidence, decide

TOLERANCE = 0.02  # of the largest output
LEAST_RECORDS = 3  # records of role fit
_ROWS = 400  # of a record
_BOX_ROWS = 40
_TURNS = 3  # at most, of the law and the effects beside it
_SETTLED = 0.01  # of what is left, that one more turn would take
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
        write_json(files / "trace.json", outcome)
        write_model(_model(outcome), files / "model.toml")
        write_text(files / "report.html", render_bench(outcome))
    return outcome


def examine(bench: Bench, tolerance: float, progress: Progress = lambda line, share: None) -> BenchOutcome:
    """Return the trace itself; `tolerance` is a share of the largest output."""
    records = bench.of_role("fit")
    if len(records) < LEAST_RECORDS:
        raise InputError(f"{bench.file}: {len(records)} records of role fit; expected at least {LEAST_RECORDS}")
    require_columns(bench, bench.records)
    first, second, third = parts(progress, *_ENDS)
    line = f"{len(records)} records, each predicted from the others by the quasi-static law"
    sampled = _Sampled.of(bench, records, laws_of(bench, records, tell=partial(first, line)))
    residual = sampled.residual(sampled.laws)
    limit = tolerance * max(float(np.abs(r.columns[output_of(bench)]).max()) for r in records)
    noise = noise_of(bench)
    floor = noise.sigma
    shapes = shapes_of(LAWS[bench.specimen], sampled.signals)
    task = BenchTask(shapes, [sampled.table(shape) for shape in shapes], residual, sampled.record, floor, limit)
    second(f"{len(task.effects)} effects together on {len(records)} records", 0.0)
    none, chosen = task.fit(), select(task)
    refitted = _with_law(sampled, task, chosen, partial(third, "law and effects in turn"))
    remaining = refitted.fit.state.misfit.residual
    box = sampled.baseline(residual)
    beside = sampled.baseline(remaining) if chosen.parts else box
    evidence = Evidence(
        none.excess, refitted.excess, len(chosen.fit.vector.labels), box.excess(floor),
        structure=1 - float(beside.squares.sum() / np.square(remaining).sum()), typical=none.scored.typical(floor),
    )  # fmt: skip
    return BenchOutcome(
        bench=bench,
        unit=unit_of(bench),
        verdict=decide(evidence, limit),
        evidence=evidence,
        tolerance=limit,
        noise=noise,
        candidates=candidates_of(task),
        effects=_effects(task, refitted),
        gains={label: gain for label, (gain, _) in chosen.gains.items()},
        indistinguishable=alike(task, chosen),
        fit=(rms(residual), rms(remaining)),
        test=_tested(bench, [shapes[k] for k in task.places(chosen.fit)], refitted.fit.x),
        curves=sampled.curves(residual, remaining),
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
    laws: Sequence[Array]
    signals: list[Signals]
    rows: Sequence[Indices]

    @staticmethod
    def of(
        bench: Bench, records: Sequence[BenchRecord], laws: Sequence[Array], *, first: int = 0, most: int = _ROWS
    ) -> "_Sampled":
        """Return at most so many rows of each record. first: the first one's place among the bench's records."""
        signals = [Signals.of(r, law, first + k) for k, (r, law) in enumerate(zip(records, laws, strict=True))]
        return _Sampled(bench, records, laws, signals, [evenly(len(law), most) for law in laws])

    @cached_property
    def record(self) -> Indices:
        """Return (N,) of which record each row is."""
        return np.repeat(np.arange(len(self.rows)), [len(k) for k in self.rows])

    def residual(self, laws: Sequence[Array]) -> Array:
        """Return (N,) law less measured."""
        measured = (r.columns[output_of(self.bench)] for r in self.records)
        return np.concatenate([(law - m)[k] for law, m, k in zip(laws, measured, self.rows, strict=True)])

    def table(self, shape: ShapedEffect) -> dict[str, Array]:
        """Return (N,) of each of the shape's parameters."""
        parts = [shape.columns(s) for s in self.signals]
        return {name: np.concatenate([p[name][k] for p, k in zip(parts, self.rows, strict=True)]) for name in parts[0]}

    def baseline(self, residual: Array) -> Scored:
        """Return what a kernel regression leaves of records that it was not trained on."""
        parts, kept, first = [], [], 0
        for s, k in zip(self.signals, self.rows, strict=True):
            columns = [s.law, np.gradient(s.law)]
            columns += [c for c in (s.path, s.pressure, s.time) if c is not None]
            if s.path is not None:
                columns += [np.sign(np.gradient(s.path)), np.gradient(s.path)]
            parts.append(np.column_stack(columns)[k])
            kept.append(first + evenly(len(k), _BOX_ROWS))
            first += len(k)
        some = np.concatenate(kept)
        features, record = standardised(np.concatenate(parts))[some], self.record[some]
        kernels, wanted = [kernel_of(features, width) for width in WIDTHS], residual[some][:, None]
        squares = np.zeros(len(self.rows))
        for out in range(len(squares)):
            remaining = wanted[record == out] - left_out(kernels, wanted, [np.array([True])], record, out)
            squares[out] = float(np.mean(remaining**2)) * np.sum(self.record == out)
        return Scored(squares, np.bincount(self.record).astype(np.float64))

    def curves(self, before: Array, after: Array) -> tuple[Curve, ...]:
        """Return of each record what was measured, and with what is left before and after."""
        curves: list[Curve] = []
        for k, (record, rows) in enumerate(zip(self.records, self.rows, strict=True)):
            along = record.first(("time", *self.bench.input))
            place = np.arange(len(rows), dtype=float) if along is None else along[rows]
            y = record.columns[output_of(self.bench)][rows]
            curves.append((record.name, place, y, y + before[self.record == k], y + after[self.record == k]))
        return tuple(curves)


def _with_law(sampled: _Sampled, task: BenchTask, chosen: Judged, tell: Callable[[float], None]) -> Judged:
    """Return the effects chosen and the law fitted in turn: a law that was fitted alone has taken a part of them. An
    actuator's law is the level held, which has none."""
    bench, refitted = sampled.bench, chosen
    if bench.specimen == "actuator":
        return chosen
    places = task.places(chosen.fit)
    columns = [[c for place in places for c in task.shapes[place].columns(s).values()] for s in sampled.signals]

    def in_turn(turn: int, share: float) -> None:
        tell((turn + share) / _TURNS)

    for turn in range(_TURNS if places else 0):
        added = [sum((x * c for x, c in zip(refitted.fit.x, each, strict=True)), np.zeros(1)) for each in columns]
        laws = laws_of(bench, sampled.records, added, tell=partial(in_turn, turn))
        last, refitted = refitted, replace(task, residual=sampled.residual(laws)).fit(places)
        if refitted.scored.rms() > (1 - _SETTLED) * last.scored.rms():
            break
    return refitted


def _tested(bench: Bench, shapes: Sequence[ShapedEffect], coefficients: Array) -> tuple[float, float] | None:
    """Return the RMS on the records of role test, by the law of those of role fit: before, and with the shapes
    added."""
    records, tests = bench.of_role("fit"), bench.of_role("test")
    if not tests:
        return None
    laws = [LAWS[bench.specimen].still(records, record) for record in tests]
    sampled = _Sampled.of(bench, tests, laws, first=len(records), most=max(map(len, laws)))
    residual = sampled.residual(laws)
    columns = [column for shape in shapes for column in sampled.table(shape).values()]
    return rms(residual), rms(residual + sum(c * x for c, x in zip(coefficients, columns, strict=True)))


def _effects(task: BenchTask, chosen: Judged) -> tuple[EffectTerm, ...]:
    vector = chosen.fit.vector
    strengths = quantities_of(vector, chosen.fit.x, task.deviation(chosen.fit))
    terms = []
    for label, shape in zip(vector.labels, (task.shapes[k] for k in task.places(chosen.fit)), strict=True):
        strength = {name.partition(".")[2]: q for name, q in strengths.items() if name.startswith(f"{label}.")}
        fixed = {name: Quantity(float(v), shape.units[name]) for name, v in shape.values.items()}
        terms.append(EffectTerm(label, strength | fixed))
    return tuple(terms)


def _model(outcome: BenchOutcome) -> Model:
    """Return the model with those of the effects that the simulator has, where its parameters mean the same."""
    bench = outcome.bench
    return Model(
        effects=tuple(e for e in outcome.effects if _simulated(e)) if outcome.verdict == "effect" else (),
        provenance=Provenance(
            sets=(bench.name,),
            fitted=tuple(f"{bench.name}/{r.name}" for r in bench.of_role("fit")),
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

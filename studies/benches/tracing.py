"""Tracing on a bench: a quasi-static law, and what its left-out records show beside it; one joint fit of every effect,
then those dropped again that the records do not need, by the rules of sets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.bench import Bench
from fabdesign.nouns.forward import Term
from fabdesign.nouns.model import NORMAL90, EffectTerm, Quantity
from fabdesign.nouns.trial import LEAST_TRIALS
from fabdesign.output import new_folder
from optimize.fit.clouds import evenly
from optimize.fit.cross_validation import Scored
from optimize.fit.descent import Progress, parts
from optimize.fit.fitted import Fit, concluded
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.problem import BenchProblem
from optimize.fit.significance import NEEDED, conditioned, eliminated
from studies.benches.law import ROUNDS, ShapedEffect, Signals, added_by, misses_of, rms, shapes_of, signals_of
from studies.benches.records import LAWS, laws_of, noise_of, output_of, require_columns
from studies.benches.trace_report import BenchOutcome, render_bench
from studies.fitting.fitted_model import quantities_of
from studies.model_selection.black_box import predicted_by_others, standardised
from studies.model_selection.judged import Judged
from studies.model_selection.outcome import Candidate, write_trace
from studies.model_selection.rules import ON_BENCHES, Refits, Selection, follow
from studies.model_selection.verdict import STRUCTURE, Evidence, decide

TOLERANCE = 0.02  # of the largest output
_ROWS = 400  # of a record
_BOX_ROWS = 40
_SETTLED = 0.01  # of what is left, that one more turn of the law and the effects beside it would take
_ENDS = (0.2, 0.3)  # shares of the work at which laws alone and effects end
_WIDE = 3.0  # prior deviation of a strength, times the one that moves the records as much as all that the law leaves
_AT_LIMIT = 1e-6  # of the prior's deviation


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
    laws = laws_of(bench, records, partial(first, line))
    noise = noise_of(bench)
    limit = tolerance * max(float(np.abs(r.columns[output_of(bench)]).max()) for r in records)
    task = BenchTask.of(bench, laws, noise.sigma, limit)
    second(f"{len(task.effects)} effects together on {len(records)} records", 0.0)
    selection = select(task)
    chosen = task.shapes_in(selection.chosen)
    refitted = _with_law(task, selection.judged, third)
    remaining = refitted.fit.state.misfit.residual
    box = task.baseline(task.residual)
    beside = task.baseline(remaining) if selection.gains else box
    evidence = Evidence(
        selection.before.excess, refitted.excess, len(chosen), box.excess(task.floor),
        structure=1 - float(beside.squares.sum() / np.square(remaining).sum()), typical=selection.before.typical,
    )  # fmt: skip
    verdict, effects = decide(evidence, limit), _effects(task, refitted.fit)
    return BenchOutcome(
        verdict=verdict,
        evidence=evidence,
        tolerance=limit,
        floor=task.floor,
        selection=selection,
        candidates=candidates_of(task, selection),
        named={effect.name: effect for effect in effects} if verdict == "effect" else {},
        indistinguishable=alike(task, selection.judged) if verdict == "effect" else (),
        bench=bench,
        noise=noise,
        effects=effects,
        fit=(rms(task.residual), rms(remaining)),
        test=_tested(bench, chosen, refitted.fit.x),
        curves=tuple(
            (record, evenly(len(law), _ROWS), task.residual[task.record == k], remaining[task.record == k])
            for k, (record, law) in enumerate(zip(records, laws, strict=True))
        ),
    )


@dataclass(frozen=True, eq=False)
class BenchTask(Refits):
    """The records' residuals, and what effects would change of them. As rules ask it (`rules.Refits`): a fit with fewer
    effects is one with their shapes searched anew.

    rows (N,): those used, of all records one after another; record (N,): of which, whose rows share the error of the
    law; residual (N,): law less measured, in the output's unit. tables: (strengths, N) of each shape. either_sign:
    whether strengths have no bound."""

    bench: Bench
    signals: Sequence[Signals]
    tables: Mapping[ShapedEffect, Array]
    rows: Indices
    record: Indices
    residual: Array
    floor: float
    tolerance: float
    either_sign: bool = False

    @staticmethod
    def of(bench: Bench, laws: Sequence[Array], floor: float, tolerance: float) -> "BenchTask":
        """Return the task of some rows of each record. laws: (n,) of each, by what was fitted to the others."""
        signals = signals_of(bench.of_role("fit"), laws, output_of(bench))
        lengths = [len(law) for law in laws]
        rows, record = _spread(lengths, _ROWS), np.repeat(np.arange(len(laws)), lengths)
        tables = {shape: shape.table(signals)[:, rows] for shape in shapes_of(LAWS[bench.specimen], signals)}
        return BenchTask(bench, signals, tables, rows, record[rows], misses_of(laws, signals)[rows], floor, tolerance)

    @property
    def effects(self) -> list[str]:
        return list(dict.fromkeys(shape.effect for shape in self.tables))

    def judged(self, fit: Fit) -> Judged:
        """Return a fit with what records left out say of it. Unknowns at their limit take no part: what they would take
        has a sign that they cannot have."""
        low, high = fit.vector.limits
        held = np.flatnonzero(np.minimum(fit.x - low, high - fit.x) < _AT_LIMIT * fit.vector.prior)
        return Judged(fit, range(int(self.record.max()) + 1), self.floor, held)

    def without(self, known: Fit, labels: Sequence[str]) -> Fit:
        """Return the fit of the effects of another but `labels`."""
        return self.shaped([label for label in known.vector.labels if label not in labels]).fit

    def shapes_in(self, fit: Fit) -> list[ShapedEffect]:
        """Return which shapes the effects of a fit have."""
        shapes = {(shape.effect, *shape.values.values()): shape for shape in self.tables}
        return [shapes[term.name, *term.values.values()] for term in fit.vector.terms]

    def fit(self, shapes: Sequence[ShapedEffect] = (), rows: Indices | slice = slice(None)) -> Judged:
        """Return the effects at these shapes, together, from off. Residuals are linear in these, so the second step is
        the last. rows: that take part."""
        residual, record = self.residual[rows], self.record[rows]
        table = [column for shape in shapes for column in self.tables[shape][:, rows]]
        columns = np.reshape(table, (-1, len(record))).T
        strengths = [(shape, name) for shape in shapes for name in shape.strengths]
        before, parameters = rms(residual), []
        for (shape, name), column in zip(strengths, columns.T, strict=True):
            prior = _WIDE * float(np.sqrt(np.mean(residual**2) / max(float(np.mean(column**2)), 1e-30)))
            bounds, unit = (-np.inf if self.either_sign else shape.lowest(name), np.inf), shape.units[name]
            parameters.append(FitParameter(f"{shape.effect}.{name}", prior, 0.0, "linear", unit, bounds))
        vector = FitVector(tuple(parameters), (), tuple(Term(shape.effect, shape.values) for shape in shapes))
        problem, x = BenchProblem(lambda x: residual + columns @ x, record, record, vector), vector.start
        for _ in range(2):
            state = problem.with_jacobian(problem.evaluate([x])[0], columns)
            fitted = concluded(problem, state, None, before, 1, "converged")
            x = fitted.minimum
        return self.judged(fitted)

    def deviation(self, joint: Fit) -> Array:
        """Return (p,) of the unknowns, by their covariance and by how far leaving out each record moves them
        (jackknife): its rows share the law's error."""
        records, shapes = np.unique(self.record), self.shapes_in(joint)
        alone = np.array([self.fit(shapes, np.flatnonzero(self.record != k)).fit.x for k in records])
        return np.asarray(np.sqrt(np.diag(joint.covariance) + (len(records) - 1) * alone.var(axis=0)))

    def shaped(self, effects: Sequence[str], beside: Sequence[ShapedEffect] = ()) -> Judged:
        """Return each effect at the shape that leaves least of records left out, the others being at theirs; beside:
        shapes that stay."""
        chosen = {effect: next(shape for shape in self.tables if shape.effect == effect) for effect in effects}
        best = self.fit([*beside, *chosen.values()])
        for _ in range(ROUNDS):
            before = chosen
            for shape in self.tables:
                if chosen.get(shape.effect, shape) is not shape:
                    other = chosen | {shape.effect: shape}
                    tried = self.fit([*beside, *other.values()])
                    if tried.scored.squares.sum() < best.scored.squares.sum():
                        best, chosen = tried, other
            if chosen == before:
                break
        return best

    def baseline(self, residual: Array) -> Scored:
        """Return what a kernel regression leaves of records that it was not trained on."""
        parts = []
        for s in self.signals:
            columns = [s["law"], np.gradient(s["law"])]
            columns += [s[name] for name in ("path", "pressure", "time") if name in s]
            if "path" in s:
                columns += [np.sign(np.gradient(s["path"])), np.gradient(s["path"])]
            parts.append(np.column_stack(columns))
        features, count = standardised(np.concatenate(parts)[self.rows]), np.bincount(self.record)
        some = _spread([*count], _BOX_ROWS)
        record, wanted = self.record[some], residual[some][:, None]
        remaining = wanted - predicted_by_others([features[some]], wanted, [np.array([True])], record)
        squares = [float(np.mean(remaining[record == k] ** 2)) for k in range(len(count))]
        return Scored(np.array(squares) * count, count.astype(np.float64))


def _spread(lengths: Sequence[int], most: int) -> Indices:
    """Return at most so many places of each part of a row of parts, evenly."""
    starts = np.cumsum([0, *lengths[:-1]])
    return np.concatenate([start + evenly(n, most) for start, n in zip(starts, lengths, strict=True)])


def _with_law(task: BenchTask, chosen: Judged, progress: Progress) -> Judged:
    """Return the effects chosen and the law fitted in turn: a law that was fitted alone has taken a part of them. An
    actuator's law is the level held, which has none."""
    shapes, refitted = task.shapes_in(chosen.fit), chosen
    records, output = task.bench.of_role("fit"), output_of(task.bench)
    if not shapes or task.bench.specimen == "actuator":
        return chosen
    ends = np.cumsum([len(s["law"]) for s in task.signals])[:-1]
    for part in parts(progress, *(k / ROUNDS for k in range(1, ROUNDS))):
        pairs = zip(records, np.split(added_by(shapes, task.signals, refitted.fit.x), ends), strict=True)
        without = [replace(r, columns={**r.columns, output: r.columns[output] - added}) for r, added in pairs]
        laws = laws_of(task.bench, without, partial(part, "law and effects in turn"))
        last, refitted = refitted, replace(task, residual=misses_of(laws, task.signals)[task.rows]).fit(shapes)
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
    signals = signals_of(tests, laws, output_of(bench), len(records))
    residual = misses_of(laws, signals)
    return rms(residual), rms(residual + added_by(shapes, signals, x))


def _effects(task: BenchTask, fit: Fit) -> tuple[EffectTerm, ...]:
    """Return the effects of a fit at their shapes, with what was fitted in its interval."""
    strengths, effects = quantities_of(fit.vector, fit.x, task.deviation(fit)), []
    for shape in task.shapes_in(fit):
        fixed = {name: Quantity(float(value), shape.units[name]) for name, value in shape.values.items()}
        fitted = {name: strengths[f"{shape.effect}.{name}"] for name in shape.strengths}
        effects.append(EffectTerm(shape.effect, fitted | fixed))
    return tuple(effects)


def select(task: BenchTask) -> Selection:
    """Return a selection of every effect at once, then by the rules: to first order what the data do not need, then
    what records left out gain too little by, with shapes and strengths fitted anew."""
    none = task.fit()
    if none.excess <= task.tolerance:
        return Selection(none.fit, none, none)
    everything = task.shaped(task.effects)
    known = conditioned(everything.fit.x.copy(), everything.fit.covariance, everything.off)
    labels = [*eliminated(*known, everything.parts, NEEDED)[0]]
    return follow(ON_BENCHES, task, Selection(everything.fit, none, task.shaped(labels), everything.excess))


def candidates_of(task: BenchTask, selection: Selection) -> tuple[Candidate, ...]:
    """Return every effect by itself, at its best shape and with any sign, the one that leaves least first."""
    rows, before, task = [], selection.before.excess, replace(task, either_sign=True)
    for effect in task.effects:
        alone = task.shaped([effect])
        gain, interval = alone.gains_without(())[effect]
        remaining, chosen = (alone.excess, alone.typical), effect in selection.chosen.vector.labels
        refused = False
        if interval[0] > 0 and alone.excess <= (1 - STRUCTURE) * before:  # it takes some: with a sign that it can have?
            most = alone.fit.x + NORMAL90 * task.deviation(alone.fit)
            [shape] = task.shapes_in(alone.fit)
            refused = any(m < shape.lowest(name) for m, name in zip(most, shape.strengths, strict=True))
        rows.append((alone.scored.rms(), Candidate(effect, gain, interval, *remaining, chosen, refused=refused)))
    return tuple(candidate for _, candidate in sorted(rows, key=lambda row: row[0]))


def alike(task: BenchTask, chosen: Judged) -> tuple[str, ...]:
    """Return effects that in the place of one of those chosen do as well, as far as records left out can say."""
    names, shapes = [], task.shapes_in(chosen.fit)
    for shape in shapes:
        for effect in task.effects:
            if effect not in chosen.fit.vector.labels:
                swapped = task.shaped([effect], [one for one in shapes if one is not shape])
                gain = chosen.trials.gain(swapped.scored, chosen.scored, task.floor)
                if effect in swapped.parts and gain[1][0] <= 0:
                    names.append(effect)
    return tuple(dict.fromkeys(names))
